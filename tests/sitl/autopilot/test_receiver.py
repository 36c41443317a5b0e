"""The transmitter's channels as each stub tells them, read as the application does."""

from __future__ import annotations

import pytest

from companion.autopilot.rc_switch import Position, RcSwitch
from companion.config.mission import RcSwitchSettings
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.mavlink import dialect as m
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock
from tests.sitl.autopilot.rig import Rig

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
CHANNEL = 9


class Ground:
    """A vehicle that stands, with a transmitter, and the application's end of the link."""

    def __init__(self, personality: Personality) -> None:
        self.rig = Rig(personality)
        self.clock = HandClock()
        self.link = FakeLink(self.clock)
        self.switch = RcSwitch(RcSwitchSettings(channel=CHANNEL), self.link)
        for name, hz in ((m.MAVLINK_MSG_ID_RC_CHANNELS, 10.0), (m.MAVLINK_MSG_ID_SYS_STATUS, 5.0)):
            command = m.MAV_CMD_SET_MESSAGE_INTERVAL
            self.rig.send(m.MAVLink_command_long_message(1, 1, command, 0, name, 1e6 / hz, 0, 0, 0, 0, 0))

    def position(self, after_s: float = 3.0) -> Position | None:
        for _ in range(round(after_s / 0.1)):
            self.clock.advance(0.1)
            for message in self.rig.run(0.1):
                self.link.deliver(message.get_type(), message.to_dict())
        return self.switch.position(self.clock.now_s())


@BOTH
def test_a_switch_is_read_where_it_stands(personality: Personality) -> None:
    ground = Ground(personality)
    ground.rig.vehicle.set_transmitter(True)
    for pulse_us, position in ((1000, Position.LOW), (2000, Position.HIGH), (1500, Position.MIDDLE)):
        ground.rig.vehicle.set_channel(CHANNEL, pulse_us)
        assert ground.position() is position


@BOTH
def test_a_transmitter_that_is_off_is_not_heard(personality: Personality) -> None:
    """PX4 tells no channels then, ArduPilot goes on with the last ones and says that its receiver is not well."""
    ground = Ground(personality)
    ground.rig.vehicle.set_transmitter(True)
    assert ground.position() is Position.MIDDLE
    ground.rig.vehicle.set_transmitter(False)
    ground.rig.vehicle.set_channel(CHANNEL, 2000)
    assert ground.position() is None
    healthy = ground.rig.newest("SYS_STATUS").onboard_control_sensors_health
    assert not healthy & m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    ground.rig.vehicle.set_transmitter(True)
    assert ground.position() is Position.HIGH
