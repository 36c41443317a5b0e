"""What is handed to the recorder, and the names under which it stands in the file."""

from __future__ import annotations

import enum
import json
import platform
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from companion.config.settings import Settings
from companion.config.show import dump_yaml

RECORDING_NAME = "flight.mcap"
"""Name of the recording in the folder of a flight."""

METADATA = "mine-companion"
"""Name of the metadata record by which a file is known to be ours; it stands before every message."""
FORMAT = 1
"""Goes up when older readers can no longer read what is written."""

ENGAGED, ENDED = "engaged", "ended"
"""Names of the events between which the vehicle flies by itself."""
HOMING = "homing"
"""Name of the events of the way home: the first is where it turned back."""

VERSIONS = ("mine-companion", "mavsdk", "numpy", "numba", "foxglove-sdk")


class Topic(enum.StrEnum):
    """The channels of a recording."""

    TICK = "/tick"
    OBSERVATION = "/observation"
    POSE = "/pose"
    TRANSFORMS = "/tf"
    SCAN = "/scan"
    DEPTH = "/depth"
    CALIBRATION = "/depth/camera"
    LOG = "/log"
    PROCESS = "/process"


@dataclass(frozen=True, slots=True)
class FlightInfo:
    """What has to be known of a flight to understand its recording, and to fly it again.

    Attributes:
        settings_yaml: every setting, as `companion.config.show.dump_yaml` writes it.
        rng_state: state of the navigator's generator before it made the first draw, as JSON.
        vehicle_id: number of the vehicle in its fleet, from 1.
        versions: of the software.
        known_ground: what earlier flights had seen of the ground and this one went on from, as the content of the file
            ``known_ground.npz``; empty where there is none.
    """

    settings_yaml: str
    rng_state: str
    vehicle_id: int = 1
    versions: dict[str, str] = field(default_factory=dict)
    known_ground: bytes = b""

    @classmethod
    def of(cls, settings: Settings, rng: np.random.Generator, vehicle_id: int = 1) -> FlightInfo:
        """The flight that begins now; call it before the navigator is made, which draws from ``rng``.

        Raises:
            ValueError: ``rng`` is not of the kind that `numpy.random.default_rng` gives.
        """
        state = rng.bit_generator.state
        if state["bit_generator"] != "PCG64":
            raise ValueError(f"a recording keeps the state of a PCG64 generator, not of {state['bit_generator']}")
        return cls(dump_yaml(settings), json.dumps(state), vehicle_id, _versions())


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
