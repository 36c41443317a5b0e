"""The page without a browser: what is in its scene, and what happens when its parts are asked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from sitl.launch.processes import free_tcp_port

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

from companion.config.mapping import MapSettings
from companion.errors import CompanionError, InputError
from companion.ground.command_buttons import offered
from companion.ground.downloads import file_name, map_file, whole_file_of
from companion.ground.page import GroundPage, serve
from companion.ground.whole_map import NoWholeMapError
from companion.link.words import Answer, Command
from companion.mapping import VoxelMap
from companion.mapping.files import FORMATS, open_map
from companion.mapping.voxels.chunks import EDGE, OFFSETS
from companion.mapping.voxels.piece import MapSource
from tests.ground.fakes import FakeStation, FakeVehicle, telling
from tests.ground.guests import guest
from tests.shared.beside import wait_until


@contextmanager
def turned(*vehicles: FakeVehicle, most_points: int = 1_000_000) -> Iterator[GroundPage]:
    """The page of some vehicles after a look at them."""
    with serve(FakeStation(*vehicles), "Ground", "127.0.0.1", free_tcp_port(), most_points) as page:
        page.turn()
        while page.waiting:
            page.turn()
        yield page


@pytest.fixture
def vehicle() -> FakeVehicle:
    made = FakeVehicle()
    made.dig(3)
    return made


def sent(page: GroundPage) -> int:
    """Point clouds that a browser which opens the page now would get."""
    buffer = page.server._websock_server._broadcast_buffer
    return sum(type(message).__name__ == "PointCloudMessage" for message in buffer.message_from_id.values())


def test_the_map_is_shown_without_its_roof(vehicle: FakeVehicle) -> None:
    """Protects the first sight: ground and walls of the tunnel, and no lid."""
    with turned(vehicle) as page:
        ground, walls = 3 * 16 * 14, 3 * 16 * 2 * 26
        assert page.points == ground + walls


def test_each_vehicle_lies_where_it_is_in_the_shared_frame(vehicle: FakeVehicle) -> None:
    """Protects from maps of vehicles that started elsewhere, and point elsewhere, drawn on top of each other."""
    other = FakeVehicle("Nix", telling("Nix", frame=(10.0, 5.0, 0.0, math.pi / 2.0)))
    other.dig(3)
    with turned(vehicle, other) as page:
        low_m, high_m = page._whole()
        # The tunnel of 4.8 m along x and 1.6 m across, turned to the left about (10, 5).
        assert (low_m[0], low_m[1], high_m[0], high_m[1]) == pytest.approx((0.0, 0.0, 10.0, 9.8), abs=0.2)
        shown = page._shown["Nix"]
        assert shown._frame.position == pytest.approx([10.0, 5.0, 0.0])
        assert shown._frame.wxyz == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
        hit = shown.seen_from(np.array([9.2, 7.0, 1.2]), np.array([0.0, 0.0, -1.0]))
        assert hit is not None
        assert hit == pytest.approx([9.2, 7.0, 0.05], abs=0.12)
        with guest(page) as anna:
            anna.choose("Nix")
            wait_until(lambda: page.visitors[0].chosen() is other)
            around = page._around_chosen(page.visitors[0].client)
        assert around is not None
        # At (3, 1) of its own map.
        assert (around[0] + around[1]) / 2.0 == pytest.approx([9.0, 8.0, 1.5])


def test_only_what_changed_is_drawn_again(vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the network: 100 chunks away nothing is sent again when the vehicle maps on here."""
    vehicle.dig(16, first=96)
    with turned(vehicle) as page:
        drawn: list[str] = []
        real = page.server.scene.add_point_cloud

        def counted(name: str, *arguments: object, **more: object) -> object:
            drawn.append(name)
            return real(name, *arguments, **more)  # type: ignore[arg-type]

        monkeypatch.setattr(page.server.scene, "add_point_cloud", counted)
        vehicle.dig(1, first=3)
        page._next_map_s = 0.0
        page.turn()
        assert [name for name in drawn if "/map/" in name] == ["/vehicles/0/map/occupied/0_0_0"]


def test_the_page_keeps_one_state_of_each_tile(vehicle: FakeVehicle) -> None:
    """Protects memory: a browser that opens the page late gets the map once, however often it has changed."""
    with turned(vehicle) as page:
        before = sent(page)
        for length in range(3, 7):
            vehicle.dig(length)
            page._next_map_s = 0.0
            page.turn()
        assert sent(page) == before


