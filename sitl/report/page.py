"""The report as one HTML file. All text that comes from outside is escaped here, and nowhere else."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path

from companion.mapping.files.whole import whole_file
from sitl.report.cards import UNKNOWN, Card, State, key_figures, rows, shown, verdict
from sitl.report.curves import distance_histogram, flight_picture, progress_picture
from sitl.report.data import ReportData
from sitl.report.maps import map_pictures
from sitl.report.plan import overview_png

_MARKS = {State.GOOD: ("✓", "met"), State.LOOK: ("!", "look here"), State.BAD: ("✕", "failed"), State.PLAIN: ("", "")}
_FILES = (
    ("map.ply", "the map as a point cloud, for CloudCompare, MeshLab and Open3D"),
    ("map.pcd", "the same for PCL and ROS"),
    ("map.laz", "the same for surveying software"),
    ("map.bt", "the map as an OctoMap"),
    ("trajectory.csv", "every tick of the flight"),
)


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture and the sentence below it; ``half`` pictures stand beside their like."""

    png: bytes
    caption: str
    half: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and its pictures."""

    title: str
    pictures: Sequence[Picture]


def page_html(data: ReportData, sections: Iterable[Section]) -> str:
    """The whole page: headline, pictures, table, files and settings."""
    style = resources.files("sitl.report").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{escape(data.title)}</title>
<style>
{style}</style>
</head>
<body>
<main>
{_headline(data)}
{"".join(_section(section) for section in sections)}
<h2>Summary</h2>
<table>
{"".join(_row(name, value) for name, value in rows(data.summary))}</table>
<h2>Files beside this report</h2>
<ul class="files">
{"".join(_link(name, what) for name, what in _FILES)}</ul>
<details><summary>Settings of this flight</summary><pre>{escape(data.settings_yaml)}</pre></details>
</main>
</body>
</html>
"""


def _headline(data: ReportData) -> str:
    state, sentence = verdict(data)
    facts = ((name, shown(data.summary.get(name))) for name in ("world", "seed", "preset"))
    line = " · ".join(f"{name} {value}" for name, value in facts if value != UNKNOWN)
    return f"""<h1>{escape(data.title)}</h1>
<p class="verdict {state}">{_mark(state)}{escape(sentence)}</p>
<p class="facts">{escape(line)}</p>
<ul class="cards">
{"".join(_card(card) for card in key_figures(data))}</ul>
"""


def _card(card: Card) -> str:
    kind = "value words" if card.words else "value"
    mark = "" if card.value == UNKNOWN else _mark(card.state)
    return (
        f'<li class="{card.state}"><span class="label">{_prose(card.label)}</span>'
        f'<span class="{kind}">{mark}{escape(card.value)}</span>'
        f'<span class="note">{_prose(card.note)}</span></li>\n'
    )


def _mark(state: State) -> str:
    sign, meaning = _MARKS[state]
    return f'<span class="mark" role="img" aria-label="{meaning}">{sign}</span> ' if sign else ""


def _section(section: Section) -> str:
    wide = "".join(_figure(picture) for picture in section.pictures if not picture.half)
    half = "".join(_figure(picture) for picture in section.pictures if picture.half)
    pair = f'<div class="pair">\n{half}</div>\n' if half else ""
    return f"<h2>{escape(section.title)}</h2>\n{wide}{pair}"


def _figure(picture: Picture) -> str:
    source = f"data:image/png;base64,{base64.b64encode(picture.png).decode('ascii')}"
    return (
        f'<figure><div><img alt="{escape(picture.caption)}" src="{source}"></div>'
        f"<figcaption>{_prose(picture.caption)}</figcaption></figure>\n"
    )


def _prose(text: str) -> str:
    """Our own words, with the symbols of the paper set as it sets them."""
    return re.sub(r"\b([dt])_([a-z])\b", r"<i>\1</i><sub>\2</sub>", escape(text))


def _row(name: str, value: str) -> str:
    return f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>\n"


def _link(name: str, what: str) -> str:
    return f'<li><a href="{name}">{name}</a> <span>{what}</span></li>\n'


def write_report(path: Path, data: ReportData) -> None:
    """Writes the report to ``path``: one HTML file that needs no other, replaced only once the new one is complete.

    Raises:
        OSError: the file cannot be written; what was there before is then still there.
    """
    # A name from a damaged file system may hold characters that UTF-8 does not have.
    content = page_html(data, _sections(data)).encode("utf-8", errors="replace")
    with whole_file(path) as file:
        file.write(content)


def _sections(data: ReportData) -> Iterator[Section]:
    several = len(data.flights) > 1
    colours = "one colour a vehicle" if several else "coloured by mode"
    yield Section(
        "The way flown",
        [
            Picture(
                overview_png(data),
                f"The mine from above and the way flown, {colours}; the outline is its walls at flying height: look "
                "for drifts that no line enters, and for lines that come near a wall.",
            )
        ],
    )
    maps = map_pictures(data)
    if maps is not None:
        above, oblique = maps
        yield Section(
            "The map",
            [
                Picture(
                    oblique,
                    "The map with everything above the flying height taken off: look for holes in floors and walls; "
                    "red is what could have been seen but is missing, on the roof too.",
                ),
                Picture(above, "The same from straight above: look for walls that are crooked, doubled or broken."),
            ],
        )
    if data.flights:
        yield Section("The flight over time", [_flight(data, index) for index in range(len(data.flights))])
    yield Section(
        "Progress and distance",
        [
            Picture(
                progress_picture(data),
                "How much of the visible surface was mapped when: look for long flat stretches, in which the vehicle "
                "flew where everything had been seen.",
                half=True,
            ),
            Picture(
                distance_histogram(data),
                "How much of the time was spent how near to a wall: look for red bars, left of d_c, and for how far "
                "the bulk is from d_s.",
                half=True,
            ),
        ],
    )


def _flight(data: ReportData, index: int) -> Picture:
    flight = data.flights[index]
    several = len(data.flights) > 1
    whose = f"Vehicle {flight.vehicle_id}: distance" if several else "Distance"
    layers = "; where h leaves H for a while, others were near and each kept to its own layer" if several else ""
    return Picture(
        flight_picture(flight, data),
        f"{whose} to the nearest wall, height above ground and mode: look for blue in the red band, nearer than d_c, "
        f"and for grey that leaves the blue, which is a wrong measurement{layers}.",
    )
