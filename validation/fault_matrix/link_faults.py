"""Faults of the link to the autopilot, and all others that come by way of it."""

from __future__ import annotations

import random
import time
from collections.abc import Callable

from companion.config.settings import Settings
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.px4 import PX4
from tests.integration.relay import pack
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.pose_faults import POSE_FAULTS, STOPPED, altered, changes_worked, without
from validation.fault_matrix.scene import Flight
from validation.fault_matrix.vehicle_faults import PEOPLES_ORDERS, VEHICLE_FAULTS

CUT_S = 3.0
LOSS = 0.2
STALE = Settings().safety.stale
"""As the flights have it: they do not set it."""
NOISE_HZ, SPEECH_HZ = 200.0, 10.0


def _cut(flight: Flight) -> None:
    flight.relay.dead = True


def _lose(flight: Flight) -> None:
    flight.relay.lost_share = LOSS


def _nothing_comes_up(flight: Flight) -> None:
    flight.relay.dead_up = True


def _garble(flight: Flight) -> None:
    """Noise in front of and behind every message, and datagrams of noise in between."""
    drawn = random.Random(1)  # noqa: S311 - noise, no secret

    def noise() -> bytes:
        return drawn.choice((b"", b"\xfd", b"\xfe", b"\xfd\x1c\0\0")) + drawn.randbytes(drawn.randrange(60))

    flight.relay.alter_down = lambda message: [noise(), bytes(message.get_msgbuf()), noise()]
    flight.relay.speak_down(noise, 1.0 / NOISE_HZ)


def _second_autopilot(as_stranger: bool) -> Callable[[Flight], None]:
    """One that stands disarmed elsewhere and has the same number."""
    base, mode = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, PX4.modes[PX4.hold_mode].custom_mode

    def inject(flight: Flight) -> None:
        kind = m.MAV_AUTOPILOT_PX4 if flight.personality == "px4" else m.MAV_AUTOPILOT_ARDUPILOTMEGA
        custom_mode = mode if flight.personality == "px4" else 0

        def speech() -> bytes:
            now_ms = int(time.monotonic() * 1e3) & 0xFFFFFFFF
            said = (
                m.MAVLink_heartbeat_message(m.MAV_TYPE_QUADROTOR, kind, base, custom_mode, m.MAV_STATE_STANDBY, 3),
                m.MAVLink_local_position_ned_message(now_ms, 40.0, -30.0, 0.0, 0.0, 0.0, 0.0),
            )
            return b"".join(pack(message, (1, 1)) for message in said)

        flight.relay.speak_down(speech, 1.0 / SPEECH_HZ, as_stranger=as_stranger)

    return inject


def _stranger_received_nothing(flight: Flight) -> str | None:
    received = flight.relay.stranger_received
    return f"the stranger was sent {received} datagrams" if received else None


LINK_FAULTS_ALONE = (
    Injection(
        "heartbeat lost",
        "link",
        "the autopilot's heartbeats do not arrive; everything else does",
        altered(lambda: without("HEARTBEAT")),
        STOPPED,
        limit_s=STALE.heartbeat_s,
        watch_s=9.0,
    ),
    Injection(
        "link cut for 3 s",
        "link",
        f"nothing passes for {CUT_S:g} s, either way: the autopilot's failsafe, and nobody flies it on unasked",
        lambda flight: flight.relay.cut_for(CUT_S),
        frozenset({Final.FAILSAFE, Final.HELD, Final.BRAKED, Final.LANDED}),
        needs_stop=False,
        watch_s=9.0,
    ),
    Injection(
        "link cut",
        "link",
        "nothing passes any more, either way: the autopilot's failsafe",
        _cut,
        frozenset({Final.FAILSAFE}),
        needs_stop=False,
    ),
    Injection(
        "autopilot not heard",
        "link",
        "nothing of the autopilot arrives any more, while it would hear everything",
        altered(lambda: lambda _message: []),
        STOPPED | {Final.FAILSAFE},
        limit_s=STALE.link_s,
        careless=True,
    ),
    Injection(
        "autopilot hears nothing",
        "link",
        "nothing arrives at the autopilot any more, which is heard as before: its failsafe",
        _nothing_comes_up,
        frozenset({Final.FAILSAFE}),
        needs_stop=False,
    ),
    Injection(
        "link loses 20 %",
        "link",
        f"{LOSS:.0%} of the packets are lost, each way",
        _lose,
        STOPPED | {Final.FLEW_ON},
        needs_stop=False,
    ),
    Injection(
        "garbage on the autopilot's link",
        "link",
        "noise around every message, and 200 datagrams of noise a second",
        _garble,
        frozenset({Final.FLEW_ON}),
        needs_stop=False,
        verify=changes_worked,
    ),
    Injection(
        "second autopilot from elsewhere",
        "link",
        "another program says from its own address to be the same autopilot, disarmed and elsewhere",
        _second_autopilot(as_stranger=True),
        frozenset({Final.FLEW_ON}),
        needs_stop=False,
        verify=_stranger_received_nothing,
    ),
    Injection(
        "second autopilot on the link",
        "link",
        "a second autopilot with the same number speaks on the same link, disarmed and elsewhere",
        _second_autopilot(as_stranger=False),
        STOPPED | {Final.FAILSAFE},
        needs_stop=False,
    ),
)

LINK_FAULTS = (*POSE_FAULTS, *LINK_FAULTS_ALONE, *VEHICLE_FAULTS, *PEOPLES_ORDERS)
