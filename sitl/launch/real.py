"""The real PX4 and the real ArduCopter, each with its own simulator, as a process of a flight.

Both listen on every interface of the computer: start them in a network of their own only (`scripts/own-network`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.config.settings import Settings
from companion.errors import InputError
from companion.flight.preflight.parameter_rules import rules
from companion.mavlink.firmware import AutopilotKind
from sitl.launch.program import Ports, Program

BINARY_VARIABLES = {"px4": "PX4_BINARY", "ardupilot": "ARDUCOPTER_BINARY"}
"""Where a user names the programs, by personality."""
PX4_ETC = "PX4_ETC"
"""The folder of PX4's start scripts, where it is not found beside the program."""

PX4_PORTS = Ports(application=14540, ground=14550, world=19410)
"""Where PX4 sends to, by its own start scripts."""
ARDUPILOT_PORTS = Ports(application=14540, ground=14550, world=14560)

ARDUPILOT_DEFAULTS = Path(__file__).parents[2] / "docker" / "ardupilot.parm"
ARDUPILOT_PARAMETERS = "flight.parm"
HOME = "47.397742,8.545594,488.0,0.0"
"""Where ArduCopter's simulator boots, looking north, as PX4's does."""

SIH_NOISE: Mapping[str, float] = {"EKF2_ACC_NOISE": 1.0, "EKF2_GYR_NOISE": 0.1}
"""The inertial sensors of PX4's own simulator shake more than its estimator expects: with the defaults its velocity is
wrong by up to 0.7 m/s, and zero velocity drifts into walls."""
PX4_LOGS: Mapping[str, float] = {"SDLOG_MODE": -1}
"""PX4's own log of a flight is hundreds of megabytes, which nobody reads here."""


@dataclass(frozen=True, slots=True)
class RealAutopilot:
    """One of the real ones.

    Attributes:
        personality: px4 or ardupilot.
        binary: its program: `px4` of `make px4_sitl`, or `arducopter` of `./waf copter` for the board `sitl`.
        etc: the folder of PX4's start scripts; ArduCopter has none.
    """

    personality: str
    binary: Path
    etc: Path = Path()

    @property
    def ports(self) -> Ports:
        """Where it sends to."""
        return PX4_PORTS if self.personality == "px4" else ARDUPILOT_PORTS

    def program(
        self, folder: Path, settings: Settings, parameters: Mapping[str, float], ports: Ports | None = None
    ) -> Program:
        """Its process.

        Args:
            folder: for its log and everything that it writes; exists.
            settings: of the application. What pre-flight demands and has to be there at the boot is set before it; the
                rest is for pre-flight.
            parameters: what is set besides.
            ports: where it sends to instead; PX4 has to be left its own.
        """
        own = folder / "autopilot"
        own.mkdir(exist_ok=True)
        demanded = of_boot(AutopilotKind(self.personality), settings)
        if self.personality == "px4":
            return self._px4(own, {**SIH_NOISE, **PX4_LOGS, **demanded, **parameters})
        return self._arducopter(own, {**demanded, **parameters}, ports or ARDUPILOT_PORTS)

    def _px4(self, own: Path, parameters: Mapping[str, float]) -> Program:
        return Program(
            "autopilot",
            (str(self.binary), "-d", "-w", str(own), str(self.etc)),
            serves="Startup script returned successfully",
            environment={
                "PX4_SIM_MODEL": "sihsim_quadx",
                **{f"PX4_PARAM_{name}": f"{value:.9g}" for name, value in parameters.items()},
            },
            folder=own,
        )

    def _arducopter(self, own: Path, parameters: Mapping[str, float], ports: Ports) -> Program:
        chosen = "".join(f"{name} {value:.9g}\n" for name, value in parameters.items())
        # One file, named from where it runs: ArduCopter cuts a list at every comma, also at those of a path.
        text = ARDUPILOT_DEFAULTS.read_text(encoding="ascii") + chosen
        (own / ARDUPILOT_PARAMETERS).write_text(text, encoding="ascii")
        to = (ports.ground, ports.application, ports.world)
        return Program(
            "autopilot",
            (
                *(str(self.binary), "--model", "quad", "--speedup", "1", "--wipe", "--home", HOME),
                *("--defaults", ARDUPILOT_PARAMETERS),
                *(part for i, port in enumerate(to) for part in (f"--serial{i}", f"udpclient:127.0.0.1:{port}")),
            ),
            # The last that it opens, after its parameters.
            serves=f"UDP connection 127.0.0.1:{ports.world}",
            folder=own,
        )


def of_boot(kind: AutopilotKind, settings: Settings) -> dict[str, float]:
    """The parameters that have to be there at the boot: those that need one, and those of an estimator without GPS."""
    with_gps = settings.model_copy(update={"autopilot": settings.autopilot.model_copy(update={"gps": True})})
    always = rules(kind, with_gps)
    early = [rule for rule in rules(kind, settings) if rule.reboot or rule not in always]
    return {one.name: one.set_to for rule in early for one in rule.either[0] if one.set_to is not None}


def find(personality: str, environment: Mapping[str, str] = os.environ) -> RealAutopilot:
    """The real one that the environment names.

    Raises:
        InputError: it names none, or what it names cannot be run.
    """
    variable = BINARY_VARIABLES[personality]
    named = environment.get(variable, "")
    if not named:
        raise InputError(f"{variable} is not set: name the program of the real autopilot with it (docs/sitl.md)")
    binary = Path(named).resolve()
    if not os.access(binary, os.X_OK) or binary.is_dir():
        raise InputError(f"{variable}={named}: there is no such program")
    if personality != "px4":
        return RealAutopilot(personality, binary)
    # make px4_sitl leaves bin/px4 and etc side by side.
    etc = Path(environment.get(PX4_ETC) or binary.parents[1] / "etc").resolve()
    if not (etc / "init.d-posix" / "rcS").is_file():
        raise InputError(f"{etc}: PX4's start scripts are not there; name their folder etc with {PX4_ETC}")
    return RealAutopilot(personality, binary, etc)
