"""What one look does to a voxel, in thousandths of log-odds, so that a voxel fits into 16 bits; and to a whole brick.

Every loop over a brick is over all its 64 voxels, without a branch and in 16 bits, so that it runs on the processor's
vector unit. Arrays are handed over one by one, for the reason given in `chunk_table.store_brick`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.config.mapping import MapSettings
from companion.mapping.voxels.chunks import BRICK, NOTHING

_BINS = 128

HITS, LOWERED, CHANGED = 0, 1, 2
"""Places in the counts of an update: voxels hit, voxels made surer of being free, chunks changed."""

_ZERO = np.int16(0)


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


@compiled
def lowered(value: np.int16, miss: np.int16, lowest: np.int16) -> np.int16:
    """The value of a voxel after one miss."""
    return max(np.int16((_ZERO if value == NOTHING else value) + miss), lowest)


@compiled
def lower(
    old: NDArray[np.int16], seen: NDArray[np.int16], miss: np.int16, lowest: np.int16, new: NDArray[np.int16]
) -> None:
    """Fill in ``new`` from ``old``, (64,) both: one miss where ``seen`` (64,) is not 0, where it was looked through."""
    for n in range(BRICK):
        value = old[n]
        new[n] = lowered(value, miss, lowest) if seen[n] != _ZERO else value


@compiled
def spread(hit: np.uint64, hits: NDArray[np.int16]) -> None:
    """Fill in ``hits`` (64,): 1 for each bit that is set, else 0."""
    for n in range(BRICK):
        hits[n] = np.int16((hit >> np.uint64(n)) & np.uint64(1))


@compiled
def raise_(
    old: NDArray[np.int16], hits: NDArray[np.int16], gains: NDArray[np.int16], highest: np.int16, new: NDArray[np.int16]
) -> None:
    """One hit, and no miss, where a ray ended and ``hits`` (64,) is not 0: hits win over misses.

    ``old`` is the brick before, ``gains`` what a hit adds to each voxel, ``new`` is changed; (64,) all of them.
    """
    for n in range(BRICK):
        value = old[n]
        risen = min(np.int16((_ZERO if value == NOTHING else value) + gains[n]), highest)
        new[n] = risen if hits[n] != _ZERO else new[n]


@compiled
def compared(
    old: NDArray[np.int16], new: NDArray[np.int16], hits: NDArray[np.int16]
) -> tuple[np.int16, np.int16, np.int16]:
    """How many voxels were hit, how many have another value, and how many of these were not hit."""
    hit, changed, missed = _ZERO, _ZERO, _ZERO
    for n in range(BRICK):
        differs = np.int16(new[n] != old[n])
        hit = np.int16(hit + hits[n])
        changed = np.int16(changed + differs)
        missed = np.int16(missed + np.int16(differs & ~hits[n]))
    return hit, changed, missed
