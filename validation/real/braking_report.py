"""What measured stops and turns say: against what the stopping budget counts, and what would bound them."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from companion.config.settings import Settings
from companion.mavlink.firmware import MEASURED_BRAKE_MPS2, MEASURED_HOLD_CREEP_M, AutopilotKind
from companion.safety_case.stopping_budget import MODE_BRAKE_MPS2, SILENCE_EXTRA_S
from companion.text_table import columns
from validation.real.brake_bound import Bound, Way, least_brake_mps2, tightest
from validation.real.manoeuvres import Order, Stopped, Turned

_DELAY_S = Settings().safety.autopilot_delay_s
_CREEP_M = MEASURED_HOLD_CREEP_M[AutopilotKind.PX4]
"""That of the default settings, which hold for both."""
_MODE = Bound(_DELAY_S, MODE_BRAKE_MPS2, _CREEP_M)
COUNTED: dict[Order, Bound] = {
    # The gate's zero velocity ends in a hold, whose creep is counted.
    **dict.fromkeys((Order.ZERO, Order.LED_BACK, Order.STAND_HOLD), Bound(_DELAY_S, MEASURED_BRAKE_MPS2, _CREEP_M)),
    Order.HOLD: _MODE,
    Order.LAND: _MODE,
    Order.SILENCE: Bound(Settings().autopilot.silence_s + SILENCE_EXTRA_S, MODE_BRAKE_MPS2, _CREEP_M),
}
"""What the budget counts from the order on, or from the last setpoint: no pose is old then, and no setpoint lost."""
NOT_JUDGED = frozenset({("px4", Order.ZERO), ("ardupilot", Order.ZERO), ("ardupilot", Order.HOLD)})
"""Nobody only asks for zero velocity: PX4 creeps on under it, and is led back. ArduCopter's BRAKE at speed needs twice
the way, and the gate orders it when the vehicle stands."""

STOPS_HEAD = (
    *("order", "autopilot", "asked, m/s", "stops", "reached", "most", "lag, s", "at order"),
    *("stood after, s", "after, m", "crept, m", "way, m", "counted, m", "left, m", "waited, s"),
)
BOUNDS_HEAD = (
    *("order", "autopilot", "stops", "delay, s", "least m/s²", "counted m/s²"),
    *("tightest: delay, s", "m/s²", "left of it at most, m"),
)
TURNS_HEAD = (
    *("autopilot", "asked, rad/s", "at, m/s", "turns", "reached, rad/s", "lag, s", "speed, m/s", "behind, rad"),
    *("radius", "overrun, rad", "waited, s"),
)


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight.

    Attributes:
        autopilot: px4 or ardupilot.
        number: of the flight.
        stops, turns: in it.
        load: processes that wanted a processor, as the kernel's mean over 5 minutes in the end.
        problem: why it ended before.
    """

    autopilot: str
    number: int
    stops: tuple[Stopped, ...]
    turns: tuple[Turned, ...]
    load: float
    problem: str | None = None


def left_m(one: Stopped) -> float:
    """What is left of what is counted; negative where it went further."""
    return COUNTED[one.order].left_m([_way(one)])


def problems(flights: Iterable[Flown]) -> list[str]:
    """What went further than is counted, or did not stop, and what was not flown."""
    found = []
    for flown in flights:
        name = f"{flown.autopilot} {flown.number}"
        if flown.problem is not None:
            found.append(f"{name}: {flown.problem}")
        for one in flown.stops:
            if (flown.autopilot, one.order) in NOT_JUDGED:
                continue
            what = f"{name}: {one.order} from {one.cruise.at_order_mps:.2f} m/s"
            if one.stop.stopped_s is None:
                found.append(f"{what} did not stop")
            elif (left := left_m(one)) < 0.0:
                found.append(f"{what} went {one.stop.way_m:.2f} m, {-left:.2f} m further than is counted")
    return found


def report(flights: Sequence[Flown]) -> str:
    """Three tables and what is wrong. In each cell the median and, where it says so, the worst."""
    stops = [(flown.autopilot, one) for flown in flights for one in flown.stops]
    turns = [(flown.autopilot, one) for flown in flights for one in flown.turns]
    wrong = [f"- {problem}" for problem in problems(flights)]
    parts = [
        "Stops (median / worst)",
        *columns([STOPS_HEAD, *_stop_rows(stops)], left=(0, 1)),
        "",
        f"Bounds, with {_CREEP_M:g} m of creep: at the delay that is counted, and the tightest of all",
        *columns([BOUNDS_HEAD, *_bound_rows(stops)], left=(0, 1)),
        "",
        "Turns (median; radius: as a share of speed / rate as asked for)",
        *columns([TURNS_HEAD, *_turn_rows(turns)]),
        "",
        *(wrong or ["every stop was as short as is counted"]),
    ]
    return "\n".join(parts)


