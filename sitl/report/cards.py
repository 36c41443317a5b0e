"""The headline of a report: how the flight went, in one sentence and a few figures; and values in words."""

from __future__ import annotations

import enum
import math
import numbers
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from companion.control.left_out import in_words
from sitl.report.data import ReportData
from sitl.sim.simulation import COMPLETE_SHARE

UNKNOWN = "-"
_LISTED = 12


def number(summary: Mapping[str, object], key: str) -> float | None:
    """The finite number under ``key``, or ``None``."""
    value = summary.get(key)
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        return None
    return float(value)


def shown(value: object) -> str:
    """Any value of a summary for people: six digits, and what is not known as `UNKNOWN`."""
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return f"{float(value):.6g}" if math.isfinite(value) else UNKNOWN
    if isinstance(value, Mapping):
        return " ".join(shown(part) for part in value.values())
    if isinstance(value, (list, tuple)):
        parts = [shown(part) for part in value[:_LISTED]]
        more = f" ... ({len(value)} in all)" if len(value) > _LISTED else ""
        return ", ".join(parts) + more if parts else UNKNOWN
    return str(value)


def rows(summary: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and value of everything in a summary; what is nested gets names with dots."""
    for key, value in summary.items():
        if isinstance(value, Mapping):
            yield from rows(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", shown(value)


def seconds(value_s: float) -> str:
    """A duration: seconds, and from two minutes on minutes too."""
    if value_s < 10.0:
        return f"{value_s:.1f} s"
    return f"{value_s:.0f} s" if value_s < 120.0 else f"{value_s:.0f} s ({minutes(value_s)})"


def minutes(value_s: float) -> str:
    """A duration in minutes and seconds."""
    whole, rest = divmod(round(value_s), 60)
    return f"{whole} min {rest:02d} s"


class State(enum.StrEnum):
    """How good a figure is; the value is its class in the style sheet."""

    GOOD = "good"
    LOOK = "look"
    BAD = "bad"
    PLAIN = "plain"


@dataclass(frozen=True, slots=True)
class Card:
    """One key figure, all in plain text. ``words`` says that the value is a sentence rather than a number."""

    label: str
    value: str
    note: str
    state: State = State.PLAIN
    words: bool = False


def verdict(data: ReportData) -> tuple[State, str]:
    """How the flight went: whether the map is complete, and whether anything was touched."""
    completeness, contacts = number(data.summary, "completeness"), number(data.summary, "contacts")
    if completeness is None:
        mapped = "It is not known how complete the map is"
    elif completeness >= COMPLETE_SHARE:
        mapped = "The map is complete"
    else:
        mapped = f"The map is not complete ({_percent(completeness)})"
    if contacts is None:
        touched = "it is not known whether a wall was touched"
    elif contacts == 0:
        touched = "no wall was touched"
    else:
        touched = f"walls were touched {'once' if contacts == 1 else f'{contacts:.0f} times'}"
    collisions = number(data.summary, "collisions")
    if collisions:
        touched += ", but vehicles collided"
    states = (_completeness_state(completeness), _contact_state(contacts), _contact_state(collisions or 0.0))
    worst = next((state for state in (State.BAD, State.LOOK) if state in states), State.GOOD)
    return worst, f"{mapped}, and {touched}."


def key_figures(data: ReportData) -> list[Card]:
    """The cards, the most important first."""
    summary = data.summary
    completeness, completed_s = number(summary, "completeness"), number(summary, "completed_at_s")
    least_m, contacts = number(summary, "least_d_m"), number(summary, "contacts")
    clearance_m = number(summary, "least_clearance_m")
    below, precision = number(summary, "time_below_d_s_fraction"), number(summary, "precision")
    accuracy_m, path_m = number(summary, "accuracy_m"), number(summary, "path_length_m")
    sim_s, wall_s = number(summary, "sim_time_s"), number(summary, "wall_time_s")
    times = number(summary, "times_real_time")
    estimated, done_s = number(summary, "estimated_completeness"), number(summary, "done_at_s")
    when_done = number(summary, "completeness_when_done")
    ended, passages = summary.get("ended_because"), summary.get("passages")
    homes = [way for way in _listed(summary.get("home")) if isinstance(way, Mapping)]
    sizes = passages if isinstance(passages, Mapping) else {}
    return [
        Card("Map complete", _percent(completeness), "of what can be seen", _completeness_state(completeness)),
        Card(
            f"Time to {COMPLETE_SHARE:.0%}, t_f",
            UNKNOWN if completed_s is None else f"{completed_s:.0f} s",
            "not reached" if completed_s is None else minutes(completed_s),
            State.LOOK if completed_s is None else State.GOOD,
        ),
        Card(
            "The vehicle's own word",
            UNKNOWN if estimated is None else _percent(estimated),
            "not done when it ended"
            if done_s is None
            else f"done after {seconds(done_s)}, with {_percent(when_done)} in truth",
        ),
        Card(
            "Seen and left out",
            in_words(data.left_out) if isinstance(summary.get("left_out"), list) else UNKNOWN,
            "crosses in the plan below",
            words=True,
        ),
        Card("Contacts with walls", shown(summary.get("contacts")), "should be none", _contact_state(contacts)),
        Card(
            "Least distance to a wall",
            UNKNOWN if least_m is None else f"{least_m:.2f} m",
            f"d_s is {data.margin_m:g} m, d_c {data.critical_margin_m:g} m; {_percent(below)} of the time below d_s",
            State.PLAIN if least_m is None else State.GOOD if least_m >= data.critical_margin_m else State.LOOK,
        ),
        Card(
            "Least clearance of the body",
            UNKNOWN if clearance_m is None else f"{clearance_m:.2f} m",
            "to any rock, above and below too; a contact is where it is 0",
            State.PLAIN if clearance_m is None else State.GOOD if clearance_m > 0.0 else State.BAD,
        ),
        Card("Flies into", _size(sizes, "enters"), f"or more; once inside it goes on down to {_size(sizes, 'least')}"),
        Card(
            "Accuracy of the map",
            UNKNOWN if accuracy_m is None else f"{100.0 * accuracy_m:.1f} cm",
            f"mean error; {_percent(precision)} of the voxels are surface",
        ),
        Card(
            "Way flown",
            UNKNOWN if path_m is None else f"{path_m:.0f} m",
            "time of flight not known" if sim_s is None else f"in {seconds(sim_s)}",
        ),
        Card(
            "Simulated",
            UNKNOWN if times is None else f"{times:.3g} × real time",
            "computing time not known" if wall_s is None else f"{seconds(wall_s)} of computing",
        ),
        Card("Ended because", shown(ended), "", words=True),
        *(_home(way, index) for index, way in enumerate(homes, 1)),
    ]


def _listed(value: object) -> Sequence[object]:
    return value if isinstance(value, list | tuple) else ()


def _home(way: Mapping[str, object], vehicle: int) -> Card:
    """How a vehicle came home."""
    off_m, flown_m, time_s = (number(way, name) for name in ("off_m", "flown_m", "time_s"))
    came, promised = number(way, "came_percent"), number(way, "promised_percent")
    text = "" if flown_m is None or time_s is None else f"{flown_m:.0f} m in {seconds(time_s)}"
    if came is not None:
        text += f"; {came:.0f} % of the battery left" + ("" if promised is None else f" of {promised:.0f} % promised")
    home = way.get("ended_because") == "home"
    return Card(
        f"Vehicle {vehicle}: the way home",
        f"{off_m:.2f} m off" if home and off_m is not None else shown(way.get("ended_because")),
        text,
        State.GOOD if way.get("arrived") is True else State.LOOK,
        words=not home,
    )


def _completeness_state(completeness: float | None) -> State:
    return State.GOOD if completeness is not None and completeness >= COMPLETE_SHARE else State.LOOK


def _contact_state(contacts: float | None) -> State:
    if contacts is None:
        return State.LOOK
    return State.GOOD if contacts == 0 else State.BAD


def _size(passages: Mapping[str, object], which: str) -> str:
    """Width and height of a place."""
    width_m, height_m = number(passages, f"{which}_width_m"), number(passages, f"{which}_height_m")
    return UNKNOWN if width_m is None or height_m is None else f"{width_m:.2f} x {height_m:.2f} m"


def _percent(share: float | None) -> str:
    """One decimal, rounded down: 98.97 % must not read as the 99 % that was missed."""
    return UNKNOWN if share is None else f"{int(share * 1000.0 + 1e-6) / 10.0:.1f} %"
