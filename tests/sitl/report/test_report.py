"""The report: what it shows, that it is whole, and that its pictures are right."""

from __future__ import annotations

import base64
import io
import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from numpy.typing import NDArray

from companion.control.graph import EdgeKind, Graph
from companion.control.left_out import LeftOut, Why
from companion.model import Measurement, Mode, Pose, Setpoint
from companion.viewer.graphs import EDGE_COLOURS, UNVISITED
from sitl.report import ReportData, overview_png, write_report
from sitl.report.cards import State, key_figures, rows, seconds, shown, verdict
from sitl.report.data import stretches, thinned
from sitl.report.graph import graph_png
from sitl.report.maps import below_cut, map_pictures
from sitl.report.plan import mine_plan, plan_of, section
from sitl.report.splat import Camera, render
from sitl.report.style import DPI, STRIP_IN, WIDTH_IN, round_length_m
from sitl.sim.flight_log import FlightLog
from tests.shared.graphs import small_graph

PNG = b"\x89PNG\r\n\x1a\n"
SIZE_M = (8.0, 5.0, 3.0)
ABOVE = Camera(-math.pi / 2, math.pi / 2)
WHITE = 255


def box() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A closed room of `SIZE_M` from the origin on."""
    vertices = np.array(list(itertools.product(*((0.0, size) for size in SIZE_M))))
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return vertices, np.array([corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))])


def flight(ticks: int, vehicle_id: int = 1) -> FlightLog:
    """Round the room on an ellipse, with a mode after the other."""
    log = FlightLog(vehicle_id)
    modes = tuple(Mode)
    for k in range(ticks):
        t_s, angle = 0.05 * k, 2.0 * math.pi * k / max(ticks, 1)
        pose = Pose(t_s, 4.0 + 2.5 * math.cos(angle), 2.5 + 1.2 * math.sin(angle), 1.5, 0.0)
        d_m = None if k % 50 == 0 else 1.3 + 0.2 * math.sin(3.0 * angle)
        measurement = Measurement(t_s, 0.0, None, 1.5, None, None, d_m, None, d_m, None, math.nan, 0.0)
        log.append(pose, pose, measurement, modes[4 * k // ticks], Setpoint(t_s, 0.5, 0.0, 0.0), 0.5)
    log.column("true_d_m")[::2] = 1.3
    return log


def voxels(voxel_m: float) -> NDArray[np.float64]:
    """The walls, floor and roof of the room as voxels."""
    counts = [round(size / voxel_m) for size in SIZE_M]
    cells = np.array(list(itertools.product(*(range(-1, count + 1) for count in counts))))
    shell = ((cells == -1) | (cells == np.array(counts))).any(axis=1)
    return np.asarray((cells[shell] + 0.5) * voxel_m)


def data(ticks: int = 400, vehicles: int = 1) -> ReportData:
    vertices, triangles = box()
    return ReportData(
        title="Flight in room, seed 7",
        summary={
            "world": "room",
            "seed": 7,
            "preset": "flight",
            "completeness": 0.99431,
            "precision": 0.985,
            "accuracy_m": 0.0312,
            "completed_at_s": 83.0,
            "sim_time_s": 90.0,
            "wall_time_s": 4.5,
            "times_real_time": 20.0,
            "path_length_m": 41.7,
            "contacts": 0,
            "least_d_m": 0.913,
            "time_below_d_s_fraction": 0.25,
            "mode_changes": 3,
            "draws": 2,
            "ended_because": "complete",
            "estimated_completeness": 0.9731,
            "done_at_s": 88.0,
            "completeness_when_done": 0.9942,
            "left_out": [{"x_m": 2.0, "y_m": 1.0, "z_m": 1.5, "extent_m": 1.2, "why": "too narrow"}],
            "versions": {"numpy": "2.0"},
        },
        vertices_m=vertices,
        triangles=triangles,
        flights=tuple(flight(ticks, number + 1) for number in range(vehicles)),
        progress=np.stack([np.linspace(0.0, 90.0, 46), np.linspace(0.0, 0.99431, 46)], axis=1),
        occupied_m=voxels(0.25),
        voxel_m=0.25,
        missed_m=np.array([[1.0, 1.0, 0.0], [1.1, 1.0, 0.0], [4.0, 2.5, 3.0]], dtype=np.float32),
        margin_m=1.0,
        critical_margin_m=0.7,
        left_out=(LeftOut(2.0, 1.0, 1.5, 1.2, Why.TOO_NARROW), LeftOut(6.0, 4.0, 1.5, 2.0, Why.TOO_LOW)),
        height_m=1.5,
        settings_yaml="control:\n  margin_m: 1.0\n",
    )


def written(path: Path, report: ReportData) -> str:
    write_report(path / "report.html", report)
    return (path / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Pictures of few pixels, which take a tenth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sitl.report.style.DPI", 40)
        patch.setattr("sitl.report.maps.DPI", 40)
        yield


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of `data`."""
    return written(tmp_path_factory.mktemp("run"), data())


