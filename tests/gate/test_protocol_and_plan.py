"""What goes over the application's socket, and what the gate is told at its start."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.gate.faults import Fault, Stage
from companion.gate.plan import Attached, Geofence, Plan, Signing
from companion.gate.protocol import PACKET_BYTES, Beat, Goodbye, Notice, Phase, is_mavlink, unpacked
from companion.sides import Side, Sides
from tests.gate.built import BEAT, PLAN

ages = st.floats(0.0, math.inf)


@given(st.builds(Beat, st.floats(-1e9, 1e9), ages, ages, ages, ages, ages, st.sampled_from(Phase)))
def test_a_beat_comes_over_as_it_was(beat: Beat) -> None:
    """Protects every number of a beat, the infinite ones too."""
    assert unpacked(beat.packed()) == beat


@given(st.binary(max_size=80))
def test_no_bytes_raise(data: bytes) -> None:
    """Protects the gate from its own child."""
    assert unpacked(data) is None or data[:4] in (b"beat", b"bye!")


@pytest.mark.parametrize("name", ["depth_age_s", "ranges_age_s", "pose_age_s", "map_age_s"])
@pytest.mark.parametrize("value", [-0.001, math.nan])
def test_an_age_below_zero_or_none_at_all_is_no_age(name: str, value: float) -> None:
    """Protects against stamps from the future, which would look fresh, and against NaN, which never looks late."""
    changed: dict[str, Any] = {name: value}
    assert unpacked(replace(BEAT, **changed).packed()) is None


def test_what_else_cannot_be_a_beat() -> None:
    """Protects the rest of a beat's numbers; an unknown distance is one that may be told."""
    assert unpacked(replace(BEAT, t_s=math.inf).packed()) is None
    assert unpacked(replace(BEAT, ahead_m=-1.0).packed()) is None
    assert unpacked(replace(BEAT, ahead_m=math.nan).packed()) is not None
    for side in (Side(-1.0, 0.0), Side(math.nan, 0.0), Side(1.0, math.nan), Side(1.0, math.inf)):
        assert unpacked(replace(BEAT, sides=Sides(right=side)).packed()) is None
    around = Sides(Side(1.0, 0.5), Side(2.0, -0.5), Side(math.inf, 0.0), Side(0.25, 0.125))
    assert unpacked(replace(BEAT, sides=around).packed()) == replace(BEAT, sides=around)
    raw = bytearray(BEAT.packed())
    raw[4] = 9
    assert unpacked(bytes(raw)) is None, "no such phase"
    assert unpacked(b"bird" + BEAT.packed()[4:]) is None
    here_and_now = Beat(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, Phase.GROUND)
    assert unpacked(here_and_now.packed()) == here_and_now
    assert unpacked(replace(BEAT, ahead_m=0.25).packed()) is not None


@given(st.builds(Notice, st.sampled_from(Stage), st.none() | st.sampled_from(Fault), st.text(max_size=60)))
def test_a_notice_comes_over_as_it_was(notice: Notice) -> None:
    """Protects the application's knowledge of what the gate does, and why."""
    assert Notice.unpacked(notice.packed()) == notice


@given(st.binary(max_size=80) | st.binary(max_size=80).map(lambda rest: b"note" + rest))
def test_no_bytes_make_the_application_raise(data: bytes) -> None:
    """Protects the thread that reads: it must not end before the gate does."""
    notice = Notice.unpacked(data)
    assert notice is None or data.startswith(b"note")


def test_what_cannot_be_a_notice() -> None:
    """Protects against stages and faults that there are not, and the longest text from making a packet too large."""
    assert Notice.unpacked(b"note") is None
    assert Notice.unpacked(b"note\x09\xff") is None, "no such stage"
    assert Notice.unpacked(b"note\x01" + bytes((len(Fault),))) is None, "no such fault"
    assert Notice.unpacked(b"nota\x01\xff") is None
    assert Notice.unpacked(b"note\x03\xff") == Notice(Stage.LAND)
    for notice in (Notice(Stage.BRAKE, Fault.FLOOD, "flood"), Notice(Stage.PASS, None, "all is well")):
        assert Notice.unpacked(notice.packed()) == notice
    long = Notice(Stage.HOLD, Fault.MAP, "ü" * 2000).packed()
    assert len(long) < PACKET_BYTES
    cut = Notice.unpacked(long)
    assert cut is not None
    assert cut.text.rstrip("\N{REPLACEMENT CHARACTER}") == "ü" * 120


@pytest.mark.parametrize("word", [BEAT.packed(), Goodbye(0).packed(), Notice(Stage.PASS).packed(), b""])
def test_no_word_is_taken_for_mavlink(word: bytes) -> None:
    """Protects both ends: words and frames share one socket."""
    assert not is_mavlink(word)
    assert is_mavlink(b"\xfd" + word)
    assert is_mavlink(b"\xfe" + word)


def test_the_last_word_carries_the_exit_code() -> None:
    """Protects what the shell gets."""
    assert unpacked(Goodbye(130).packed()) == Goodbye(130)
    assert unpacked(b"bye!") is None


FULL = replace(
    PLAN,
    fence=Geofence((-1.0, 2.0), None, (-3.0, 0.5), 7.5),
    attached=(Attached("udpout://192.168.1.2:14550", "read"),),
    signing=Signing("/etc/companion/key", 3),
    inherit=(5, 6),
)


@pytest.mark.parametrize("plan", [PLAN, FULL])
def test_a_plan_comes_over_as_it_was(plan: Plan) -> None:
    """Protects every number that the gate goes by."""
    assert Plan.loads(plan.dumps()) == plan


@pytest.mark.parametrize(
    "spoil",
    [
        lambda found: found.pop("limits"),
        lambda found: found["limits"].pop("speed_mps"),
        lambda found: found["limits"].update(extra=1.0),
        lambda found: found["reactions"].pop("fence"),
        lambda found: found["reactions"].update(nonsense={}),
        lambda found: found["reactions"]["fence"].update(first=9),
        lambda found: found.update(limits=3),
        lambda found: found.update(fence=None),
    ],
)
def test_what_is_no_plan_is_refused(spoil: object) -> None:
    """Protects the gate from starting with half of its numbers."""
    found = json.loads(PLAN.dumps())
    assert callable(spoil)
    spoil(found)
    # Which of the numbers is wrong is for developers: the configuration has checked what people write.
    with pytest.raises(ValueError, match=r"^(no plan of a gate: |.* is not a valid )"):
        Plan.loads(json.dumps(found))


def test_a_text_that_is_no_json_is_refused() -> None:
    """Protects the same."""
    with pytest.raises(ValueError):  # noqa: PT011
        Plan.loads("{")
    with pytest.raises(ValueError):  # noqa: PT011
        Plan.loads("[]")
    with pytest.raises(ValueError):  # noqa: PT011 - no number of a plan is infinite
        replace(PLAN, recover_s=math.inf).dumps()
