"""Another program on this computer that sends to the sockets of a flight: a process of its own.

python -m validation.fault_matrix.stranger garbage|setpoints|telemetry PORT ...
"""

from __future__ import annotations

import contextlib
import itertools
import random
import socket
import sys
import time
from collections.abc import Callable, Sequence

from companion.mavlink.codec import Encoder
from companion.mavlink.ids import VELOCITY_AND_YAW_RATE, MavAutopilot, MavCmd, MavComponent, MavFrame
from tests.integration.relay import LOOPBACK

SENT_S = 3.0
RATE_HZ = 1000.0
VX_MPS, YAW_RATE_RADPS = 0.49, 0.123
"""Within every limit, and nobody else's."""
LONGEST = 400
_BEGINNINGS = (b"", b"\xfd", b"\xfe", b"\xfd\x33\0\0\1\1\xbf\x54\0\0")


def garbage() -> Callable[[], bytes]:
    """Noise, some of which begins like a message."""
    drawn = random.Random(1)  # noqa: S311 - noise, no secret
    return lambda: drawn.choice(_BEGINNINGS) + drawn.randbytes(drawn.randrange(LONGEST))


def setpoints() -> Callable[[], bytes]:
    """As the application sends them, at full speed."""
    encoder = Encoder(1, 191)
    return lambda: encoder.pack(
        "SET_POSITION_TARGET_LOCAL_NED",
        target_system=1,
        target_component=1,
        coordinate_frame=MavFrame.BODY_NED,
        type_mask=VELOCITY_AND_YAW_RATE,
        vx=VX_MPS,
        yaw_rate=YAW_RATE_RADPS,
    )


def telemetry() -> Callable[[], bytes]:
    """As the autopilot would say that all is lost, and a ground station that it is enough."""
    autopilot, ground = Encoder(1, MavComponent.AUTOPILOT1), Encoder(255, 190)
    stop = {"target_system": 1, "target_component": MavComponent.ONBOARD_COMPUTER}
    land = {"target_system": 1, "target_component": MavComponent.AUTOPILOT1}
    said = itertools.cycle(
        (
            autopilot.pack("LOCAL_POSITION_NED", time_boot_ms=1 << 30, x=500.0, y=500.0, z=-500.0, vx=20.0),
            autopilot.pack("ATTITUDE", time_boot_ms=1 << 30, roll=1.0, yaw=3.0),
            autopilot.pack("HEARTBEAT", autopilot=MavAutopilot.PX4, base_mode=0, custom_mode=0, system_status=5),
            autopilot.pack("HEARTBEAT", autopilot=MavAutopilot.ARDUPILOTMEGA, base_mode=0, custom_mode=9),
            autopilot.pack("SYS_STATUS", battery_remaining=1),
            autopilot.pack("ESTIMATOR_STATUS", flags=0),
            ground.pack("COMMAND_LONG", command=MavCmd.DO_PAUSE_CONTINUE, param1=0.0, **stop),
            ground.pack("COMMAND_LONG", command=MavCmd.NAV_LAND, **land),
            autopilot.pack("COMMAND_LONG", command=MavCmd.DO_PAUSE_CONTINUE, param1=0.0, **stop),
        )
    )
    return lambda: next(said)


def main(arguments: Sequence[str]) -> None:
    """Send for `SENT_S`."""
    what, *ports = arguments
    datagram = {"garbage": garbage, "setpoints": setpoints, "telemetry": telemetry}[what]()
    began_s = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        for number in itertools.count():
            due_s = number / RATE_HZ
            if due_s > SENT_S:
                return
            time.sleep(max(0.0, began_s + due_s - time.monotonic()))
            for port in ports:
                # A port that is not for strangers answers that nobody is there.
                with contextlib.suppress(OSError):
                    wire.sendto(datagram(), (LOOPBACK, int(port)))


if __name__ == "__main__":
    main(sys.argv[1:])
