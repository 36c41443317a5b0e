"""What one look does to a voxel, in thousandths of log-odds, so that a voxel fits into 16 bits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings

_BINS = 128


class Steps(NamedTuple):
    """The sensor model, as the compiled functions take it; all log-odds in thousandths.

    Attributes:
        hits: (bins,) int16, what a hit adds, by depth.
        bins_per_m: the number of the bin over the depth.
        miss: what a miss adds; negative.
        lowest: lower clamp.
        highest: upper clamp.
        threshold: a voxel is occupied from this on.
    """

    hits: NDArray[np.int16]
    bins_per_m: float
    miss: int
    lowest: int
    highest: int
    threshold: int


def milli_log_odds(probability: float) -> int:
    """1000 ln(p / (1 - p)), rounded."""
    return round(1000.0 * math.log(probability / (1.0 - probability)))


def steps_of(settings: MapSettings) -> Steps:
    """The sensor model of these settings.

    A hit at depth z, where the camera's standard deviation is s = depth_noise_per_m z², counts 1 / (1 + (2 s / voxel)²)
    of a hit that is exact: the weight of a reading whose variance is that of the noise and of half a voxel together.
    """
    depth_m = np.linspace(0.0, settings.max_range_m, _BINS)
    noise_m = settings.depth_noise_per_m * depth_m**2
    weight = 1.0 / (1.0 + (2.0 * noise_m / settings.voxel_m) ** 2)
    return Steps(
        hits=np.maximum(np.round(milli_log_odds(settings.hit_probability) * weight), 1.0).astype(np.int16),
        bins_per_m=(_BINS - 1) / settings.max_range_m,
        miss=milli_log_odds(settings.miss_probability),
        lowest=milli_log_odds(settings.clamp_min_probability),
        highest=milli_log_odds(settings.clamp_max_probability),
        threshold=milli_log_odds(settings.occupied_probability),
    )