def pictures(html: str) -> list[bytes]:
    return [base64.b64decode(code) for code in re.findall(r'src="data:image/png;base64,([^"]+)"', html)]


# The page


def test_a_report_is_one_file_that_needs_no_other(tmp_path: Path) -> None:
    html = written(tmp_path, data())
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
    assert all(source.startswith("data:image/png;base64,") for source in re.findall(r'src="?([^"> ]+)', html))
    around_pictures = re.sub(r'"data:image/png;base64,[^"]+"', "", html)
    assert not re.search(r"//\w|<script|<link|@import|url\(", around_pictures)


def test_it_shows_every_picture_with_words_for_those_who_cannot_see_it(html: str) -> None:
    found = pictures(html)
    assert len(found) == 6  # the way, the map twice, the flight, progress, distances
    assert all(picture.startswith(PNG) for picture in found)
    assert html.count("<figcaption>") == len(re.findall(r'<img alt="[^"]{20,}"', html)) == 6


def test_it_shows_the_key_figures_the_table_the_files_and_the_settings(html: str) -> None:
    for text in ("99.4 %", "83 s", "0.91 m", "3.1 cm", "42 m", "20 × real time", "25.0 % of the time", "complete"):
        assert text in html
    assert "<th>time_below_d_s_fraction</th><td>0.25</td>" in html
    assert "<th>versions.numpy</th><td>2.0</td>" in html
    for name in ("map.ply", "map.pcd", "map.laz", "map.bt", "trajectory.csv"):
        assert f'<a href="{name}">' in html
    assert "<details><summary>Settings of this flight</summary><pre>control:\n  margin_m: 1.0\n</pre>" in html


