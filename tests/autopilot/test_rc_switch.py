"""Where the transmitter's switch stands, and that the loss of a transmitter is no move of it."""

from __future__ import annotations

import pytest

from companion.autopilot.rc_switch import HEARD_AFTER_S, SETTLED_S, SILENT_S, Move, Position, RcSwitch
from companion.config.mission import RcSwitchSettings
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

LOW, MIDDLE, HIGH = 1000, 1500, 2000
RECEIVER = 0x10000
PERIOD_S = 0.1


class Transmitter:
    """In a pilot's hand, as the autopilot tells of it: ten times a second, which is twice as often as needed."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock)
        self.moves: list[Move] = []
        self.switch = RcSwitch(RcSwitchSettings(channel=7), self.link)
        self.switch.follow(self.moves.append)

    def stands(
        self, pulse_us: object, for_s: float = 1.0, heard: bool = True, count: object = 16, status: bool = True
    ) -> Transmitter:
        """For so long. ``heard``: the autopilot says that it hears it; ``status``: it says anything."""
        for _ in range(round(for_s / PERIOD_S)):
            self.clock.advance(PERIOD_S)
            if status:
                flags = {"onboard_control_sensors_present": RECEIVER | 1}
                self.link.deliver("SYS_STATUS", flags | {"onboard_control_sensors_health": RECEIVER * heard})
            others = {f"chan{number}_raw": HIGH for number in range(1, 19)}
            self.link.deliver("RC_CHANNELS", {**others, "chan7_raw": pulse_us, "chancount": count})
        return self

    @property
    def position(self) -> Position | None:
        return self.switch.position(self.clock.now_s())


def test_the_first_position_is_where_it_begins() -> None:
    pilot = Transmitter().stands(HIGH)
    assert pilot.moves == [Move(None, Position.HIGH, unseen=True)]
    assert pilot.position is Position.HIGH


def test_each_move_is_told_once_with_where_it_came_from() -> None:
    pilot = Transmitter().stands(LOW).stands(HIGH, 5.0).stands(MIDDLE).stands(LOW)
    assert [(move.before, move.after) for move in pilot.moves[1:]] == [
        (Position.LOW, Position.HIGH),
        (Position.HIGH, Position.MIDDLE),
        (Position.MIDDLE, Position.LOW),
    ]
    assert not any(move.unseen for move in pilot.moves[1:])


def test_a_middle_that_is_only_passed_is_no_move() -> None:
    pilot = Transmitter().stands(LOW).stands(MIDDLE, SETTLED_S - PERIOD_S).stands(HIGH)
    assert [move.after for move in pilot.moves] == [Position.LOW, Position.HIGH]


def test_it_is_obeyed_within_a_second() -> None:
    """Protects the pilot: who pulls a switch counts on it."""
    pilot = Transmitter().stands(LOW).stands(HIGH, 0.9)
    assert pilot.moves[-1].after is Position.HIGH


@pytest.mark.parametrize("pulse_us", [0, 799, 2201, 65535, None, 2000.0, True])
def test_what_is_no_pulse_is_no_position(pulse_us: object) -> None:
    pilot = Transmitter().stands(LOW).stands(pulse_us)
    assert pilot.position is None
    assert [move.after for move in pilot.moves] == [Position.LOW]


@pytest.mark.parametrize("count", [6, 0, None])
def test_a_channel_that_the_receiver_does_not_have_is_no_position(count: object) -> None:
    pilot = Transmitter().stands(HIGH, count=count)
    assert pilot.position is None
    assert pilot.moves == []
    assert "channel 7" in pilot.switch.problem(pilot.clock.now_s())


@pytest.mark.parametrize("preset_us", [LOW, MIDDLE, HIGH])
def test_what_a_receiver_puts_out_without_its_transmitter_moves_nothing(preset_us: int) -> None:
    """Protects a flight out of reach of the transmitter: its loss starts, stops and sends home nothing."""
    for before_us in (LOW, MIDDLE, HIGH):
        pilot = Transmitter().stands(before_us)
        # The receiver is quicker than the autopilot, which notices after half a second.
        pilot.stands(preset_us, HEARD_AFTER_S, heard=True).stands(preset_us, 60.0, heard=False)
        assert len(pilot.moves) == 1
        assert pilot.position is None
        assert "hears no transmitter" in pilot.switch.problem(pilot.clock.now_s())


def test_without_a_word_on_the_receiver_nothing_counts() -> None:
    pilot = Transmitter().stands(HIGH, 5.0, status=False)
    assert pilot.moves == []
    pilot.stands(LOW).stands(HIGH, 5.0, status=False)
    assert [move.after for move in pilot.moves] == [Position.LOW], "a word that has grown old is none"


def test_channels_that_stop_are_a_loss() -> None:
    """PX4 tells no channels while it hears no transmitter."""
    pilot = Transmitter().stands(LOW)
    pilot.clock.advance(SILENT_S + PERIOD_S)
    assert pilot.position is None
    assert "no RC_CHANNELS" in pilot.switch.problem(pilot.clock.now_s())
    pilot.stands(HIGH)
    assert pilot.moves[-1] == Move(Position.LOW, Position.HIGH, unseen=True)


def test_a_transmitter_that_comes_back_as_it_was_has_not_moved() -> None:
    pilot = Transmitter().stands(HIGH).stands(LOW, 5.0, heard=False).stands(HIGH)
    assert len(pilot.moves) == 1
    assert pilot.position is Position.HIGH
    assert not pilot.stands(LOW).moves[-1].unseen, "this one was seen again"


def test_a_switch_moved_out_of_reach_is_told_as_unseen() -> None:
    pilot = Transmitter().stands(LOW).stands(LOW, 5.0, heard=False).stands(HIGH)
    assert pilot.moves[-1] == Move(Position.LOW, Position.HIGH, unseen=True)
