"""RGB-D data sets that others recorded, as depth frames with poses: what a map can be made of without a flight.

Each format's file lists which image was taken where; the images themselves are read one after the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from companion.mapping.datasets.posed_images import Intrinsics, Listing, PosedImages
from companion.mapping.datasets.seven_scenes import seven_scenes
from companion.mapping.datasets.tum import WITHIN_S, tum


@dataclass(frozen=True, slots=True)
class Format:
    """What is known of a data set by the name of its format.

    Attributes:
        title: for people, and what the map's frame is called.
        listing: finds the images of a folder and their poses; takes the largest time between an image and its pose.
        units_per_m: what the images count in.
        no_return: readings that say that nothing was measured.
        up: the axis of its world that points up.
    """

    title: str
    listing: Callable[[Path, float], Listing]
    intrinsics: Intrinsics
    units_per_m: float
    no_return: tuple[int, ...]
    up: str


FORMATS = {
    "tum": Format("TUM RGB-D", tum, Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5), 5000.0, (0,), "z"),
    # Its worlds are those of the first camera, held about level: y points down.
    "7scenes": Format(
        "7-Scenes", seven_scenes, Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0), 1000.0, (0, 65535), "-y"
    ),
}
"""By the name that the command line knows them by. The intrinsics are those that the authors recommend."""

__all__ = ["FORMATS", "WITHIN_S", "Format", "Intrinsics", "Listing", "PosedImages"]
