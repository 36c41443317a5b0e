"""What the sensors of a small vehicle say in a tick, and what must hold of every measurement made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from companion.config.sensors import CameraSettings, SensorSettings
from companion.config.vehicle import VehicleSettings
from companion.model import (
    CLEAR,
    HIT,
    UNKNOWN,
    Beam,
    DepthFrame,
    Input,
    Measurement,
    Observation,
    PlanarScan,
    Pose,
    RangeReading,
    Scan,
)
from companion.perception import Extractor
from companion.perception.look import bin_bearings
from tests.perception.scenes import AT_START, FLOOR, H_M, ROOF, Surface, frame

SMALL = CameraSettings(width_px=64, height_px=48)
CAMERA = SMALL.model()
SETTINGS = SensorSettings(camera=SMALL)
VEHICLE = VehicleSettings(body_radius_m=0.35, body_height_m=0.3)
BEAM_LIMIT_M = SETTINGS.beams.max_range_m
BEAM_STALE_S = SETTINGS.beams.stale_after_s
DEPTH_STALE_S = SETTINGS.scan.stale_after_s
BINS = SETTINGS.scan.bins
BEARINGS = bin_bearings(BINS)
HALF_BIN_RAD = math.pi / BINS
SOON_S = 0.05
EXACT_M = 1e-3
"""Depths are float32: 1e-6 of 10 m."""

OPEN = [FLOOR, ROOF]
NAN, INF = float("nan"), float("inf")
DOWN = {Beam.DOWN: H_M}


def extractor(sensors: SensorSettings = SETTINGS) -> Extractor:
    return Extractor(sensors, VEHICLE, H_M)


def readings(t_s: float, ranges_m: Mapping[Beam, float | None]) -> tuple[RangeReading, ...]:
    return tuple(RangeReading(beam, t_s, range_m, BEAM_LIMIT_M) for beam, range_m in ranges_m.items())


def image(surfaces: list[Surface], pose: Pose = AT_START) -> DepthFrame:
    return frame(surfaces, pose, CAMERA)


def observed(
    pose: Pose,
    surfaces: list[Surface] | None = None,
    ranges_m: Mapping[Beam, float | None] | None = None,
    planar: PlanarScan | None = None,
) -> Observation:
    """Everything at the time of ``pose``: an image of the surfaces, beams, a planar scan."""
    seen = None if surfaces is None else image(surfaces, pose)
    return Observation(pose.t_s, pose, seen, readings(pose.t_s, ranges_m or {}), planar)


def planar(pose: Pose, bearings_deg: ArrayLike, ranges_m: ArrayLike) -> PlanarScan:
    return PlanarScan(pose.t_s, np.radians(bearings_deg), np.array(ranges_m, np.float64), 10.0, pose)


def later(pose: Pose, dt_s: float, **changed: float) -> Pose:
    return replace(pose, t_s=pose.t_s + dt_s, **changed)


def scan_of(measurement: Measurement) -> Scan:
    assert measurement.scan is not None
    return measurement.scan


def bin_at(bearing_deg: float) -> int:
    """The bin that holds a bearing."""
    return int((math.radians(bearing_deg) + math.pi) / (2.0 * math.pi) * BINS) % BINS


def assert_finite(measured: Measurement) -> None:
    """Every float is finite or None, and the scan is one that the law can read."""
    for field in fields(measured):
        value = getattr(measured, field.name)
        if isinstance(value, float) and field.name not in ("scan_age_s", "ranges_age_s", "ahead_m"):
            assert math.isfinite(value), (field.name, value)
    assert measured.ranges_age_s >= 0.0
    assert math.isnan(measured.ahead_m) or measured.ahead_m >= 0.0
    assert math.isfinite(measured.scan_age_s) or Input.DEPTH in measured.missing
    assert not math.isnan(measured.scan_age_s)
    if measured.scan is None:
        assert measured.d_m is None
        assert measured.missing
        return
    scan = measured.scan
    assert np.isfinite(scan.ranges_m).all()
    assert np.isin(scan.state, [UNKNOWN, CLEAR, HIT]).all()
    assert (scan.ranges_m[scan.state == UNKNOWN] == 0.0).all()
    assert (scan.ranges_m[scan.state == HIT] >= 0.0).all()
    hits = scan.ranges_m[scan.state == HIT]
    assert measured.d_m == (pytest.approx(hits.min()) if hits.size else None)
