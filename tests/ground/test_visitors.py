"""Several people who have the page open: what each of them has chosen is his alone, and who leaves is gone."""

from __future__ import annotations

import gc
import logging
import math
import weakref
from collections.abc import Callable, Iterator

import pytest

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

from companion.ground.page import PERIOD_S, GroundPage, serve
from companion.link.words import Command
from sitl.launch.processes import free_tcp_port
from tests.ground.fakes import FakeStation, FakeVehicle, telling
from tests.ground.guests import Guest, guest
from tests.shared.beside import wait_until

CODE = "246810"


class Fleet:
    """The page of two vehicles that know different things."""

    def __init__(self, page: GroundPage, station: FakeStation) -> None:
        self.page = page
        self.station = station
        self.kobold, self.nix = station.known

    def until(self, visitor: Guest, text: str) -> None:
        """Keep the page up to date until somebody reads something."""
        self.until_so(lambda: text in visitor.text)

    def until_so(self, is_so: Callable[[], bool]) -> None:
        """Keep the page up to date until something is so."""

        def turned() -> bool:
            self.page.turn()
            return is_so()

        wait_until(turned)

    def choose(self, visitor: Guest, name: str, text: str) -> None:
        """Let somebody choose a vehicle and see a figure of it."""
        visitor.choose(name)
        self.until(visitor, text)


@pytest.fixture
def fleet() -> Iterator[Fleet]:
    kobold = FakeVehicle("Kobold", telling(d_m=1.81, warnings=("Camera silent: it stands. Land it.",)))
    nix = FakeVehicle("Nix", telling("Nix", d_m=3.33))
    kobold.dig(3)
    station = FakeStation(kobold, nix)
    with serve(station, "Ground", "127.0.0.1", free_tcp_port(), 1_000_000) as page:
        page.turn()
        while page.waiting:
            page.turn()
        yield Fleet(page, station)


def until_asked(visitor: Guest, title: str) -> None:
    """Wait until somebody is asked back."""
    wait_until(lambda: visitor.has(title), title)


KOBOLD, NIX = "1.81 m", "3.33 m"
"""Figures that only the one and only the other has."""


def test_each_sees_and_commands_the_vehicle_that_he_has_chosen(fleet: Fleet) -> None:
    """Protects the vehicle of the one from the press of the other: figures, warnings and commands are the presser's."""
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        fleet.choose(anna, "Kobold", KOBOLD)
        fleet.choose(ben, "Nix", NIX)
        fleet.until(anna, KOBOLD)
        assert NIX not in anna.text
        assert KOBOLD not in ben.text
        assert "Camera silent" in anna.text
        assert "Camera silent" not in ben.text
        anna.press("Pause")
        ben.press("Home")
        wait_until(lambda: bool(fleet.kobold.asked and fleet.nix.asked))
        assert (fleet.kobold.asked, fleet.nix.asked) == ([Command.PAUSE], [Command.HOME])
        anna.press("Stop this one")
        wait_until(lambda: len(fleet.kobold.asked) == 2)
        assert (fleet.kobold.asked[-1], fleet.nix.asked) == (Command.STOP, [Command.HOME])
        for visitor in (anna, ben):
            fleet.until(visitor, "Home, Nix: done")
            assert "Stop this one" not in visitor.text, "a button, no question"


def test_each_ones_buttons_are_for_his_vehicle(fleet: Fleet) -> None:
    """Protects a tired operator: what makes no sense for his vehicle is grey, whatever others have chosen."""
    fleet.nix.telemetry = telling("Nix", d_m=3.33, phase="waiting")
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        fleet.choose(anna, "Kobold", KOBOLD)
        fleet.choose(ben, "Nix", NIX)
        wait_until(lambda: ben.can_press("Start") and anna.can_press("Home"))
        assert not anna.can_press("Start")
        assert not ben.can_press("Home")