def test_text_from_outside_is_only_ever_text(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>\"'&$x^{$"
    report = data()
    summary = {**report.summary, "world": hostile, "ended_because": hostile, hostile: {hostile: [hostile]}}
    html = written(tmp_path, replace(report, title=hostile, summary=summary, settings_yaml=f"</pre>{hostile}"))
    assert "<script" not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&#x27;&amp;$x^{$") >= 7
    assert html.count("</pre>") == 1


def test_a_file_name_that_is_no_text_can_be_in_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.report.page._sections", lambda _: [])
    assert "mine_?" in written(tmp_path, replace(data(), title="mine_\udcff"))


@pytest.mark.parametrize(("ticks", "vehicles"), [(0, 1), (0, 2), (1, 1), (2, 2)])
def test_a_flight_that_never_began_has_a_report(tmp_path: Path, ticks: int, vehicles: int) -> None:
    report = replace(data(ticks, vehicles), progress=np.empty((0, 2)), missed_m=np.empty((0, 3)))
    assert len(pictures(written(tmp_path, report))) == 5 + vehicles


def test_a_report_of_nothing_can_be_written(tmp_path: Path) -> None:
    nothing = replace(
        data(),
        summary={},
        vertices_m=np.empty((0, 3)),
        triangles=np.empty((0, 3), np.int64),
        flights=(),
        progress=np.empty((0, 2)),
        occupied_m=np.empty((0, 3)),
        missed_m=np.empty((0, 3)),
        settings_yaml="",
    )
    html = written(tmp_path, nothing)
    assert "It is not known how complete the map is" in html
    assert len(pictures(html)) == 3


def test_a_map_without_voxels_and_one_without_gaps_are_drawn() -> None:
    none = np.empty((0, 3))
    for report in (replace(data(), occupied_m=none), replace(data(), missed_m=none)):
        above, oblique = map_pictures(report) or (b"", b"")
        assert above.startswith(PNG)
        assert oblique.startswith(PNG)
    assert map_pictures(replace(data(), occupied_m=none, missed_m=none)) is None


def test_each_vehicle_has_its_own_picture_of_the_flight(tmp_path: Path) -> None:
    html = written(tmp_path, data(vehicles=3))
    assert len(pictures(html)) == 8
    assert all(f"<figcaption>Vehicle {number}: " in html for number in (1, 2, 3))


def test_each_vehicle_has_its_navigation_graph_drawn_over_the_plan(tmp_path: Path) -> None:
    """Protects the paper's Fig. 6: counts in words, and on the plan the colour of every edge and of an open exit."""
    html = written(tmp_path, replace(data(vehicles=2), graphs=(small_graph(), small_graph())))
    assert len(pictures(html)) == 6 + 1 + 2
    assert "3 vertices, 3 edges, 3 of 4 exits not taken" in html
    assert all(f"<figcaption>Vehicle {number}: the navigation graph" in html for number in (1, 2))
    plan = plan_of(data())
    image = imread(io.BytesIO(graph_png(data(), plan, small_graph())))[..., :3]
    bare = imread(io.BytesIO(graph_png(data(), plan, Graph())))[..., :3]
    for colour in (EDGE_COLOURS[EdgeKind.TANGENT], EDGE_COLOURS[EdgeKind.BOUNDARY], UNVISITED):
        near = [np.abs(picture - to_rgb(colour)).max(axis=-1) < 0.1 for picture in (image, bare)]
        assert near[0].any()
        assert not near[1].any()


def test_a_long_flight_stays_a_small_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for room in ("style", "maps"):
        monkeypatch.setattr(f"sitl.report.{room}.DPI", DPI)
    assert len(written(tmp_path, data(ticks=50_000))) < 6_000_000


def test_the_overview_alone_is_the_first_picture_of_the_report(html: str) -> None:
    assert overview_png(data(), plan_of(data())) == pictures(html)[0]


# Whole or not at all


def test_what_was_there_stays_until_the_new_report_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> str:
        raise RuntimeError("no ink")

    path = tmp_path / "report.html"
    path.write_text("the old one")
    monkeypatch.setattr("sitl.report.page.page_html", fails)
    with pytest.raises(RuntimeError, match="no ink"):
        write_report(path, data())
    assert path.read_text() == "the old one"


def test_a_report_that_cannot_be_put_in_place_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sitl.report.page._sections", lambda _: [])
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OSError, match=r"report\.html"):
        write_report(tmp_path / "report.html", data(ticks=1))
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


# Words and numbers


@pytest.mark.parametrize(
    ("completeness", "contacts", "state", "words"),
    [
        (0.99, 0, State.GOOD, "The map is complete, and no wall was touched."),
        (0.98999, 0, State.LOOK, "The map is not complete (98.9 %), and no wall was touched."),
        (1.0, 1, State.BAD, "The map is complete, and walls were touched once."),
        (0.5, 3, State.BAD, "The map is not complete (50.0 %), and walls were touched 3 times."),
        (math.nan, None, State.LOOK, "It is not known how complete the map is, and it is not known whether a wall was"),
    ],
)
def test_the_verdict_says_what_matters(completeness: float, contacts: int | None, state: State, words: str) -> None:
    report = replace(data(), summary={"completeness": completeness, "contacts": contacts})
    assert verdict(report)[0] is state
    assert verdict(report)[1].startswith(words)


