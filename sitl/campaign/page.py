"""The report of a campaign: distributions, a table of all groups, and the worst missions with how to fly them again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.mapping.files.whole import whole_file
from sitl.campaign.bounds import CONFIDENCE, at_most, wilson
from sitl.campaign.curves import bands, completeness_picture, shares_picture, times_picture
from sitl.campaign.groups import Group, cells, kinds, variant_name, world_name
from sitl.campaign.mission import Campaign, Row
from sitl.campaign.worst import Worst, again, worst_of, write_settings
from sitl.report import html
from sitl.report.cards import UNKNOWN, Card, State, seconds
from sitl.report.html import Picture, Section

REPORT = "report.html"

_FILES = (
    ("missions.parquet", "every figure of every mission, one row each, with its settings"),
    ("missions.jsonl", "the same in the order in which they ended; what the campaign goes on from"),
    ("campaign.json", "what was asked for, and of which software"),
)
_HEADINGS = (
    *("group", "missions", "failed", "complete", "contacts", "t_f median", "t_f 90 %", "t_f worst"),
    *("way median", "way longest", "least distance", "least completeness"),
)


def write_report(folder: Path, campaign: Campaign, rows: Sequence[Row]) -> None:
    """Write the report of the missions that have been flown, and the settings of the worst of them.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    worst = worst_of(campaign, rows)
    write_settings(folder, worst)
    with whole_file(folder / REPORT) as file:
        file.write(_page(folder, campaign, rows, worst).encode("utf-8", errors="replace"))


def _page(folder: Path, campaign: Campaign, rows: Sequence[Row], worst: Sequence[Worst]) -> str:
    everything, groups = Group("all", tuple(rows)), kinds(campaign, rows)
    title = f"Campaign {folder.resolve().name}"
    state, sentence = _verdict(everything, len(campaign.missions))
    compared = f"{len(groups)} groups compared: {', '.join(campaign.several) or 'worlds'}"
    worlds = len({row["given_world"] for row in rows})
    # Workers of a cluster that came later may have brought another one.
    software = " and ".join(sorted({str(row["software"]) for row in everything.flown}))
    facts = f"{worlds} world{'s' * (worlds != 1)} · {compared} · software {software or UNKNOWN}"
    times = Picture(
        times_picture(groups),
        "The share of the missions whose map was complete after the time below: look for curves that rise late, and "
        f"for those that end below 100 %. {bands(groups)}".rstrip(),
    )
    named = [
        (str(one.mission.number), world_name(one.row), str(one.mission.seed), variant_name(campaign, one.row),
         "; ".join(one.why), again(folder, one.mission))
        for one in worst
    ]  # fmt: skip
    return html.document(
        title,
        f"""{html.headline(title, state, sentence, facts, _cards(everything, len(campaign.missions)))}
{html.section(Section("How long it took", [times]))}
{html.section(Section("The way flown, the map, and the walls", list(_halves(groups))))}
<h2>Groups</h2>
{html.table(_HEADINGS, [_line(group) for group in [*cells(campaign, rows), everything]])}
<h2>The worst missions, and how to fly them again</h2>
{html.table(("mission", "world", "seed", "of group", "why", "command"), named, code=(5,))}
<h2>Files beside this report</h2>
{html.links(_FILES)}""",
    )


def _halves(groups: Sequence[Group]) -> Iterator[Picture]:
    critical_m = {value for group in groups for value in group.figures("critical_margin_m")}
    yield Picture(
        shares_picture(groups, "path_length_m", "length of the way in m"),
        "The share of the missions whose way was at most so long, complete or not, in the colours from above: look for "
        "long tails.",
        half=True,
    )
    yield Picture(
        completeness_picture(groups, "completeness", "completeness at the end"),
        "The share of the missions whose map was at most so complete at the end: look for what is left of the line.",
        half=True,
    )
    yield Picture(
        shares_picture(
            groups,
            "least_d_m",
            "least true distance to a wall in m",
            *((critical_m.pop(), "$d_c$") if len(critical_m) == 1 else ()),
        ),
        "The share of the missions that came at least so near to a wall: look for what is left of d_c.",
        half=True,
    )
    yield Picture(
        shares_picture(groups, "estimate_error", "estimated completeness less the true one, at the end", 0.0, "right"),
        "The share of the missions whose own estimate of their map was at most so much too high: look for what lies "
        "right of the line, maps that were taken for more than they were.",
        half=True,
    )
    yield Picture(
        completeness_picture(groups, "completeness_when_done", "completeness when the vehicle was done"),
        "The share of the missions whose map was at most so complete when the vehicle would have ended the flight by "
        "itself: look for what is left of the line. Missions that the truth ended before are not counted; with "
        "sim.ends done all are.",
        half=True,
    )
    yield Picture(
        shares_picture(groups, "speed_mps", "mean speed in m/s"),
        "The share of the missions that flew at most so fast in the mean: look for those that mostly stood.",
        half=True,
    )


