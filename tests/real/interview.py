"""The same questions to a stub and to the real autopilot, from its boot through a short flight with GPS to its landing.

One interview is one session: what an autopilot answers depends on how long ago it booted and on what it was asked
before. An answer that does not come is the reason why, so that the other questions are still asked.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from companion.frames import BodyVelocity
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.program import Ports
from tests.integration.rig import SILENCE
from tests.shared.beside import wait_until
from validation.fault_matrix.true_way import standing_s
from validation.real.sortie import COMPANION, MODES, Stream, streaming, take_off
from validation.real.station import Station
from validation.real.truth import TruthListener

HEIGHT_M, SETTLED_S, CRUISE_S = 1.5, 3.0, 4.0
FORWARD = BodyVelocity(0.5, 0.0, 0.0, 0.0)
READY_S = 90.0
LISTEN_S, SAID_S, HEARD_S = 4.0, 1.5, 1.5
STREAM_S = 1.0
"""PX4 takes the mode when setpoints have been coming."""
UNKNOWN_MESSAGE, UNKNOWN_COMMAND, UNKNOWN_MODE = 60_000, 31_999, 99
PARAMETERS = {
    "px4": ("COM_OF_LOSS_T", "COM_OBL_RC_ACT", "EKF2_EV_CTRL", "MPC_XY_VEL_MAX", "NAV_RCL_ACT"),
    "ardupilot": ("GUID_TIMEOUT", "GUID_OPTIONS", "AVOID_ENABLE", "FS_THR_ENABLE", "BATT_LOW_VOLT", "RTL_ALT"),
}
RATES = ("LOCAL_POSITION_NED", "ATTITUDE", "SYS_STATUS", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "GPS_RAW_INT")
KEPT = ("HEARTBEAT", "ESTIMATOR_STATUS", "EKF_STATUS_REPORT")

Answers = dict[str, Any]


class Listener(Station):
    """The companion's end: it asks for nothing by itself, and counts."""

    def __init__(self, port: int) -> None:
        self.names: Counter[str] = Counter()
        self.passed_on: Counter[str] = Counter()
        super().__init__(port, KEPT)
        self.beating = False

    def say(self, message: Any) -> None:
        """As the companion."""
        self.send(message, COMPANION)

    def newest(self, name: str) -> Any:
        """Message of that name; one of `KEPT`."""
        found = [one.message for one in tuple(self.heard) if one.message.get_type() == name]
        assert found, f"no {name} came"
        return found[-1]

    def _hear(self, message: Any, now_s: float) -> None:
        self.names[message.get_type()] += 1
        super()._hear(message, now_s)

    def _overhear(self, message: Any) -> None:
        self.passed_on[message.get_type()] += 1

    def _ask_for_positions(self) -> None:
        """Whoever asks changes the answer."""