def test_a_choice_and_the_press_after_it_come_in_their_order(fleet: Fleet) -> None:
    """Protects from a command that overtakes the choice before it: both come at once when a network is back."""
    together: list[str] = []
    for vehicle in (fleet.kobold, fleet.nix):
        vehicle.ask = lambda *_, name=vehicle.name: together.append(name)  # type: ignore[method-assign]
    with guest(fleet.page) as anna:
        for _ in range(100):
            for name in ("Kobold", "Nix"):
                anna.choose(name)
                anna.press("Pause")
        wait_until(lambda: len(together) == 200)
    assert together == 100 * ["Kobold", "Nix"]


def test_who_comes_anew_commands_none_of_several_until_he_has_chosen(fleet: Fleet) -> None:
    """Protects from the first vehicle in place of the chosen one: who was away for a moment is new here. STOP works."""
    with guest(fleet.page) as anna:
        fleet.choose(anna, "Nix", NIX)
    with guest(fleet.page) as anna:
        fleet.until(anna, "Choose the vehicle")
        assert NIX not in anna.text
        assert KOBOLD not in anna.text
        for label in ("Pause", "Home", "Land here", "Stop this one"):
            assert not anna.can_press(label)
            anna.press(label)
        anna.press("STOP ALL")
        wait_until(lambda: bool(fleet.kobold.asked and fleet.nix.asked))
        assert (fleet.kobold.asked, fleet.nix.asked) == ([Command.STOP], [Command.STOP])


def test_a_single_vehicle_needs_no_choice_and_stays_whose_it_was(fleet: Fleet) -> None:
    """Protects the usual flight from a question that has one answer, and who flies from the second one that is heard.

    Who has only watched has chosen nothing: after a restart of the program, that it heard this one first means nothing.
    """
    fleet.station.known.remove(fleet.nix)
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        for visitor in (anna, ben):
            fleet.until(visitor, KOBOLD)
            assert not visitor.can_press("Stop this one")
        anna.press("Pause")
        wait_until(lambda: fleet.kobold.asked == [Command.PAUSE])
        fleet.station.known.append(fleet.nix)
        fleet.until(ben, "Choose the vehicle")
        assert KOBOLD in anna.text
        ben.press("Home")
        anna.press("Home")
        wait_until(lambda: len(fleet.kobold.asked) == 2)
        assert (fleet.kobold.asked, fleet.nix.asked) == ([Command.PAUSE, Command.HOME], [])


def test_a_question_is_asked_of_its_presser_and_keeps_nobody_from_a_stop(fleet: Fleet) -> None:
    """Protects the stop, and the vehicle that was meant: a question stays about it, whatever is chosen meanwhile."""
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        fleet.choose(anna, "Kobold", KOBOLD)
        anna.press("Land here")
        until_asked(anna, "Land here: Kobold?")
        assert not ben.has("Land here: Kobold?")
        anna.press("STOP ALL")
        wait_until(lambda: fleet.nix.asked == [Command.STOP])
        fleet.choose(anna, "Nix", NIX)
        anna.press("Land here Kobold")
        wait_until(lambda: fleet.kobold.asked == [Command.STOP, Command.LAND])
        assert fleet.nix.asked == [Command.STOP]
        wait_until(lambda: not anna.has("Land here: Kobold?"))


def test_a_code_is_typed_by_each(fleet: Fleet) -> None:
    """Protects the vehicle from who came later: that somebody else has typed the code says nothing of him."""
    with (
        serve(fleet.station, "Ground", "127.0.0.1", free_tcp_port(), 1000, CODE) as page,
        guest(page) as anna,
        guest(page) as ben,
    ):
        for visitor in (anna, ben):
            visitor.choose("Kobold")
            visitor.press("Pause")
            until_asked(visitor, "Code for commands")
        anna.set("code", CODE)
        anna.press("Let me command")
        wait_until(lambda: not anna.has("Code for commands"))
        for visitor in (ben, anna):
            visitor.press("Home")
        wait_until(lambda: bool(fleet.kobold.asked))
        assert fleet.kobold.asked == [Command.HOME]