def test_vehicles_that_collided_are_no_good_flight() -> None:
    """Protects from a green page over two wrecks."""
    report = replace(data(), summary={"completeness": 1.0, "contacts": 0, "collisions": 1})
    assert verdict(report) == (State.BAD, "The map is complete, and no wall was touched, but vehicles collided.")


def test_what_is_not_known_is_a_dash_on_every_card() -> None:
    unknown: dict[str, object] = dict.fromkeys(data().summary, math.nan)
    for summary in ({}, dict.fromkeys(unknown, None), unknown):
        assert {card.value for card in key_figures(replace(data(), summary=summary))} == {"-"}


def test_the_report_says_through_how_narrow_a_place_it_flies() -> None:
    sizes = {"enters_width_m": 2.3, "enters_height_m": 2.0, "least_width_m": 1.9, "least_height_m": 1.0}
    cards = {card.label: card for card in key_figures(replace(data(), summary={"passages": sizes}))}
    assert cards["Flies into"].value == "2.30 x 2.00 m"
    assert "1.90 x 1.00 m" in cards["Flies into"].note


def test_the_report_shows_the_vehicles_own_word_beside_the_truth() -> None:
    cards = {card.label: card for card in key_figures(data())}
    assert cards["The vehicle's own word"].value == "97.3 %"
    assert cards["The vehicle's own word"].note == "done after 88 s, with 99.4 % in truth"
    assert cards["Seen and left out"].value == "1 too low, 1 too narrow"
    early = {card.label: card for card in key_figures(replace(data(), summary={"estimated_completeness": 0.5}))}
    assert early["The vehicle's own word"].note == "not done when it ended"


def test_what_was_left_out_is_drawn_where_it_lies() -> None:
    """Protects whoever goes there with a lamp: a cross in the colour of warnings at that place of the plan."""
    reports = data(), replace(data(), left_out=())
    crossed, plain = (imread(io.BytesIO(overview_png(report, plan_of(report)))) for report in reports)
    width_px = crossed.shape[1]
    different = np.any(crossed != plain, axis=2)[: -round(STRIP_IN / WIDTH_IN * width_px)]
    rows_px, columns_px = (np.flatnonzero(different.any(axis=axis)) for axis in (1, 0))
    # From the western edge of a circle 1.2 m wide about (2, 1) to the eastern one of another, 2 m wide, about (6, 4).
    assert columns_px[0] / width_px == pytest.approx(1.4 / SIZE_M[0], abs=0.05)
    assert (columns_px[-1] - columns_px[0]) / width_px == pytest.approx(5.6 / SIZE_M[0], abs=0.05)
    assert (rows_px[-1] - rows_px[0]) / width_px == pytest.approx(4.6 / SIZE_M[0], abs=0.05)


def test_coming_nearer_than_the_critical_margin_is_marked() -> None:
    cards = {card.label: card for card in key_figures(replace(data(), summary={"least_d_m": 0.69}))}
    assert cards["Least distance to a wall"].state is State.LOOK


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (math.nan, "-"),
        (math.inf, "-"),
        (np.float64(0.123456789), "0.123457"),
        (np.int64(1234567), "1234567"),
        (True, "yes"),
        ([], "-"),
        ([1, None], "1, -"),
        (list(range(20)), "0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 ... (20 in all)"),
        ("text", "text"),
    ],
)
def test_values_are_shown_for_people(value: object, text: str) -> None:
    assert shown(value) == text


def test_nested_values_get_names_with_dots() -> None:
    assert list(rows({"a": {"b": {"c": 1}}, "d": 2})) == [("a.b.c", "1"), ("d", "2")]


@pytest.mark.parametrize(
    ("value_s", "text"), [(4.52, "4.5 s"), (83.2, "83 s"), (119.4, "119 s"), (1234.0, "1234 s (20 min 34 s)")]
)
def test_durations_are_shown_in_the_unit_that_one_thinks_in(value_s: float, text: str) -> None:
    assert seconds(value_s) == text