def test_another_map_takes_the_place_of_the_one_before(vehicle: FakeVehicle) -> None:
    """Protects from two mines in one picture."""
    with turned(vehicle) as page:
        before = page.points
        vehicle.map, vehicle.map_number = FakeVehicle().map, 1
        vehicle.dig(1)
        page._next_map_s = 0.0
        page.turn()
        assert page.points == before // 3


def test_a_large_map_is_coarser_and_the_limit_is_for_all_vehicles_together(vehicle: FakeVehicle) -> None:
    """Protects the tablet: five vehicles do not bring five times as many points."""
    other = FakeVehicle("Nix")
    other.dig(3, y=4)
    with turned(vehicle, other) as page:
        everything = page.points
    with turned(vehicle, other, most_points=5000) as page:
        assert 0 < page.points < 5000 < everything


def test_a_hidden_vehicle_is_hidden_and_not_clicked(vehicle: FakeVehicle) -> None:
    """Protects measuring: nobody measures to a wall that he does not see; another one sees it, and measures to it."""
    down, over = np.array([0.0, 0.0, -1.0]), np.array([2.0, 0.8, 50.0])
    with turned(vehicle) as page, guest(page) as anna, guest(page):
        hers, his = page.visitors
        hit = page._seen(hers, over, down)
        assert hit is not None
        # The roof is off: the ground is hit.
        assert hit == pytest.approx([2.0, 0.8, 0.05], abs=0.08)
        assert page._seen(hers, np.array([2.0, 30.0, 50.0]), down) is None
        anna.set("Kobold", False)
        wait_until(lambda: hers.view.hides("Kobold"))
        assert page._seen(hers, over, down) is None
        assert page._seen(his, over, down) is not None


def test_a_distance_is_measured_between_two_clicks(vehicle: FakeVehicle) -> None:
    """Protects the measure: from ground to ground along the tunnel, and a click beside the map says so."""
    down = np.array([0.0, 0.0, -1.0])
    with turned(vehicle) as page, guest(page):
        measuring = page.visitors[0].measuring
        measuring.click(np.array([0.25, 0.75, 50.0]), down)
        measuring.click(np.array([0.25, 40.0, 50.0]), down)
        assert "No map there" in measuring._says.content
        measuring.click(np.array([4.25, 0.75, 50.0]), down)
        assert measuring._says.content.startswith("**4.00 m**, 4.00 m across and 0.00 m up or down")


def test_a_stop_goes_to_every_vehicle_at_once() -> None:
    """Protects the stop: it asks nobody and waits for nobody, not even for the thread that draws."""
    vehicles = FakeVehicle("Kobold"), FakeVehicle("Nix")
    with turned(*vehicles) as page, guest(page) as anna, page._drawing:
        anna.press("STOP ALL")
        wait_until(lambda: bool(vehicles[-1].asked))
        assert [vehicle.asked for vehicle in vehicles] == [[Command.STOP], [Command.STOP]]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (Answer(accepted=True), "Home, Kobold: done, it says after"),
        (Answer(accepted=False, reason="it is on the ground"), "Home, Kobold: refused: it is on the ground"),
        (None, "Home, Kobold: no answer. It may not have heard it"),
    ],
)
def test_each_answer_and_each_silence_reaches_the_page(vehicle: FakeVehicle, answer: Answer | None, words: str) -> None:
    """Protects from commands that vanish."""
    vehicle.answer = answer
    with turned(vehicle) as page:
        page.commanding.send(vehicle, Command.HOME)
        page.turn()
        assert words in page.commanding.answers


