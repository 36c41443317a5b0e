"""The page in a real browser: read, clicked, measured on, with a desktop's screen and with a tablet's."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from sitl.launch.processes import free_tcp_port
from tests.shared.chromium import EXECUTABLE, Browser, browser

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

from companion.ground.page import GroundPage, serve
from companion.ground.visitor import Visitor
from companion.link.words import Answer, Command
from tests.ground.fakes import FakeStation, FakeVehicle, telling

pytestmark = pytest.mark.skipif(EXECUTABLE is None, reason="no Chromium on this computer")

CODE = "246810"
DESKTOP, TABLET = (1440, 900), (1024, 768)


class Served:
    """The page of two vehicles, kept up to date by a thread as `companion ground` does it."""

    def __init__(self, page: GroundPage, station: FakeStation) -> None:
        self.page = page
        self.station = station
        self._ends = threading.Event()
        self._thread = threading.Thread(target=page.run, args=(self._ends.is_set,))
        self._thread.start()

    def end(self) -> None:
        """Nobody keeps it up to date any more."""
        self._ends.set()
        self._thread.join()


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    vehicles = FakeVehicle("Kobold"), FakeVehicle("Nix", telling("Nix", x_m=2.0, y_m=5.0, phase="waiting"))
    vehicles[0].dig(5)
    vehicles[1].dig(3, y=1)
    station = FakeStation(*vehicles)
    with serve(station, "Ground", "127.0.0.1", free_tcp_port(), 1_000_000, CODE) as page:
        running = Served(page, station)
        try:
            yield running
        finally:
            running.end()


@pytest.fixture(scope="module")
def window(served: Served, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """The page, opened."""
    folder = tmp_path_factory.mktemp("chromium")
    with browser(folder / "profile") as opened:
        opened.ask("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder / "downloads"))
        opened.size(*DESKTOP)
        opened.open(f"http://127.0.0.1:{served.page.port}")
        choose(opened, "Kobold")
        opened.wait_for_text("R2 along a tangent")
        yield opened


@pytest.fixture(scope="module")
def tablet(served: Served, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """The page, opened by somebody else."""
    with browser(tmp_path_factory.mktemp("tablet") / "profile") as opened:
        opened.size(*TABLET, touch=True)
        opened.open(f"http://127.0.0.1:{served.page.port}")
        opened.wait_for_text("Choose the vehicle")
        yield opened


def choose(window: Browser, name: str) -> None:
    """Choose a vehicle, and wait until it is."""
    window.click(name)
    window.wait_for(f"document.querySelector('.gp-chosen')?.innerText.includes('{name}')")


def is_chosen(window: Browser, name: str) -> bool:
    """Click a vehicle; whether it is chosen some pictures later."""
    window.click(name)
    window.value(
        "new Promise((done) => { let left = 5;"
        " const next = () => left-- ? requestAnimationFrame(next) : done(); next(); })"
    )
    return bool(window.value(f"document.querySelector('.gp-chosen')?.innerText.includes('{name}')"))


@pytest.fixture(autouse=True)
def anew(served: Served) -> None:
    """Nothing has been asked."""
    for vehicle in served.station.known:
        vehicle.asked.clear()
        vehicle.answer = Answer(accepted=True)


def soon(is_so: Callable[[], bool]) -> bool:
    """Whether something becomes true before a person would wonder."""
    end_s = time.monotonic() + 20.0
    while not is_so() and time.monotonic() < end_s:
        time.sleep(0.02)
    return is_so()


def test_it_says_how_the_vehicles_are_and_asks_no_other_machine(window: Browser, served: Served) -> None:
    """Protects the first sight, underground too: both vehicles, the figures, and not one request to elsewhere."""
    for text in ("Kobold", "Nix", "exploring", "waiting", "rock", "1.80 m", "keeps 1.00 m", "52 % at home", "live"):
        assert text in window.text
    here = f"127.0.0.1:{served.page.port}"
    assert [url for url in window.requested if here not in url and not url.startswith(("data:", "blob:"))] == []
    assert window.complaints == []


@pytest.mark.parametrize("size", [DESKTOP, pytest.param(TABLET, marks=pytest.mark.long)])
def test_stop_is_large_and_on_top_and_stops_every_vehicle(
    window: Browser, served: Served, size: tuple[int, int]
) -> None:
    """Protects the stop: on each screen at least 2 cm x 2 cm, one press, no code, and nothing over it, no question."""
    window.size(*size)
    find = "[...document.querySelectorAll('button')].find((one) => one.innerText.trim() === 'STOP ALL')"
    window.wait_for(f"{find} !== undefined")
    x, y, wide, high = window.value(
        f"(() => {{ const box = {find}.getBoundingClientRect(); return [box.x, box.y, box.width, box.height]; }})()"
    )
    assert min(wide, high) >= 76  # px of CSS: 96 to the inch
    assert 0 <= x <= size[0] - wide
    assert 0 <= y <= size[1] - high
    for dx in (0.1, 0.5, 0.9):
        at = f"document.elementFromPoint({x + dx * wide}, {y + 0.5 * high})"
        assert window.value(f"{find}.contains({at})")
    window.click_at(x + wide / 2, y + high / 2)
    assert soon(lambda: all(vehicle.asked == [Command.STOP] for vehicle in served.station.known))
    window.wait_for_text("STOP, Nix: done, it says after")
    window.click("Pause")
    window.wait_for_text("STOP needs none")
    assert window.value(f"{find}.contains({at})"), "a question that is open covers it"
    window.click_at(x + wide / 2, y + high / 2)
    assert soon(lambda: all(vehicle.asked == 2 * [Command.STOP] for vehicle in served.station.known))
    window.click("Only watch")
    window.wait_for("!document.body.innerText.includes('STOP needs none')")
    window.size(*DESKTOP)


def test_two_visitors_have_a_vehicle_each(window: Browser, tablet: Browser, served: Served) -> None:
    """Protects the vehicle of the one from the press of the other: on two screens, with a question open on the one."""
    kobold, nix = served.station.known
    choose(tablet, "Nix")
    tablet.click("Start")
    tablet.wait_for_text("STOP needs none")
    assert "Kobold" in window.value("document.querySelector('.gp-chosen').innerText")
    assert "STOP needs none" not in window.text
    window.click("Stop this one")
    window.wait_for_text("STOP, Kobold: done")
    assert (kobold.asked, nix.asked) == ([Command.STOP], [])
    tablet.click("Only watch")
    tablet.wait_for("!document.body.innerText.includes('STOP needs none')")
    tablet.click("Stop this one")
    window.wait_for_text("STOP, Nix: done")
    assert (kobold.asked, nix.asked) == ([Command.STOP], [Command.STOP])
    assert window.complaints + tablet.complaints == []


@pytest.mark.long
def test_what_one_hides_the_other_sees(window: Browser, tablet: Browser, served: Served) -> None:
    """Protects who looks at the other vehicle: what is hidden is so on one screen, and comes back as it was."""
    his, hers = served.page.visitors

    def drawn(visitor: Visitor) -> int:
        """Pixels with anything of the scene in them."""
        picture = visitor.client.get_render(150, 200, transport_format="png", timeout=60.0)
        return int((picture[..., 3] > 0).sum())

    assert soon(lambda: drawn(hers) > 500)
    before = drawn(his), drawn(hers)
    tablet.click("View")
    for name in ("Kobold", "Nix"):
        tablet.click(name)
    assert soon(lambda: drawn(hers) < 0.05 * before[1])
    assert drawn(his) > 0.9 * before[0]
    for name in ("Kobold", "Nix"):
        tablet.click(name)
    assert soon(lambda: drawn(hers) > 0.9 * before[1])
    tablet.click("Vehicle")
    assert window.complaints + tablet.complaints == []


@pytest.mark.long
def test_who_comes_back_has_chosen_nothing(tablet: Browser, window: Browser, served: Served) -> None:
    """Protects from a press that goes elsewhere after the network was away: and nothing stands there twice."""
    choose(tablet, "Nix")
    served.page.server._websock_server.disconnect_all_clients()
    for opened in (tablet, window):
        opened.wait_for_text("Choose the vehicle")
        assert opened.value("document.querySelectorAll('.gp-chooser').length") == 1
        assert opened.value("document.querySelectorAll('[data-tick]').length") == 1
        assert opened.value("document.querySelector('.gp-chosen')") is None
    assert soon(lambda: len(served.page.visitors) == 2)
    for opened, name in ((window, "Kobold"), (tablet, "Nix")):
        # The panel comes back elsewhere and goes to where it was: a person who has clicked beside it clicks again.
        assert soon(partial(is_chosen, opened, name))
    assert served.station.known[0].asked == served.station.known[1].asked == []


@pytest.mark.long
def test_a_command_needs_the_code_once_and_a_start_is_asked_back(window: Browser, served: Served) -> None:
    """Protects the vehicle from visitors, and people from a vehicle that takes off: code, second press, reason."""
    kobold, nix = served.station.known
    choose(window, "Nix")
    window.click("Start")
    window.wait_for_text("STOP needs none")
    assert nix.asked == []
    window.type_into("code", CODE)
    window.click("Let me command")
    window.wait_for("!document.body.innerText.includes('STOP needs none')")
    nix.answer = Answer(accepted=False, reason="the camera is silent: look at its cable")
    window.click("Start")
    window.wait_for_text("Is everybody away from it?")
    assert nix.asked == []
    window.click("Start Nix")
    window.wait_for_text("Start, Nix: refused: the camera is silent: look at its cable")
    assert (kobold.asked, nix.asked) == ([], [Command.START])
    choose(window, "Kobold")
    window.click("Home")
    window.wait_for_text("Home, Kobold: done")
    assert kobold.asked == [Command.HOME]


@pytest.mark.long
def test_roof_and_slice_change_what_is_drawn(window: Browser, served: Served) -> None:
    """Protects the view: with the roof there are more points; hidden vehicles and their maps go."""
    without = served.page.points
    window.click("View")
    window.click("roof")
    assert soon(lambda: served.page.points > without)
    window.click("roof")
    assert soon(lambda: served.page.points == without)


@pytest.mark.long
def test_a_distance_is_measured_by_clicking_the_map(window: Browser) -> None:
    """Protects the measure: the middle of the picture, seen from above, is the middle of the map."""
    window.click("View")
    window.click("From above")
    window.click("Map")
    window.click("measure")
    window.wait_for_text("Click two points of the map.")
    x, y = window.value(
        "(() => { const box = document.querySelector('canvas').getBoundingClientRect();"
        " return [box.x + box.width / 2, box.y + box.height / 2]; })()"
    )
    window.click_at(x, y + 60)
    window.wait_for_text("click the other point")
    window.click_at(x + 40, y + 60)
    window.wait_for_text("across and 0.00 m up or down")
    window.click("measure")


@pytest.mark.long
def test_the_map_is_downloaded(window: Browser, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Protects the map that somebody takes along on a tablet."""
    folder = tmp_path_factory.getbasetemp()
    window.click("Map")
    window.click("Download its map")

    def files() -> list[Path]:
        return list(folder.glob("chromium*/downloads/Kobold-20261129-1130.ply"))

    assert soon(lambda: bool(files()) and files()[0].stat().st_size > 1000)
    assert files()[0].read_bytes().startswith(b"ply\n")
    window.click("Download one map of all")
    window.wait_for_text("no vehicle has a map and has said where it lies")


@pytest.mark.long
def test_a_page_that_nobody_keeps_up_to_date_says_so(window: Browser, served: Served) -> None:
    """Protects from a picture that stands still and looks live: it needs no word from the program to know."""
    words = "hears nothing from the ground program any more"
    assert words not in window.text
    served.end()
    window.wait_for_text(words, 30.0)