@pytest.mark.parametrize(("extent_m", "length_m"), [(50.0, 10.0), (49.0, 5.0), (9.0, 1.0), (0.6, 0.1), (1200.0, 200.0)])
def test_scale_bars_have_round_lengths(extent_m: float, length_m: float) -> None:
    assert round_length_m(extent_m) == pytest.approx(length_m)


# Fewer values


def test_thinning_keeps_dips_peaks_and_gaps() -> None:
    t_s, values = np.arange(10_000.0), np.ones(10_000)
    values[1234], values[5678], values[8000:8500] = -3.0, 7.0, np.nan
    thin_t_s, thin = thinned(t_s, values, 100)
    assert len(thin) == 200
    assert (np.diff(thin_t_s) >= 0.0).all()
    assert values[thin_t_s.astype(int)] == pytest.approx(thin, nan_ok=True)
    assert (np.nanmin(thin), np.nanmax(thin)) == (-3.0, 7.0)
    assert np.isnan(thin[(thin_t_s >= 8000) & (thin_t_s < 8500)]).all()


def test_short_series_are_not_thinned() -> None:
    t_s = np.arange(150.0)
    assert thinned(t_s, 2.0 * t_s, 100)[1] == pytest.approx(2.0 * t_s)


def test_stretches_cover_all_ticks_once() -> None:
    starts, ends = stretches(np.array([1, 1, 2, 2, 2, 1], np.uint8))
    assert starts.tolist() == [0, 2, 5]
    assert ends.tolist() == [2, 5, 6]
    assert len(stretches(np.empty(0, np.uint8))[0]) == 0


# The plan


def test_a_section_of_a_room_is_its_outline() -> None:
    vertices, triangles = box()
    segments = section(vertices, triangles, np.full(len(vertices), 1.5))
    assert np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum() == pytest.approx(2.0 * (8.0 + 5.0))
    on_wall = np.isclose(segments[..., 0], 0.0) | np.isclose(segments[..., 0], 8.0)
    on_wall |= np.isclose(segments[..., 1], 0.0) | np.isclose(segments[..., 1], 5.0)
    assert on_wall.all()


