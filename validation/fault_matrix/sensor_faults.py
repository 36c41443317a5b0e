"""Faults of what the sensors say: the depth camera alone, the rangefinders alone, and both at once.

Where a fault blinds the vehicle the application is careless: it flies on whatever it sees, so that what stops the
vehicle is the gate. Where the other sensor still sees the wall nothing has to stop at once, and the application, as it
is flown, must stop before the wall with what is left to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from companion.config.settings import Settings
from companion.model import Beam, Camera
from companion.sensors.drivers.messages import DepthImage, Ranges
from companion.sensors.stuck import MOVED_M
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.scene import Flight
from validation.fault_matrix.stream_relay import Tampering

LATE_S = 1.0
FUTURE_S = 5.0
FOUND_FROZEN_S = MOVED_M / Settings().control.speed_mps + 1.0 / Settings().sensors.camera.rate_hz
"""An image that repeats itself is believed until the vehicle has moved; the way it flies here, for so long."""
STALE = Settings().safety.stale
"""As the flights have it: they do not set it."""

STOPPED = frozenset({Final.BRAKED, Final.HELD, Final.LANDED})
"""By the gate, or by an application that gave up: which comes first is not the point."""
STOPPED_OR_FLEW_ON = STOPPED | {Final.FLEW_ON}

DepthChange = Callable[[DepthImage, Camera], DepthImage | None]
RangesChange = Callable[[Ranges], Ranges | None]


class _Backwards:
    """Stamps that run back from the first, as fast as time goes on."""

    def __init__(self) -> None:
        self._first_s: float | None = None

    def stamp_s(self, t_s: float) -> float:
        self._first_s = t_s if self._first_s is None else self._first_s
        return 2.0 * self._first_s - t_s

    def depth(self, image: DepthImage, _camera: Camera) -> DepthImage:
        return replace(image, t_s=self.stamp_s(image.t_s))

    def ranges(self, ranges: Ranges) -> Ranges:
        return _stamped(ranges, self.stamp_s)


class _Frozen:
    """The first content, with the stamps of what it takes the place of."""

    def __init__(self) -> None:
        self._image: DepthImage | None = None
        self._ranges_m: dict[Beam, float | None] = {}

    def depth(self, image: DepthImage, _camera: Camera) -> DepthImage:
        self._image = self._image or image
        return replace(image, depth_m=self._image.depth_m)

    def ranges(self, ranges: Ranges) -> Ranges:
        kept = (replace(r, range_m=self._ranges_m.setdefault(r.beam, r.range_m)) for r in ranges.readings)
        return Ranges(tuple(kept))


def _stamped(ranges: Ranges, stamp_s: Callable[[float], float]) -> Ranges:
    return Ranges(tuple(replace(reading, t_s=stamp_s(reading.t_s)) for reading in ranges.readings))


def _no_depth(_image: DepthImage, _camera: Camera) -> None:
    return None


def _no_ranges(_ranges: Ranges) -> None:
    return None


def _depth_of(value: Callable[[Camera], float]) -> DepthChange:
    """Every pixel the same."""
    return lambda image, camera: replace(image, depth_m=np.full_like(image.depth_m, value(camera)))


def _range_of(value: float) -> RangesChange:
    """Every beam the same; infinity is as far as each of them reaches."""
    return lambda ranges: Ranges(tuple(replace(r, range_m=min(value, r.max_range_m)) for r in ranges.readings))


def _nothing_measured(ranges: Ranges) -> Ranges:
    return Ranges(tuple(replace(reading, range_m=math.nan) for reading in ranges.readings))


def _depth_from_the_future(image: DepthImage, _camera: Camera) -> DepthImage:
    return replace(image, t_s=image.t_s + FUTURE_S)


def _ranges_from_the_future(ranges: Ranges) -> Ranges:
    return _stamped(ranges, lambda t_s: t_s + FUTURE_S)


def _depth(make: Callable[[], DepthChange]) -> Callable[[Flight], None]:
    """Injects a change of the depth images, made anew for each flight: some remember."""

    def inject(flight: Flight) -> None:
        flight.stream.depth = Tampering(depth=make())

    return inject


def _ranges(make: Callable[[], RangesChange]) -> Callable[[Flight], None]:
    """The same for the rangefinders."""

    def inject(flight: Flight) -> None:
        flight.stream.ranges = Tampering(ranges=make())

    return inject


def _delay_depth(flight: Flight) -> None:
    flight.stream.depth = Tampering(delay_s=LATE_S)


def _delay_ranges(flight: Flight) -> None:
    flight.stream.ranges = Tampering(delay_s=LATE_S)


def _all_changed(index: int) -> Callable[[Flight], str | None]:
    """Whether the fault was there at all: without a changed message nothing was shown."""

    def verify(flight: Flight) -> str | None:
        if flight.stream.errors:
            return f"the change itself failed: {flight.stream.errors[-1]!r}"
        return None if flight.stream.changed[index] else "nothing was changed"

    return verify


def _blinding_depth(
    name: str, what: str, inject: Callable[[Flight], None], limit_s: float = STALE.depth_s
) -> Injection:
    return Injection(
        f"depth {name}", "depth camera", what, inject, STOPPED, limit_s=limit_s, careless=True, verify=_all_changed(0)
    )


def _blinding_ranges(name: str, what: str, inject: Callable[[Flight], None]) -> Injection:
    return Injection(
        f"ranges {name}",
        "rangefinders",
        what,
        inject,
        STOPPED,
        limit_s=STALE.ranges_s,
        careless=True,
        verify=_all_changed(1),
    )


DEPTH_FAULTS = (
    _blinding_depth("silent", "no image comes any more", _depth(lambda: _no_depth)),
    _blinding_depth(
        "frozen",
        "the same image again and again, each with a new stamp",
        _depth(lambda: _Frozen().depth),
        STALE.depth_s + FOUND_FROZEN_S,
    ),
    _blinding_depth("delayed", f"images come {LATE_S:g} s late, with the stamps of their exposure", _delay_depth),
    _blinding_depth("NaN", "not one pixel is measured", _depth(lambda: _depth_of(lambda _: math.nan))),
    _blinding_depth("all zeros", "every pixel is 0 m, which cannot be", _depth(lambda: _depth_of(lambda _: 0.0))),
    _blinding_depth(
        "all maximum",
        "every pixel says free as far as the camera sees",
        _depth(lambda: _depth_of(lambda camera: camera.max_range_m)),
    ),
    _blinding_depth("stamps going back", "the stamps run backwards", _depth(lambda: _Backwards().depth)),
    _blinding_depth(
        "stamps from the future",
        f"the stamps are {FUTURE_S:g} s ahead of the sender's own clock",
        _depth(lambda: _depth_from_the_future),
    ),
)

RANGE_FAULTS = (
    _blinding_ranges("silent", "no reading of any beam comes any more", _ranges(lambda: _no_ranges)),
    Injection(
        "ranges frozen",
        "rangefinders",
        "the same readings again and again, each with a new stamp; the depth camera still sees the wall",
        _ranges(lambda: _Frozen().ranges),
        STOPPED_OR_FLEW_ON,
        needs_stop=False,
        verify=_all_changed(1),
    ),
    _blinding_ranges("delayed", f"readings come {LATE_S:g} s late, with the stamps that they had", _delay_ranges),
    _blinding_ranges("NaN", "every beam says that it measured nothing", _ranges(lambda: _nothing_measured)),
    _blinding_ranges("all zeros", "every beam reads 0 m, as many do that see nothing", _ranges(lambda: _range_of(0.0))),
    _blinding_ranges(
        "all maximum",
        "every beam reads as far as it reaches, also the one down, below which there is always a ground",
        _ranges(lambda: _range_of(math.inf)),
    ),
    _blinding_ranges("stamps going back", "the stamps run backwards", _ranges(lambda: _Backwards().ranges)),
    _blinding_ranges(
        "stamps from the future",
        f"the stamps are {FUTURE_S:g} s ahead of the sender's own clock",
        _ranges(lambda: _ranges_from_the_future),
    ),
)

STREAM_FAULTS = (
    Injection(
        "sensors gone",
        "sensors",
        "the process that reads all sensors is gone, and its connection closed",
        lambda flight: flight.stream.cut(),
        STOPPED,
        limit_s=min(STALE.depth_s, STALE.ranges_s),
        careless=True,
    ),
)

SENSOR_FAULTS = (*DEPTH_FAULTS, *RANGE_FAULTS, *STREAM_FAULTS)
