"""The report of a campaign: distributions, a table of all groups, and the worst missions with how to fly them again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.mapping.files.whole import whole_file
from sitl.campaign.curves import bands, completeness_picture, ratios_picture, shares_picture, times_picture
from sitl.campaign.group_tables import group_tables
from sitl.campaign.groups import Group, cells, kinds, variant_name, world_name
from sitl.campaign.mission import Campaign, Row
from sitl.campaign.words import below, metres, share, sure, time, unit, within
from sitl.campaign.worst import Worst, again, worst_of, write_settings
from sitl.report import html
from sitl.report.cards import UNKNOWN, Card, State, number
from sitl.report.html import Picture, Section
from sitl.sim.simulation import COMPLETE_SHARE

REPORT = "report.html"

_FILES = (
    ("missions.parquet", "every figure of every mission, one row each, with its settings"),
    ("missions.jsonl", "the same in the order in which they ended; what the campaign goes on from"),
    ("campaign.json", "what was asked for, and of which software"),
)
_TOURS_FILE = ("tours.jsonl", "the tours that the missions are compared with")


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
    toured = any("tour_time_s" in row for row in rows)
    times = Picture(
        times_picture(groups),
        "The share of the missions whose map was complete after the time below: look for curves that rise late, and "
        f"for those that end below 100 %, where missions did not become complete. {bands(groups)}",
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
{"".join(_compared(groups, rows))}
<h2>Groups</h2>
{group_tables(_groups_of_tables(groups, cells(campaign, rows), everything), toured)}
{html.section(Section("The way flown, the map, and the walls", list(_halves(groups))))}
<h2>The worst missions, and how to fly them again</h2>
{html.table(("mission", "world", "seed", "of group", "why", "command"), named, code=(5,))}
<h2>Files beside this report</h2>
{html.links([*_FILES, _TOURS_FILE] if toured else _FILES)}""",
    )


def _groups_of_tables(groups: Sequence[Group], small: Sequence[Group], everything: Group) -> list[Group]:
    """All missions, then what is compared, then what that is in each world; nothing twice."""
    listed = {frozenset(id(row) for row in group.rows): group for group in (*small, *groups, everything)}
    order = [everything, *groups, *small]
    return [group for group in order if listed[frozenset(id(row) for row in group.rows)] is group]


def _compared(groups: Sequence[Group], rows: Sequence[Row]) -> Iterator[str]:
    """How the missions compare with the tours, where there are any; and of which worlds there is none."""
    if not any("tour_time_s" in row for row in rows):
        return
    never = "Missions whose map did not become complete never arrive."
    tour = "a good inspection tour at the same speed, of who knew the mine before"
    yield html.section(
        Section(
            "Compared with a good tour",
            [
                Picture(ratios_picture(groups, "time_ratio", "tour_time_s", "$t_f$ over the time of the tour"),
                        f"The share of the missions that took at most so many times as long as {tour}. {never}", True),
                Picture(ratios_picture(groups, "way_ratio", "tour_length_m", "way flown over the length of the tour"),
                        f"The same of the way. {never}", True),
            ],
        )
    )  # fmt: skip
    missing = dict.fromkeys(world_name(row) for row in rows if number(row, "tour_time_s") is None)
    blind = dict.fromkeys(
        world_name(row) for row in rows if (seen := number(row, "tour_share")) is not None and seen < COMPLETE_SHARE
    )
    if missing:
        yield html.paragraph(f"No tour was found of: {', '.join(missing)}. Their missions have no ratios.")
    if blind:
        yield html.paragraph(
            f"The tour sees less than {COMPLETE_SHARE:.0%} of what is visible, and is too short to compare with, in: "
            f"{', '.join(blind)}."
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
    nearer = sum(float(str(row["in_d_c_share"])) > 0.0 for row in flown if row.get("in_d_c_share") is not None)
    way_m, simulated_s = everything.median("path_length_m"), sum(everything.figures("sim_time_s"))
    return [
        Card("Missions", f"{len(everything.rows)} of {asked}", f"{everything.failed} failed",
             State.BAD if everything.failed else State.GOOD),
        Card("Map complete", share(everything.complete, len(flown)),
             f"{within(everything.complete, len(flown))} {sure()}",
             State.GOOD if everything.complete == len(everything.rows) else State.LOOK),
        Card("Contacts", str(everything.contacts), f"{below(everything.contacts, len(flown))} {sure()}",
             State.BAD if everything.contacts else State.GOOD),
        Card("Time to a complete map, t_f, median", time(everything.time_quantile_s(0.5)),
             f"90 % within {time(everything.time_quantile_s(0.9))}, "
             f"all within {time(everything.time_quantile_s(1.0))}"),
        Card("Least distance to a wall", metres(least_m),
             f"d_c is {metres(critical_m)}; {nearer} missions came nearer",
             State.PLAIN if least_m is None or critical_m is None
             else State.GOOD if least_m >= critical_m else State.LOOK),
        Card("Way flown, median", metres(way_m, 0),
             f"longest {metres(max(everything.figures('path_length_m'), default=None), 0)}"),
        Card("Mean speed, median", unit(everything.median("speed_mps"), "m/s"), ""),
        Card("Simulated", f"{simulated_s / 3600.0:.3g} h",
             f"{unit(everything.median('times_real_time'), '× real time', 0)}, each mission"),
    ]  # fmt: skip
