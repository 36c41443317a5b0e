"""Observations as plain JSON, exactly: what is read back is equal to the last bit.

Python writes every float so that it reads back the same. JSON has no NaN and no infinity: they stand as text.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.model import Beam, Camera, DepthFrame, Observation, PlanarScan, Pose, RangeReading
from companion.sensors.sink import RawPlanar, is_possible, planar_problem

_POSE = tuple(field.name for field in dataclasses.fields(Pose))
_CAMERA = tuple(field.name for field in dataclasses.fields(Camera))
_PIXELS = ("width_px", "height_px")


def number(value: float) -> float | str:
    """A float that JSON can hold: as it is, or "nan", "inf", "-inf"."""
    value = float(value)
    return value if math.isfinite(value) else str(value)


def finite(value: float | None) -> float | None:
    """A number, None where there is none; raises ValueError, TypeError or OverflowError for what cannot be one."""
    return float(value) if value is not None and math.isfinite(value) else None


def encode(observation: Observation, frame_recorded: bool) -> dict[str, Any]:
    """Everything but the pixels of the depth image, which are recorded as an image just before.

    Args:
        observation: what the tick saw.
        frame_recorded: whether the pixels are in the file.
    """
    frame, planar = observation.frame, observation.planar
    return {
        "t_s": number(observation.t_s),
        "pose": _encode_pose(observation.pose),
        "ranges": [
            {
                "beam": reading.beam.value,
                "t_s": number(reading.t_s),
                "range_m": None if reading.range_m is None else number(reading.range_m),
                "max_range_m": number(reading.max_range_m),
            }
            for reading in observation.ranges
        ],
        "frame": None
        if frame is None
        else {
            "t_s": number(frame.t_s),
            "pose": _encode_pose(frame.pose),
            "camera": {name: number(getattr(frame.camera, name)) for name in _CAMERA},
            "recorded": frame_recorded,
        },
        "planar": None
        if planar is None
        else {
            "t_s": number(planar.t_s),
            "pose": _encode_pose(planar.pose),
            "bearings_rad": [number(value) for value in planar.bearings_rad],
            "ranges_m": [number(value) for value in planar.ranges_m],
            "max_range_m": number(planar.max_range_m),
        },
    }


def decode(data: dict[str, Any], depth_m: NDArray[np.float32] | None) -> Observation:
    """The observation of `encode`.

    Args:
        data: what `encode` made.
        depth_m: the pixels of its depth image, when it has one.

    Raises:
        KeyError, TypeError, ValueError: ``data`` is not what `encode` makes, or there are no pixels for its frame.
    """
    frame, planar = data["frame"], data["planar"]
    if frame is not None and depth_m is None:
        raise ValueError("a depth image without its pixels")
    return Observation(
        t_s=float(data["t_s"]),
        pose=_decode_pose(data["pose"]),
        frame=None
        if frame is None or depth_m is None
        else DepthFrame(
            float(frame["t_s"]), depth_m, _decode_camera(frame["camera"], depth_m), _decode_pose(frame["pose"])
        ),
        ranges=tuple(
            RangeReading(
                Beam(reading["beam"]),
                float(reading["t_s"]),
                None if reading["range_m"] is None else float(reading["range_m"]),
                float(reading["max_range_m"]),
            )
            for reading in data["ranges"]
        ),
        planar=None if planar is None else _decode_planar(planar),
    )


def _encode_pose(pose: Pose) -> dict[str, float | str]:
    return {name: number(getattr(pose, name)) for name in _POSE}


def _decode_pose(data: dict[str, Any]) -> Pose:
    return Pose(**{name: float(data[name]) for name in _POSE})


def _decode_camera(data: dict[str, Any], depth_m: NDArray[np.float32]) -> Camera:
    """The camera of an image: what no driver may say is not flown again either, since compiled code trusts it."""
    values = {name: float(data[name]) for name in _CAMERA if name not in _PIXELS}
    camera = Camera(width_px=int(data["width_px"]), height_px=int(data["height_px"]), **values)
    if not is_possible(camera) or depth_m.shape != (camera.height_px, camera.width_px):
        raise ValueError("a depth image that its camera cannot have taken")
    return camera


def _decode_planar(data: dict[str, Any]) -> PlanarScan:
    scan = RawPlanar(
        float(data["t_s"]),
        np.array([float(value) for value in data["bearings_rad"]]),
        np.array([float(value) for value in data["ranges_m"]]),
        float(data["max_range_m"]),
    )
    problem = planar_problem(scan)
    if problem is not None:
        raise ValueError(f"a planar scan with a {problem}")
    return PlanarScan(scan.t_s, scan.bearings_rad, scan.ranges_m, scan.max_range_m, _decode_pose(data["pose"]))
