"""What stands on the page about vehicles, as HTML. Everything that came over the link is escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from companion.ground.concerns import STALE_S, Concern, Weight, concerns, duration
from companion.ground.station import VehicleView
from companion.link.words import Telemetry

STYLE = files("companion.ground").joinpath("page.css").read_text(encoding="utf-8")

_DOTS = {Weight.FINE: "fine", Weight.LOOK: "look", Weight.ACT: "act"}
_NOT_KNOWN = "–"

CHOOSE = '<div class="gp"><p class="gp-none">Choose the vehicle that figures and buttons shall be for.</p></div>'
"""In place of a vehicle's card, where there are several and none has been chosen."""


@dataclass(frozen=True, slots=True)
class Row:
    """A vehicle in the list of all."""

    vehicle: VehicleView
    colour: str
    chosen: bool


def fleet_card(rows: Sequence[Row], tick: int) -> str:
    """All vehicles, a line each.

    Args:
        rows: of the vehicles.
        tick: another number each time. The card says by itself that it is old when no other has taken its place.
    """
    if not rows:
        lines = '<p class="gp-none">No vehicle has been heard yet. They appear here by themselves.</p>'
    else:
        lines = "".join(_line(row) for row in rows)
    return (
        f'<div class="gp" data-tick="{tick}"><div class="gp-dead">This page hears nothing from the ground program any '
        f"more: all of it is old. Is it running, and is this device in its network?</div>{lines}</div>"
    )


def vehicle_card(vehicle: VehicleView) -> str:
    """How one vehicle stands, and what to do."""
    telemetry, stale = vehicle.telemetry, vehicle.age_s > STALE_S
    banners = "".join(_banner(concern) for concern in concerns(vehicle))
    if telemetry is None:
        return f'<div class="gp">{banners}</div>'
    figures = [
        _figure("rock", _metres(telemetry.d_m), f"keeps {_metres(telemetry.margin_m)}"),
        _figure("height", _metres(telemetry.h_m), f"wants {_metres(telemetry.height_m)}"),
        _figure("battery", _percent(telemetry.battery_percent), _at_home(telemetry), _share(telemetry.battery_percent)),
        _figure("way home", _metres(telemetry.home_m, 0), _time(telemetry.home_s)),
        _figure(
            "map",
            _percent(_times_100(telemetry.completeness)),
            _left(telemetry),
            _share(_times_100(telemetry.completeness)),
        ),
        _figure("link", _age(vehicle.age_s), f"map {_behind(vehicle.map_age_s)}"),
    ]
    doing = escape(telemetry.ended_because or telemetry.mode)
    return (
        f'<div class="gp{" gp-stale" if stale else ""}">{banners}'
        f'<div class="gp-doing"><b>{escape(_phase(telemetry))}</b>{f" · {doing}" if doing else ""}</div>'
        f'<div class="gp-figures">{"".join(figures)}</div></div>'
    )


def answers_card(lines: Sequence[tuple[str, str]]) -> str:
    """What became of the last commands: pairs of a class (``yes``, ``no``, ``open``) and a text."""
    return f'<div class="gp">{"".join(f"<p class=gp-{kind}>{escape(text)}</p>" for kind, text in lines)}</div>'


def _line(row: Row) -> str:
    vehicle, telemetry = row.vehicle, row.vehicle.telemetry
    worst = max((concern.weight for concern in concerns(vehicle)), default=Weight.FINE)
    phase = "not heard" if telemetry is None else _phase(telemetry)
    battery = _NOT_KNOWN if telemetry is None else _percent(telemetry.battery_percent)
    return (
        f'<div class="gp-line{" gp-chosen" if row.chosen else ""}{" gp-old" if vehicle.age_s > STALE_S else ""}">'
        f'<i class="gp-dot gp-{_DOTS[worst]}"></i><b style="border-color:{row.colour}">{escape(vehicle.name)}</b>'
        f"<span>{escape(phase)}</span><span>{battery}</span><span>{_age(vehicle.age_s)}</span></div>"
    )


def _banner(concern: Concern) -> str:
    return f'<div class="gp-banner gp-{_DOTS[concern.weight]}">{escape(concern.text)}</div>'


def _figure(name: str, value: str, beside: str, share: float | None = None) -> str:
    bar = "" if share is None else f'<s><u style="width:{100.0 * share:.0f}%"></u></s>'
    return f'<div class="gp-figure"><small>{name}</small><b>{value}</b><small>{beside}</small>{bar}</div>'


def _phase(telemetry: Telemetry) -> str:
    return f"{telemetry.phase}, paused" if telemetry.paused else telemetry.phase


def _metres(value: float | None, digits: int = 2) -> str:
    return _NOT_KNOWN if value is None else f"{value:.{digits}f} m"


def _percent(value: float | None) -> str:
    return _NOT_KNOWN if value is None else f"{value:.0f} %"


def _time(value_s: float | None) -> str:
    return "" if value_s is None else f"{int(value_s) // 60}:{int(value_s) % 60:02d} min"


def _age(age_s: float) -> str:
    if age_s <= STALE_S:
        return "live"
    return "never" if math.isinf(age_s) else f"{duration(age_s)} ago"


def _behind(age_s: float) -> str:
    if age_s <= 0.0:
        return "complete"
    return "not here" if math.isinf(age_s) else f"{duration(age_s)} behind"


def _at_home(telemetry: Telemetry) -> str:
    if telemetry.left_at_home_percent is None:
        return ""
    return f"{telemetry.left_at_home_percent:.0f} % at home"


def _left(telemetry: Telemetry) -> str:
    if telemetry.frontiers is None:
        return ""
    return f"{telemetry.frontiers} place{'' if telemetry.frontiers == 1 else 's'} left"


def _times_100(value: float | None) -> float | None:
    return None if value is None else 100.0 * value


def _share(percent: float | None) -> float | None:
    return None if percent is None else min(max(percent / 100.0, 0.0), 1.0)