def _verdict(everything: Group, asked: int) -> tuple[State, str]:
    missions, flown = len(everything.rows), len(everything.flown)
    parts = [f"{missions} of {asked} missions have ended" if missions < asked else f"All {asked} missions have ended"]
    parts.append(f"{everything.complete} with a complete map")
    parts.append(f"{everything.contacts} with a contact")
    if everything.failed:
        parts.append(f"{everything.failed} failed")
    if everything.contacts or everything.failed:
        return State.BAD, f"{', '.join(parts)}."
    good = everything.complete == flown == asked
    return State.GOOD if good else State.LOOK, f"{', '.join(parts)}."


def _cards(everything: Group, asked: int) -> list[Card]:
    flown, least_m = everything.flown, min(everything.figures("least_d_m"), default=None)
    critical_m = min(everything.figures("critical_margin_m"), default=None)
    below = sum(float(str(row["in_d_c_share"])) > 0.0 for row in flown if row.get("in_d_c_share") is not None)
    way_m, simulated_s = everything.median("path_length_m"), sum(everything.figures("sim_time_s"))
    return [
        Card("Missions", f"{len(everything.rows)} of {asked}", f"{everything.failed} failed",
             State.BAD if everything.failed else State.GOOD),
        Card("Map complete", _share(everything.complete, len(flown)), _between(everything.complete, len(flown)),
             State.GOOD if everything.complete == len(everything.rows) else State.LOOK),
        Card("Contacts", str(everything.contacts), _below(everything.contacts, len(flown)),
             State.BAD if everything.contacts else State.GOOD),
        Card("Time to a complete map, t_f, median", _time(everything.time_quantile_s(0.5)),
             f"90 % within {_time(everything.time_quantile_s(0.9))}, "
             f"all within {_time(everything.time_quantile_s(1.0))}"),
        Card("Least distance to a wall", _metres(least_m),
             f"d_c is {_metres(critical_m)}; {below} missions came nearer",
             State.PLAIN if least_m is None or critical_m is None
             else State.GOOD if least_m >= critical_m else State.LOOK),
        Card("Way flown, median", _metres(way_m, 0),
             f"longest {_metres(max(everything.figures('path_length_m'), default=None), 0)}"),
        Card("Mean speed, median", _unit(everything.median("speed_mps"), "m/s"), ""),
        Card("Simulated", f"{simulated_s / 3600.0:.3g} h",
             f"{_unit(everything.median('times_real_time'), '× real time', 0)}, each mission"),
    ]  # fmt: skip


def _line(group: Group) -> tuple[str, ...]:
    flown = len(group.flown)
    return (
        group.name,
        str(len(group.rows)),
        str(group.failed),
        f"{group.complete} of {flown} ({_between(group.complete, flown)})",
        f"{group.contacts} ({_below(group.contacts, flown)})",
        *(_time(group.time_quantile_s(share)) for share in (0.5, 0.9, 1.0)),
        _metres(group.median("path_length_m"), 0),
        _metres(max(group.figures("path_length_m"), default=None), 0),
        _metres(min(group.figures("least_d_m"), default=None)),
        _unit(min(group.figures("completeness"), default=None), "", 4),
    )


def _share(count: int, of: int) -> str:
    # Rounded down: one of thousands that is missing must not read as 100 %.
    return _percent(math.floor(1000.0 * count / of) / 1000.0) if of else UNKNOWN


def _between(count: int, of: int) -> str:
    if not of:
        return "none was flown"
    low, high = wilson(count, of)
    return f"{_percent(low)} to {_percent(high)} at {_percent(CONFIDENCE, 0)}"


def _below(count: int, of: int) -> str:
    return f"in at most {_percent(at_most(count, of), 2)} at {_percent(CONFIDENCE, 0)}" if of else "none was flown"


def _percent(share: float, digits: int = 1) -> str:
    return f"{100.0 * share:.{digits}f} %"


def _time(time_s: float) -> str:
    return seconds(time_s) if math.isfinite(time_s) else "not reached"


def _metres(value: float | None, digits: int = 2) -> str:
    return _unit(value, "m", digits)


def _unit(value: float | None, unit: str, digits: int = 2) -> str:
    return UNKNOWN if value is None else f"{value:.{digits}f} {unit}".rstrip()
