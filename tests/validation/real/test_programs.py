"""The programs that fly the real autopilots, without them: what they would fly, and how they judge."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import pytest

from validation.fault_matrix import results
from validation.fault_matrix.injection import Final
from validation.fault_matrix.outcome import Outcome
from validation.landed import landed_off_m
from validation.real import faults, flights
from validation.real.flight import Flown, Task
from validation.real.program import OWN_NETWORK
from validation.real.real_faults import BY_NAME, CELLS, FAULTS, MODES

GOOD = Flown(
    *(Task("px4", False, "room", 1, 600.0), 0, "complete", True, 0, 0.63, 21.0, 0.2, True, 0.056, 0.078, 1635, 0),
    lasted_s=270.0,
)


def test_the_campaign_is_whole() -> None:
    """Protects its extent: both autopilots, both ways to know the position, every world."""
    wanted = flights.tasks(("px4", "ardupilot"))
    assert len(set(wanted)) == len(wanted)
    for personality in ("px4", "ardupilot"):
        own = [task for task in wanted if task.personality == personality]
        assert sum(not task.gps and task.world != "complex" for task in own) == 6
        assert sum(task.gps for task in own) == 2
        assert [task.time_limit_s for task in own if task.world == "complex"] == [900.0]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"exit_code": 1, "complete": False, "ended_because": "time"}, "exit code 1: time"),
        ({"contacts": 2}, "2 contacts"),
        ({"landed_off_m": 0.31}, "landed 0.31 m off"),
        ({"landed_off_m": None}, "landed nowhere"),
        ({"off_start_m": 0.62}, "0.62 m from where it started"),
        ({"disarmed": False}, "still armed"),
        ({"replay_differing": 3}, "replay: 3 setpoints differ"),
        ({"problem": "the world ended"}, "the world ended"),
    ],
)
def test_what_is_not_as_it_must_be_is_said(change: dict[str, object], said: str) -> None:
    """Protects the verdict: a campaign is read by its last lines."""
    assert flights.problems(GOOD) == []
    bad = replace(GOOD, **change)  # type: ignore[arg-type]
    assert flights.problems(bad) == [said]
    assert said in flights.table([GOOD, bad])
    assert "every flight was as it must be" in flights.table([GOOD])


def test_a_campaign_goes_on_where_it_was_broken_off(tmp_path: Path) -> None:
    """Protects hours of flights: what has been flown is not flown again, and reads as it was written."""
    file = tmp_path / "flights.json"
    results.write_whole(file, [asdict(GOOD)])
    assert flights.read(file) == [GOOD]
    assert flights.read(tmp_path / "none.json") == []


def test_where_it_landed_is_measured_from_the_order(tmp_path: Path) -> None:
    """Protects the figure that shows a landing that flies away."""
    truth = tmp_path / "truth.csv"
    truth.write_text("t_s,x_m,y_m\n1.0,0.0,0.0\n2.0,5.0,0.0\n3.0,5.3,0.4\n", encoding="ascii")
    assert landed_off_m(truth, 1.5) == pytest.approx(0.5)
    assert landed_off_m(truth, 3.5) is None


@pytest.mark.parametrize("main", [flights.main, faults.main])
def test_a_network_that_others_share_is_refused(
    main: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Protects the user's computer: the autopilots obey whoever sends."""
    assert callable(main)
    monkeypatch.delenv(OWN_NETWORK, raising=False)
    assert main([]) == 2
    assert "scripts/own-network" in capsys.readouterr().out
    assert main(["--list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) > 10


def test_every_fault_can_be_told_from_the_others() -> None:
    """Protects the list: each name once, and a mode for each pilot who selects one."""
    assert len(BY_NAME) == len(FAULTS)
    assert all(fault.expects for fault in FAULTS)
    selected = {(name.removeprefix("pilot selects "), who) for name, who in CELLS if name.startswith("pilot selects")}
    assert selected == {(mode, who) for who, modes in MODES.items() for mode in modes}


def test_the_table_of_faults_says_what_was_said() -> None:
    """Protects the reader: who stopped it, in which mode it ended, and in whose words."""
    outcome = Outcome(
        *("SIGKILL application", "processes", "px4", 0.5, 1.5, 0.1, 0.4, 1.1, 0, Final.HELD, ("gate: brake",), None),
        standing_s=0.89,
        mode="hold",
        texts=("Failsafe activated",),
    )
    text = faults.table([outcome, replace(outcome, personality="ardupilot", problem="1 contacts", standing_s=None)])
    assert "gate: brake; autopilot: Failsafe activated" in text
    assert "0.89" in text
    assert "FAILED: SIGKILL application (ardupilot): 1 contacts" in text