def test_what_one_hides_others_see(fleet: Fleet) -> None:
    """Protects who watches the other vehicle: hiding, ways and graphs are each one's own, and nothing is sent anew."""
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        drawn = len(anna.messages)
        anna.set("Kobold", False)
        anna.set("ways flown", False)
        fleet.until_so(lambda: len(anna.hidden) == 7)
        parts = {"map", "at", "ways", "graphs", "left", "target"}
        assert anna.hidden == {f"/vehicles/0/{part}" for part in parts} | {"/vehicles/1/ways"}
        assert ben.hidden == set()
        anna.set("Kobold", True)
        fleet.until_so(lambda: len(anna.hidden) == 2)
        assert anna.hidden == {"/vehicles/0/ways", "/vehicles/1/ways"}
        assert "PointCloudMessage" not in {message["type"] for message in anna.messages[drawn:]}


def test_who_leaves_takes_his_things_away(fleet: Fleet) -> None:
    """Protects a page that is open for days: of who has gone nothing is kept, and nothing calls him any more."""
    with guest(fleet.page) as ben:
        containers = fleet.page.server.gui._container_handle_from_uuid
        held = {uuid: len(container._children) for uuid, container in containers.items()}
        gone: list[weakref.ref[object]] = []
        for _ in range(3):
            with guest(fleet.page) as anna:
                fleet.choose(anna, "Kobold", KOBOLD)
                anna.press("Land here")
                anna.set("measure", True)
                until_asked(anna, "Land here: Kobold?")
                gone += [weakref.ref(fleet.page.visitors[-1]), weakref.ref(fleet.page.visitors[-1].client)]
        fleet.page.turn()
        assert {uuid: len(container._children) for uuid, container in containers.items()} == held
        assert len(fleet.page._visitors) == 1
        wait_until(lambda: gc.collect() >= 0 and not any(one() for one in gone))
        fleet.choose(ben, "Nix", NIX)


def test_what_fails_for_one_fails_for_nobody_else(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Protects the others, the maps and STOP from one visitor's trouble; of who has just gone nobody is told."""

    def fails(*_: object) -> None:
        raise RuntimeError("Cannot assign to 'content' on a removed GuiHtmlHandle.")

    with guest(fleet.page) as ben:
        with guest(fleet.page), caplog.at_level(logging.ERROR):
            hers = fleet.page.visitors[-1]
            monkeypatch.setattr(hers, "refresh", fails)
            fleet.choose(ben, "Nix", NIX)
            assert "was not brought up to date" in caplog.text
        caplog.clear()
        # As if the thread that draws had begun just before she left.
        fleet.page._visitors[hers.client.client_id] = hers
        fleet.choose(ben, "Kobold", KOBOLD)
        assert caplog.text == ""


def test_who_leaves_while_he_is_told_something_is_no_trouble(fleet: Fleet) -> None:
    """Protects the thread that draws: viser refuses what is for one who has gone, and it goes on."""
    with guest(fleet.page):
        gone = fleet.page.visitors[0]
    fleet.page._visitors[gone.client.client_id] = gone
    gone.choose("Kobold")
    turns = fleet.page._turns
    fleet.page.turn()
    assert fleet.page._turns == turns + 1


def test_nothing_is_sent_that_is_as_it_was(fleet: Fleet) -> None:
    """Protects thin networks: to each visitor, while nothing changes, the list once a second and no more."""
    turns = round(1.0 / PERIOD_S)
    with guest(fleet.page) as anna, guest(fleet.page) as ben:
        fleet.choose(anna, "Kobold", KOBOLD)
        for one in fleet.page.visitors:
            one.settled_s = math.inf
        while fleet.page._turns % turns != 1:
            fleet.page.turn()
        tick = f'data-tick="{fleet.page._turns // turns}"'
        wait_until(lambda: tick in str(anna.elements) and tick in str(ben.elements))
        before = [len(visitor.messages) for visitor in (anna, ben)]
        for _ in range(turns):
            fleet.page._next_map_s = 0.0
            fleet.page.turn()
        wait_until(lambda: len(anna.messages) > before[0] and len(ben.messages) > before[1])
        for visitor, known in zip((anna, ben), before, strict=True):
            assert [message["type"] for message in visitor.messages[known:]] == ["GuiUpdateMessage"]
