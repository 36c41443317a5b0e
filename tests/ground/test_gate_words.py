"""What a vehicle warns of, in plain words."""

from __future__ import annotations

from companion.gate.faults import Fault
from companion.ground.gate_words import CAUSES, MOST, in_plain_words


def test_every_fault_has_plain_words() -> None:
    """Protects the operator from words of the configuration; a new fault needs its own."""
    assert set(CAUSES) == set(Fault)
    for fault in Fault:
        [text] = in_plain_words([f"gate: {fault} 0.41 s"])
        assert CAUSES[fault] in text
        assert "_" not in text


def test_what_the_gate_does_stands_first_and_once_with_every_cause() -> None:
    """Protects reading: a computer that stood still for a second raises eight warnings of one thing."""
    assert in_plain_words(
        [
            "stopped: no depth; it goes on by itself when that is back",
            "gate: depth_stale 0.56 s",
            "gate: setpoint_late 0.12 s",
            "gate: beat_late 0.12 s",
            "gate: brake: depth_stale",
        ]
    ) == [
        "Its gate stops it: its camera is silent and its computer is too slow. "
        "It goes on by itself when that is over; otherwise it holds, then lands.",
        "stopped: no depth; it goes on by itself when that is back",
    ]


def test_of_several_stages_the_last_counts() -> None:
    """Protects from "it goes on by itself" over a vehicle that does not."""
    [text] = in_plain_words(["gate: brake: beat_late", "gate: hold: beat_late"])
    assert text.startswith("Its gate holds it where it is: its computer is too slow.")


def test_what_is_not_known_stays_as_it_is() -> None:
    """Protects what other programs and later versions say."""
    said = ["autopilot: PreArm: compass", "gate: something_new 3", "gate: the map was started again"]
    assert in_plain_words(said) == said


def test_there_is_no_column_of_alarms() -> None:
    """Protects the buttons below."""
    found = in_plain_words([f"warning {number}" for number in range(MOST + 3)])
    assert len(found) == MOST + 1
    assert found[-1] == "And 3 more."


def test_what_the_gate_said_before_it_let_pass_again_is_over() -> None:
    """Protects from alarms of a minute ago; what came after it counts, and what is not the gate's is left."""
    said = ["gate: depth_stale 0.6 s", "gate: pass: all is well", "gate: brake: beat_late", "autopilot: battery"]
    assert in_plain_words(said) == [
        "Noticed: its camera is silent. Wait a moment; if it stays, send it home.",
        "autopilot: battery",
    ]
    assert in_plain_words(said[1:3]) == []