def test_a_command_that_cannot_be_sent_is_no_silence(vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from an exception that only a log sees."""

    def broken(*_: object) -> None:
        raise OSError("no route")

    monkeypatch.setattr(vehicle, "ask", broken)
    with turned(vehicle) as page:
        page.commanding.send(vehicle, Command.STOP)
        page.turn()
        assert "STOP, Kobold: could not be sent: no route. Use the transmitter." in page.commanding.answers


def test_what_makes_no_sense_cannot_be_pressed() -> None:
    """Protects a tired operator; and where nobody knows how the vehicle is, everything can."""
    possible = {
        phase: offered(FakeVehicle("a", telling(phase=phase)))
        for phase in ("checking", "waiting", "exploring", "homing", "ended")
    }
    assert possible["waiting"] == {Command.START, Command.STOP}
    assert possible["exploring"] == {Command.PAUSE, Command.HOME, Command.LAND, Command.STOP}
    assert possible["homing"] == {Command.PAUSE, Command.LAND, Command.STOP}
    assert possible["checking"] == possible["ended"] == {Command.STOP}
    assert Command.CONTINUE in offered(FakeVehicle("a", telling(paused=True)))
    silent = FakeVehicle("a", telling(phase="waiting"))
    silent.age_s = 60.0
    assert offered(silent) == set(Command)


@pytest.mark.parametrize("format_", FORMATS)
def test_the_map_can_be_had_in_each_format(vehicle: FakeVehicle, format_: str) -> None:
    """Protects the download."""
    assert len(map_file(vehicle, format_)) > 500


def occupied_in(path: Path) -> set[tuple[int, ...]]:
    """The voxels with a point in them."""
    return {
        tuple((np.array(chunk) * EDGE + OFFSETS[place]).tolist())
        for piece in open_map(path).pieces()
        for chunk, values in zip(piece.chunks.tolist(), piece.values, strict=True)
        for place in np.flatnonzero(values > 0)
    }


def test_one_map_of_all_has_each_where_it_lies(vehicle: FakeVehicle, tmp_path: Path) -> None:
    """Protects V: turned and moved as the page draws it; who has not said where it lies is left out, and named."""
    vehicle.telemetry = telling(frame=(0.0, 0.0, 0.0, 0.0))
    other = FakeVehicle("Nix", telling("Nix", frame=(10.0, 5.0, 0.5, math.pi / 2.0)))
    lost, new = FakeVehicle("Puck"), FakeVehicle("Ariel", telling("Ariel", frame=(1.0, 0.0, 0.0, 0.0)))
    other.dig(2)
    lost.dig(2)
    notes: list[str] = []
    files = {}
    for name, content in {
        "own": map_file(vehicle, "ot"),
        "nix": map_file(other, "ot"),
        "all": whole_file_of([vehicle, other, lost, new], "ot", notes.append),
    }.items():
        (tmp_path / f"{name}.ot").write_bytes(content)
        files[name] = occupied_in(tmp_path / f"{name}.ot")
    turned = {(100 - y - 1, 50 + x, z + 5) for x, y, z in files["nix"]}
    assert files["all"] == files["own"] | turned
    assert notes == ["Puck has not said where its map lies"]


def test_maps_that_cannot_be_one_are_refused(vehicle: FakeVehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from maps on top of each other: without places, in voxels of two sizes, or nowhere."""
    with pytest.raises(NoWholeMapError, match="no vehicle has a map and has said where it lies"):
        whole_file_of([vehicle, FakeVehicle("Nix")], "ply", lambda _: None)
    vehicle.telemetry = telling(frame=(1e9, 0.0, 0.0, 0.0))
    with pytest.raises(NoWholeMapError, match="Kobold: a map cannot be moved so far away"):
        whole_file_of([vehicle], "ply", lambda _: None)
    vehicle.telemetry = telling(frame=(0.0, 0.0, 0.0, 0.0))
    coarse = FakeVehicle("Nix", telling("Nix", frame=(0.0, 0.0, 0.0, 0.0)))
    coarse.map = VoxelMap(MapSettings(voxel_m=0.2))
    with pytest.raises(NoWholeMapError, match=r"mapping\.voxel_m"):
        whole_file_of([vehicle, coarse], "ply", lambda _: None)
    monkeypatch.setattr(coarse, "source", _nothing_yet)
    notes: list[str] = []
    assert whole_file_of([vehicle, coarse], "ply", notes.append)
    assert notes == ["Nix has no map yet"]


def _nothing_yet() -> MapSource:
    raise CompanionError("nothing has come yet")


def test_one_map_of_all_is_offered_where_there_are_several(vehicle: FakeVehicle) -> None:
    """Protects the panel of who flies one vehicle from a button that says the same twice."""
    with turned(vehicle) as page, guest(page) as anna:
        assert not anna.can_press("Download one map of all")
    with turned(vehicle, FakeVehicle("Nix")) as page, guest(page) as anna:
        assert anna.can_press("Download one map of all")


def test_a_file_is_named_after_vehicle_and_flight_and_never_elsewhere() -> None:
    """Protects the operator's folders."""
    assert file_name(FakeVehicle("Kobold 1")) == "Kobold-1-20261129-1130"
    assert file_name(FakeVehicle("../../etc", telling(flight="a/b"))) == "etc-a-b"
    assert file_name(FakeVehicle("..", telling(flight=""))) == "map"


def test_a_port_that_is_taken_is_refused(vehicle: FakeVehicle) -> None:
    """Protects from a page that opens elsewhere than was said."""
    with (
        turned(vehicle) as page,
        pytest.raises(InputError, match="give another --port"),
        serve(FakeStation(), "Ground", "127.0.0.1", page.port, 1000),
    ):
        pass