def _stop_rows(stops: Sequence[tuple[str, Stopped]]) -> list[tuple[str, ...]]:
    def key(one: tuple[str, Stopped]) -> tuple[int, bool, str, float]:
        autopilot, stop = one
        return list(Order).index(stop.order), stop.diagonal, autopilot, stop.asked_mps

    return [
        _stop_row(autopilot, [one for _, one in group])
        for (_, _, autopilot, _), group in itertools.groupby(sorted(stops, key=key), key)
    ]


def _stop_row(autopilot: str, group: Sequence[Stopped]) -> tuple[str, ...]:
    first = group[0]
    at_order_mps = statistics.median(one.cruise.at_order_mps for one in group)
    stood_s = [math.inf if one.stop.stopped_s is None else one.stop.stopped_s for one in group]
    stood_m = [math.inf if one.stop.stopped_m is None else one.stop.stopped_m for one in group]
    return (
        *(f"{first.order}{', diagonal' if first.diagonal else ''}", autopilot, f"{first.asked_mps:g}", str(len(group))),
        _median(group, lambda one: one.cruise.reached_mps),
        f"{max(one.cruise.largest_mps for one in group):.2f}",
        *(_median(group, lambda one: one.cruise.lag_s), f"{at_order_mps:.2f}"),
        *(_both(stood_s), _both(stood_m)),
        *(_both([one.stop.creep_m for one in group]), _both([one.stop.way_m for one in group])),
        f"{COUNTED[first.order].way_m(at_order_mps):.2f}",
        f"{min(map(left_m, group)):.2f}" + (" not judged" if (autopilot, first.order) in NOT_JUDGED else ""),
        f"{max(one.waited_s for one in group):.2f}",
    )


def _bound_rows(stops: Sequence[tuple[str, Stopped]]) -> list[tuple[str, ...]]:
    rows = []
    autopilots = sorted({autopilot for autopilot, _ in stops})
    for order in Order:
        for wanted in (*((one,) for one in autopilots), *([tuple(autopilots)] if len(autopilots) > 1 else [])):
            ways = [_way(one) for autopilot, one in stops if one.order is order and autopilot in wanted]
            if ways:
                rows.append((str(order), " and ".join(wanted), *_bound_cells(order, ways)))
    return rows


def _bound_cells(order: Order, ways: Sequence[Way]) -> tuple[str, ...]:
    counted = COUNTED[order]
    least = least_brake_mps2(ways, counted.delay_s, counted.creep_m)
    best = tightest(ways, counted.creep_m)
    slack_m = max(best.way_m(speed_mps) - way_m for speed_mps, way_m in ways)
    return (
        *(str(len(ways)), f"{counted.delay_s:.2f}", "-" if least is None else f"{least:.2f}"),
        *(f"{counted.brake_mps2:.2f}", f"{best.delay_s:.2f}", f"{best.brake_mps2:.2f}", f"{slack_m:.2f}"),
    )


def _turn_rows(turns: Sequence[tuple[str, Turned]]) -> list[tuple[str, ...]]:
    def key(one: tuple[str, Turned]) -> tuple[str, float, float]:
        return one[0], one[1].asked_radps, one[1].asked_mps

    return [
        _turn_row(autopilot, [one for _, one in group])
        for (autopilot, _, _), group in itertools.groupby(sorted(turns, key=key), key)
    ]


def _turn_row(autopilot: str, group: Sequence[Turned]) -> tuple[str, ...]:
    asked_radps, asked_mps = group[0].asked_radps, group[0].asked_mps
    slips = [one.turn.slip_rad for one in group if one.turn.slip_rad is not None]
    radii = [
        one.turn.speed_mps / abs(one.turn.reached_radps) / (asked_mps / asked_radps) for one in group if asked_mps > 0.0
    ]
    return (
        *(autopilot, f"{asked_radps:g}", f"{asked_mps:g}", str(len(group))),
        _median(group, lambda one: abs(one.turn.reached_radps)),
        _median(group, lambda one: one.turn.lag_s),
        _median(group, lambda one: one.turn.speed_mps),
        f"{statistics.median(slips):.2f}" if slips else "-",
        f"{statistics.median(radii):.2f}" if radii else "-",
        _median(group, lambda one: one.turn.overrun_rad),
        f"{max(one.waited_s for one in group):.2f}",
    )


def _way(one: Stopped) -> Way:
    return one.cruise.at_order_mps, one.stop.way_m


def _both(values: Sequence[float]) -> str:
    return f"{statistics.median(values):.2f} / {max(values):.2f}"


def _median(group: Sequence[T], value: Callable[[T], float]) -> str:
    return f"{statistics.median(map(value, group)):.2f}"
