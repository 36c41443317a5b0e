"""The sensors that the vehicle carries and how their readings become a measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from companion.config.section import Section, refuse
from companion.errors import InputError
from companion.model import Beam, Camera

LONGEST_UNIX_PATH_BYTES = 107
"""What Linux has room for in the address of a Unix socket."""


@dataclass(frozen=True, slots=True)
class TcpAddress:
    """A host's name or number and its port."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UnixAddress:
    """A socket in the file system."""

    path: Path


def parse_address(url: str) -> TcpAddress | UnixAddress:
    """The address that ``url`` names.

    Raises:
        InputError: it is none.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise InputError(f"{url!r} cannot be used as the address of a sensor stream: {error}") from error
    extra = parts.query or parts.fragment or parts.username is not None
    if parts.scheme == "tcp" and parts.hostname and port is not None and parts.path in ("", "/") and not extra:
        return TcpAddress(parts.hostname, port)
    if parts.scheme == "unix" and not parts.netloc and len(parts.path) > 1 and not extra:
        if len(parts.path.encode()) > LONGEST_UNIX_PATH_BYTES:
            raise InputError(f"{url!r}: the path of a Unix socket has at most {LONGEST_UNIX_PATH_BYTES} bytes")
        return UnixAddress(Path(parts.path))
    raise InputError(
        f"{url!r} is not the address of a sensor stream: use tcp://HOST:PORT (tcp://127.0.0.1:14600) or unix:///PATH"
    )


def _stream_url(url: str) -> str:
    try:
        parse_address(url)
    except InputError:
        raise PydanticCustomError("stream_url", "tcp://HOST:PORT or unix:///PATH") from None
    return url


class CameraSettings(Section):
    """A forward-looking depth camera; the defaults are the paper's Intel D435."""

    horizontal_fov_deg: float = Field(86.0, ge=20.0, le=150.0, description="horizontal field of view, in degrees")
    vertical_fov_deg: float = Field(57.0, ge=15.0, le=120.0, description="vertical field of view, in degrees")
    width_px: int = Field(160, ge=32, le=1920, description="width of the depth image, in pixels")
    height_px: int = Field(120, ge=24, le=1200, description="height of the depth image, in pixels")
    rate_hz: float = Field(5.0, ge=1.0, le=90.0, description="frames per second")
    min_range_m: float = Field(0.25, ge=0.05, le=2.0, description="nothing is measured nearer than this, in m")
    max_range_m: float = Field(10.0, ge=1.0, le=50.0, description="depth that is still trusted, in m")
    mount_x_m: float = Field(0.1, ge=-1.0, le=1.0, description="position on the body, forward, in m")
    mount_y_m: float = Field(0.0, ge=-1.0, le=1.0, description="position on the body, to the left, in m")
    mount_z_m: float = Field(0.0, ge=-1.0, le=1.0, description="position on the body, upward, in m")
    mount_yaw_deg: float = Field(0.0, ge=-180.0, lt=180.0, description="direction, to the left, in degrees")
    mount_pitch_deg: float = Field(0.0, ge=-45.0, le=45.0, description="direction, downward, in degrees")

    def model(self) -> Camera:
        """The pinhole camera with square angles: each field of view has its own focal length."""
        return Camera(
            width_px=self.width_px,
            height_px=self.height_px,
            fx_px=self.width_px / 2.0 / math.tan(math.radians(self.horizontal_fov_deg) / 2.0),
            fy_px=self.height_px / 2.0 / math.tan(math.radians(self.vertical_fov_deg) / 2.0),
            cx_px=(self.width_px - 1) / 2.0,
            cy_px=(self.height_px - 1) / 2.0,
            min_range_m=self.min_range_m,
            max_range_m=self.max_range_m,
            mount_x_m=self.mount_x_m,
            mount_y_m=self.mount_y_m,
            mount_z_m=self.mount_z_m,
            mount_yaw_rad=math.radians(self.mount_yaw_deg),
            mount_pitch_rad=math.radians(self.mount_pitch_deg),
        )

    def elevations_rad(self) -> tuple[float, float]:
        """The lowest and the highest direction that it sees, upward positive, on a vehicle that hovers level."""
        half_rad, down_rad = math.radians(self.vertical_fov_deg) / 2.0, math.radians(self.mount_pitch_deg)
        return -half_rad - down_rad, half_rad - down_rad

    def bearings_rad(self) -> tuple[float, float]:
        """The rightmost and the leftmost direction that it sees, to the left positive."""
        half_rad, towards_rad = math.radians(self.horizontal_fov_deg) / 2.0, math.radians(self.mount_yaw_deg)
        return towards_rad - half_rad, towards_rad + half_rad