def test_a_section_follows_the_flight_up_a_slope() -> None:
    vertices, triangles = box()
    x_m = np.linspace(1.0, 7.0, 50)
    # Up by more than the room is high: a level cut would meet floor and roof.
    vertices[:, 2] += 0.5 * vertices[:, 0]
    flown = np.stack([x_m, np.full(50, 2.5), 0.5 * x_m + 1.5], axis=1)
    plan = mine_plan(vertices, triangles, [flown], 1.5)
    assert plan is not None
    lengths = np.linalg.norm(plan.walls_m[:, 1] - plan.walls_m[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(2.0 * (8.0 + 5.0), rel=0.02)


@pytest.mark.parametrize("turn_rad", [0.0, 0.3, math.pi / 4])
def test_what_a_mine_covers_has_no_holes(turn_rad: float) -> None:
    vertices, triangles = box()
    turn = np.array([[math.cos(turn_rad), -math.sin(turn_rad)], [math.sin(turn_rad), math.cos(turn_rad)]])
    plan = mine_plan(np.concatenate([vertices[:, :2] @ turn.T, vertices[:, 2:]], axis=1), triangles, [], 1.5)
    assert plan is not None
    west, east, south, north = plan.extent_m
    pixel_m = (east - west) / plan.covered.shape[1]
    x_m, y_m = np.meshgrid(*(np.arange(n) for n in plan.covered.shape[::-1]))
    x_m, y_m = west + (x_m + 0.5) * pixel_m, south + (y_m + 0.5) * (north - south) / plan.covered.shape[0]
    along, across = np.moveaxis(np.stack([x_m, y_m], axis=-1) @ turn, -1, 0)
    inside = np.minimum(np.minimum(along, 8.0 - along), np.minimum(across, 5.0 - across))
    assert plan.covered[inside > pixel_m].all()
    assert not plan.covered[inside < -pixel_m].any()


# The map


def test_the_roof_is_cut_away_and_the_walls_up_to_the_flying_height_stay() -> None:
    points = voxels(0.25)
    kept = points[below_cut(points, 1.5)]
    assert kept[:, 2].max() == pytest.approx(1.125, abs=0.25)  # 1.5 m above the voxels of the floor, at -0.125 m
    assert (kept[:, 2] < 0.0).sum() == (points[:, 2] < 0.0).sum()


def test_the_cut_follows_a_slope() -> None:
    points = voxels(0.25)
    rise = 0.25 * points[:, 0]
    sloping = points + np.stack([np.zeros_like(rise), np.zeros_like(rise), rise], axis=1)
    kept = below_cut(sloping, 1.5)
    # Floor and walls stay and the roof goes, but for the metre over which the lowest point counts as floor.
    assert kept[points[:, 2] < 0.9].all()
    assert not kept[points[:, 2] > 2.0].any()


def test_the_nearer_cube_hides_the_other() -> None:
    red, blue = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    cubes, colours = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 1.5]]), np.stack([red, blue])
    for order in ([0, 1], [1, 0]):
        drawn = render(cubes[order], colours[order], 1.0, ABOVE, (60, 60)).rgb
        middle = drawn[drawn.shape[0] // 2, drawn.shape[1] // 2]
        assert middle[2] > 200
        assert middle[0] == middle[1] == 0
        assert (drawn[0, 0] == WHITE).all()


def test_north_is_up_and_a_pixel_is_as_large_as_it_says() -> None:
    cubes = np.array([[0.5, 0.5, 0.5], [9.5, 4.5, 0.5]])
    drawn = render(cubes, np.zeros((2, 3)), 1.0, ABOVE, (1000, 1000))
    row, column = np.nonzero((drawn.rgb < WHITE).any(axis=2))
    assert np.ptp(column) * drawn.pixel_m == pytest.approx(10.0, abs=0.1)
    assert np.ptp(row) * drawn.pixel_m == pytest.approx(5.0, abs=0.1)
    assert row[column < drawn.rgb.shape[1] // 2].min() > row[column > drawn.rgb.shape[1] // 2].max()


@pytest.mark.parametrize("elevation_rad", [math.pi / 2, 0.8, 0.3])
@pytest.mark.parametrize("box_px", [(40, 40), (300, 200), (901, 777)])
def test_a_closed_surface_of_cubes_shows_no_cracks(elevation_rad: float, box_px: tuple[int, int]) -> None:
    x, y = np.meshgrid(np.arange(30), np.arange(20))
    cubes = np.stack([0.1 * x.ravel(), 0.1 * y.ravel(), np.zeros(x.size)], axis=1)
    drawn = render(cubes, np.zeros((len(cubes), 3)), 0.1, Camera(-1.1, elevation_rad), box_px).rgb
    assert drawn.shape[1] <= box_px[0] + 1
    assert drawn.shape[0] <= box_px[1] + 1
    filled: NDArray[np.bool_] = np.asarray((drawn < WHITE).any(axis=2))
    for line in [*filled, *filled.T]:
        inside = np.flatnonzero(line)
        assert len(inside) == 0 or np.ptp(inside) + 1 == len(inside)
    within = np.lib.stride_tricks.sliding_window_view(filled, (5, 5)).all(axis=(2, 3))
    assert (drawn[2:-2, 2:-2][within] == 0).all()


def test_corners_are_darker_than_open_floor() -> None:
    points = voxels(0.25)
    kept = points[below_cut(points, 1.5)]
    drawn = render(kept, np.ones_like(kept), 0.25, ABOVE, (400, 400))
    light = drawn.rgb[..., 0].astype(float)
    rows_px, columns_px = light.shape
    beside_wall = light[rows_px // 2, int(0.9 / drawn.pixel_m)]  # the picture begins 0.75 m outside the wall
    assert beside_wall < 0.9 * light[rows_px // 2, columns_px // 2]
