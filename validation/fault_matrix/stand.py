"""What a flight of the matrix flies on: the stub, or a real autopilot with its own simulator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from companion.config.settings import Settings
from sitl.launch.processes import AUTOPILOT_SERVES, command
from sitl.launch.program import Ports, Program
from sitl.launch.real import RealAutopilot
from tests.integration.relay import LOOPBACK
from tests.integration.rig import BOOT_S, SILENCE
from tests.integration.witness import Witness
from validation.real.station import Station


class Stand(ABC):
    """One autopilot and what belongs to it.

    Attributes:
        personality: px4 or ardupilot.
        gps: whether it has GPS; if not the world gives it odometry.
        world_options: for the world.
    """

    personality: str
    gps: bool
    world_options: Sequence[str]

    @abstractmethod
    def wanted(self) -> Ports:
        """Where it sends to; 0: anywhere."""

    @abstractmethod
    def witness(self, port: int) -> Witness:
        """Who looks on from the ground, at this port."""

    @abstractmethod
    def program(self, folder: Path, settings: Settings, to: Ports, control_port: int) -> Program:
        """Its process, which sends to these ports and is commanded at another."""


@dataclass(frozen=True)
class StubStand(Stand):
    """The flight controller made of software."""

    personality: str
    gps: bool = True
    world_options: Sequence[str] = ()

    def wanted(self) -> Ports:
        return Ports(0, 0, 0)

    def witness(self, port: int) -> Witness:
        return Witness(port)

    def program(self, folder: Path, settings: Settings, to: Ports, control_port: int) -> Program:  # noqa: ARG002
        options = (
            *("--personality", self.personality, "--boot-s", f"{BOOT_S:g}", "--control", str(control_port)),
            *(part for port in (to.application, to.ground, to.world) for part in ("--to", f"{LOOPBACK}:{port}")),
            *(part for parameter in SILENCE[self.personality] for part in ("--param", parameter)),
        )
        return Program("autopilot", (*command("sitl", "autopilot"), *options), AUTOPILOT_SERVES)


@dataclass(frozen=True)
class RealStand(Stand):
    """One of the real ones, without GPS unless it says otherwise.

    Attributes:
        real: its program.
        parameters: set before it boots.
    """

    real: RealAutopilot
    gps: bool = False
    world_options: Sequence[str] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def personality(self) -> str:  # type: ignore[override]
        return self.real.personality

    def wanted(self) -> Ports:
        return self.real.ports

    def witness(self, port: int) -> Witness:
        return Station(port)

    def program(self, folder: Path, settings: Settings, to: Ports, control_port: int) -> Program:  # noqa: ARG002
        return self.real.program(folder, settings, self.parameters, to)