class BeamSettings(Section):
    """Single-beam rangefinders along the body axes."""

    directions: tuple[Beam, ...] = Field(
        (Beam.FRONT, Beam.LEFT, Beam.BACK, Beam.RIGHT, Beam.DOWN, Beam.UP),
        description="where the beams look: any of front, left, back, right, down, up; down is needed for the height; "
        "when one of them, except up, falls silent, the vehicle stops: leave out what it can do without",
    )
    rate_hz: float = Field(10.0, ge=1.0, le=200.0, description="readings per second of each beam")
    max_range_m: float = Field(8.0, ge=1.0, le=100.0, description="longest range, in m")
    stale_after_s: float = Field(0.3, gt=0.0, le=2.0, description="a reading older than this does not count, in s")

    @model_validator(mode="after")
    def _down_and_distinct(self) -> Self:
        if len(set(self.directions)) != len(self.directions):
            names = ", ".join(self.directions)
            raise refuse(f"sensors.beams.directions = [{names}] names a beam twice", "sensors.beams.directions")
        if Beam.DOWN not in self.directions:
            raise refuse(
                f"sensors.beams.directions = [{', '.join(self.directions)}] lacks down: without it the height law (6) "
                "has no h",
                "sensors.beams.directions",
            )
        return self


class PlanarSettings(Section):
    """A planar scanner, level on the body, where there is one."""

    enabled: bool = Field(False, description="whether the vehicle carries one")
    rays: int = Field(360, ge=36, le=4096, description="rays a turn")
    rate_hz: float = Field(10.0, ge=1.0, le=100.0, description="turns per second")
    max_range_m: float = Field(10.0, ge=1.0, le=100.0, description="longest range, in m")


class ScanSettings(Section):
    """How depth and ranges become N(t), d and d_f."""

    bins: int = Field(360, ge=90, le=1440, description="bearings of the scan over the full turn")
    slab_margin_m: float = Field(
        0.25, ge=0.0, le=2.0, description="added above and below the body to the slab that counts as obstacle, in m"
    )
    max_ground_slope: float = Field(
        0.7, ge=0.05, le=1.5, description="steepest ground that the slab follows, rise over run"
    )
    stale_after_s: float = Field(
        0.5, gt=0.0, le=5.0, description="without a look ahead for this long the vehicle stops, in s"
    )
    memory_age_s: float = Field(
        60.0, ge=0.0, le=600.0, description="remembered points expire after this time, in s; 0 remembers nothing"
    )
    memory_look_m: float = Field(
        5.0, ge=0.5, le=6.0, description="points are remembered from looks at most this far, where depth is precise"
    )
    memory_distance_m: float = Field(
        5.0, ge=0.5, le=6.0, description="remembered points further away than this expire, in m"
    )


class StreamSettings(Section):
    """Depth and ranges from another process: a camera process, or the world beside a simulated autopilot."""

    url: Annotated[str, AfterValidator(_stream_url)] = Field(
        "tcp://127.0.0.1:14600", description="where it listens: tcp://HOST:PORT or unix:///PATH"
    )


class MavlinkSettings(Section):
    """Which rangefinder is believed, where several of one MAVLink link look the same way."""

    down_component: int | None = Field(
        None, ge=1, le=255, description="MAVLink component of the rangefinder that looks down; empty: first to measure"
    )
    down_id: int | None = Field(None, ge=0, le=255, description="id of its DISTANCE_SENSOR; empty: any")
    up_component: int | None = Field(
        None, ge=1, le=255, description="MAVLink component of the rangefinder that looks up; empty: first to measure"
    )
    up_id: int | None = Field(None, ge=0, le=255, description="id of its DISTANCE_SENSOR; empty: any")


class SensorSettings(Section):
    """Everything that measures."""

    drivers: tuple[str, ...] = Field(
        ("stream",),
        description="where readings come from in flight, by name: stream, mavlink (DISTANCE_SENSOR and "
        "OBSTACLE_DISTANCE), or a driver of an installed package",
    )
    stream: StreamSettings = Field(StreamSettings(), description="the driver stream")
    mavlink: MavlinkSettings = Field(MavlinkSettings(), description="the driver mavlink")

    camera: CameraSettings = Field(CameraSettings(), description="the forward depth camera")
    beams: BeamSettings = Field(BeamSettings(), description="the single-beam rangefinders")
    planar: PlanarSettings = Field(PlanarSettings(), description="the planar scanner")
    scan: ScanSettings = Field(ScanSettings(), description="from readings to the measurement")
