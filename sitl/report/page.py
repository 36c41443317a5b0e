"""The report of a flight: what stands on its page, in which order, and what to look for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from companion.mapping.files.whole import whole_file
from sitl.report import html
from sitl.report.cards import UNKNOWN, key_figures, rows, shown, verdict
from sitl.report.curves import distance_histogram, flight_picture, progress_picture
from sitl.report.data import ReportData
from sitl.report.graph import graph_png
from sitl.report.html import Picture, Section
from sitl.report.maps import map_pictures
from sitl.report.plan import Plan, overview_png, plan_of

_FILES = (
    ("map.ply", "the map as a point cloud, for CloudCompare, MeshLab and Open3D"),
    ("map.pcd", "the same for PCL and ROS"),
    ("map.laz", "the same for surveying software"),
    ("map.bt", "the map as an OctoMap"),
    ("graph.json", "the navigation graph, for GIS programs (GeoJSON)"),
    ("trajectory.csv", "every tick of the flight"),
)


def page_html(data: ReportData, sections: Iterable[Section]) -> str:
    """The whole page: headline, pictures, table, files and settings."""
    state, sentence = verdict(data)
    facts = ((name, shown(data.summary.get(name))) for name in ("world", "seed", "preset"))
    line = " · ".join(f"{name} {value}" for name, value in facts if value != UNKNOWN)
    return html.document(
        data.title,
        f"""{html.headline(data.title, state, sentence, line, key_figures(data))}
{"".join(html.section(section) for section in sections)}
<h2>Summary</h2>
{html.names_and_values(rows(data.summary))}
<h2>Files beside this report</h2>
{html.links(_FILES)}
{html.folded("Settings of this flight", data.settings_yaml)}""",
    )


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
    plan = plan_of(data)
    colours = "one colour a vehicle" if several else "coloured by mode"
    yield Section(
        "The way flown",
        [
            Picture(
                overview_png(data, plan),
                f"The mine from above and the way flown, {colours}; the outline is its walls at flying height: look "
                "for drifts that no line enters, and for lines that come near a wall.",
            )
        ],
    )
    if data.graphs:
        yield Section("The navigation graph", [_graph(data, plan, index) for index in range(len(data.graphs))])
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


def _graph(data: ReportData, plan: Plan | None, index: int) -> Picture:
    graph = data.graphs[index]
    counts = graph.counts()
    whose = f"Vehicle {index + 1}: the" if len(data.graphs) > 1 else "The"
    return Picture(
        graph_png(data, plan, graph),
        f"{whose} navigation graph (Definition 3.5) as far as it was met: {counts.vertices} vertices, {counts.edges} "
        f"edges, {counts.exits_untaken} of {counts.exits} exits not taken. What was flown often is thicker. Look for "
        "red crosses and circles, where an exit leads to what nobody has come to, and for vertices that lie doubled, "
        "where a place was not known again.",
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