class Interview:
    """One session with one autopilot.

    Args:
        personality: px4 or ardupilot.
        ground: the station on the ground.
        companion: the companion's end.
        truth: where the vehicle is.

    Attributes:
        answers: by question.
    """

    def __init__(self, personality: str, ground: Station, companion: Listener, truth: TruthListener) -> None:
        self.answers: Answers = {}
        self._personality = personality
        self._ground, self._companion, self._truth = ground, companion, truth
        self._modes = MODES[personality]

    def hold(self, fly: bool) -> Answers:
        """From the first heartbeat to the landing, or without the flight."""
        wait_until(lambda: self._companion.beats and self._ground.beats, "heartbeats come", 30.0)
        for step in (self._boot, self._ground_questions, *([self._fly] if fly else [])):
            with self._noted(step.__name__.strip("_")):
                step()
        return self.answers

    # --- at the boot ---------------------------------------------------------------------------------------------

    def _boot(self) -> None:
        # PX4 tells its reasons only to whom it has heard as a ground station, whose heartbeat comes once a second.
        time.sleep(HEARD_S)
        before = len(self._ground.texts)
        self._answer("arming refused: results", lambda: self._ask(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0))
        time.sleep(SAID_S)
        self.answers["arming refused: says why"] = len(self._ground.texts) > before

    # --- on the ground -------------------------------------------------------------------------------------------

    def _ground_questions(self) -> None:
        for parameter in SILENCE[self._personality]:
            name, _, value = parameter.partition("=")
            self._ground.set_parameters({name: float(value)})
        self._await_ready()
        self._answer("rates, Hz", self._rates)
        beat = self._companion.newest("HEARTBEAT")
        self.answers["heartbeat: type, base_mode, status"] = (beat.type, beat.base_mode, beat.system_status)
        self._answer(
            "parameter types",
            lambda: {
                name: (found := self._ground.parameter(name)) and found[1] for name in PARAMETERS[self._personality]
            },
        )
        self._answer("unknown parameter", lambda: self._ground.parameter("NO_SUCH_PARAM", 1.0))
        self._answer(
            "unknown interval: results", lambda: self._ask(m.MAV_CMD_SET_MESSAGE_INTERVAL, UNKNOWN_MESSAGE, 1e5)
        )
        self._answer("unknown command: results", lambda: self._ask(UNKNOWN_COMMAND))
        self._answer("unknown mode: results", lambda: self._ask(m.MAV_CMD_DO_SET_MODE, 1.0, UNKNOWN_MODE))
        self._answer("hold on the ground: results", lambda: self._ask(m.MAV_CMD_DO_SET_MODE, *self._modes["hold"]))
        self._answer("estimator flags on the ground", self._flags)
        self._answer("forwards to the companion", self._forwards)
        # Nobody on the companion's link is a ground station.
        self.answers["texts reach the companion"] = bool(self._companion.texts)

    def _await_ready(self) -> None:
        """Until the estimator is sure of itself; ArduCopter has to be asked for the message."""
        for message in (m.MAVLINK_MSG_ID_EKF_STATUS_REPORT, m.MAVLINK_MSG_ID_EXTENDED_SYS_STATE):
            self._companion.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e5, sender=COMPANION)
        needed = m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_POS_HORIZ_ABS

        def ready() -> bool:
            with contextlib.suppress(AssertionError):
                return bool(self._flags() & needed == needed)
            return False

        wait_until(ready, "the estimator is valid", READY_S, 0.1)

    def _rates(self) -> dict[str, float]:
        """Of what comes without having been asked for."""
        before = Counter(self._companion.names)
        time.sleep(LISTEN_S)
        return {name: round((self._companion.names[name] - before[name]) / LISTEN_S, 1) for name in RATES}

    def _flags(self) -> int:
        name = "ESTIMATOR_STATUS" if self._personality == "px4" else "EKF_STATUS_REPORT"
        return int(self._companion.newest(name).flags)

    def _forwards(self) -> bool:
        """A ground station's order to the companion, which has made itself known."""
        beat = m.MAVLink_heartbeat_message(m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
        for _ in range(3):
            self._companion.say(beat)
            time.sleep(0.3)
        self._ground.command(m.MAV_CMD_DO_PAUSE_CONTINUE, 0.0, component=COMPANION[1])
        time.sleep(0.5)
        return self._companion.passed_on["COMMAND_LONG"] > 0

    # --- in the air ----------------------------------------------------------------------------------------------

    def _fly(self) -> None:
        armed_s = take_off(self._personality, self._ground, self._truth.way, HEIGHT_M)
        time.sleep(SETTLED_S)
        looks = self._truth.way.looks(armed_s)
        for height_m in (0.05, 0.5, 1.2):
            reached = next((one.t_s for one in looks if one.height_m >= height_m), None)
            self.answers[f"take-off: {height_m:g} m after, s"] = None if reached is None else reached - armed_s
        self._answer("estimator flags in the air", self._flags)
        with streaming(self._companion) as stream:
            time.sleep(STREAM_S)
            self._answer("offboard: results", lambda: self._ask(m.MAV_CMD_DO_SET_MODE, *self._modes["offboard"]))
            for name, stop in (
                ("zero velocity", stream.zero),
                ("silence", stream.silent),
                ("hold", lambda: self._ground.set_mode(self._modes["hold"])),
            ):
                self._brake(name, stream, stop)
            self._answer("pause: results", lambda: self._paused(stream))
            self._brake("land", stream, lambda: self._ground.set_mode(self._modes["land"]))
        ordered_s = time.monotonic()
        wait_until(lambda: not self._ground.armed, "landed and disarmed", 40.0, 0.05)
        self.answers["landing: disarmed after, s"] = time.monotonic() - ordered_s

    def _brake(self, name: str, stream: Stream, stop: Callable[[], None]) -> None:
        """At cruise, then stopped in this way."""
        with self._noted(name):
            stream.fly(FORWARD)
            self._ask(m.MAV_CMD_DO_SET_MODE, *self._modes["offboard"])
            time.sleep(CRUISE_S)
            self.answers[f"{name}: from, m/s"] = self._truth.way.now().speed_mps
            begun_s = time.monotonic()
            stop()
            time.sleep(CRUISE_S)
            self.answers[f"{name}: stands after, s"] = standing_s(self._truth.way.looks(begun_s), begun_s)
            self.answers[f"{name}: way, m"] = self._truth.way_m(begun_s)

    def _paused(self, stream: Stream) -> list[int]:
        """A ground station's pause button, while setpoints go on."""
        stream.fly(FORWARD)
        self._ask(m.MAV_CMD_DO_SET_MODE, *self._modes["offboard"])
        time.sleep(CRUISE_S)
        results = self._ask(m.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
        time.sleep(CRUISE_S)
        self.answers["pause: stands"] = self._truth.way.now().speed_mps < 0.2
        self._ask(m.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
        return results

    # --- asking --------------------------------------------------------------------------------------------------

    def _ask(self, command: int, *parameters: float) -> list[int]:
        return self._ground.ask(command, *parameters)

    def _answer(self, question: str, ask: Callable[[], Any]) -> None:
        with self._noted(question):
            self.answers[question] = ask()

    @contextlib.contextmanager
    def _noted(self, question: str) -> Iterator[None]:
        try:
            yield
        except (AssertionError, OSError) as error:
            self.answers[question] = f"no answer: {error}"


@contextlib.contextmanager
def stations(wanted: Ports) -> Iterator[tuple[Station, Listener, TruthListener]]:
    """Ground, companion and truth at these ports; 0 for any."""
    with (
        Station(wanted.ground) as ground,
        Listener(wanted.application) as companion,
        TruthListener(wanted.world) as truth,
    ):
        yield ground, companion, truth
