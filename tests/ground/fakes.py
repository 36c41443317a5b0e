"""Vehicles that are what a test says, and the page of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from companion.config.mapping import MapSettings
from companion.link.words import Answer, Command, Place, Telemetry
from companion.mapping import VoxelMap
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MapPiece, MapSnapshot, MapSource
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines

VOXEL_M = 0.1


def telling(name: str = "Kobold", **known: object) -> Telemetry:
    """The telemetry of a flight in which all is well."""
    usual: dict[str, object] = {
        "flight": "20261129-1130",
        "number": 1,
        "t_s": 60.0,
        "phase": "exploring",
        "mode": "R2 along a tangent",
        "x_m": 3.0,
        "y_m": 1.0,
        "z_m": 1.5,
        "yaw_rad": 0.5,
        "d_m": 1.8,
        "margin_m": 1.0,
        "h_m": 1.5,
        "height_m": 1.5,
        "target_m": (6.0, 1.5, 1.5),
        "battery_percent": 70.0,
        "home_m": 25.0,
        "home_s": 65.0,
        "left_at_home_percent": 52.0,
        "reserve_percent": 25.0,
        "completeness": 0.4,
        "frontiers": 2,
    }
    return Telemetry(vehicle=name, **(usual | known))  # type: ignore[arg-type]


class FakeVehicle:
    """A `VehicleView` whose map is a tunnel along x that a test lets grow."""

    def __init__(self, name: str = "Kobold", telemetry: Telemetry | None = None) -> None:
        self.name = name
        self.telemetry = telemetry or telling(name)
        self.age_s = 0.1
        self.doubt = ""
        self.map_age_s = 0.0
        self.map_number = 0
        self.map = VoxelMap(MapSettings())
        self.asked: list[Command] = []
        self.answer: Answer | None = Answer(accepted=True)
        self.way: list[Place] = []

    def dig(self, chunks: int, *, first: int = 0, y: int = 0) -> None:
        """Map a tunnel with ground, roof and walls over so many chunks along x."""
        coordinates = np.array([[x, y, z] for x in range(first, first + chunks) for z in (0, 1)], np.int32)
        voxels = coordinates[:, None] * 16 + OFFSETS
        across, up = voxels[..., 1] - y * 16, voxels[..., 2]
        inside = (across > 0) & (across < 15) & (up > 0) & (up < 25)
        shell = ~inside & (up <= 25)
        values = np.where(inside, np.int16(-1500), np.where(shell, np.int16(2000), NOTHING)).astype(np.int16)
        self.map.put(MapPiece(coordinates, values))

    def changed(self, revision: int) -> MapSnapshot:
        return self.map.snapshot(revision)

    def source(self) -> MapSource:
        return self.map

    def way_m(self) -> FloatArray:
        return np.array(self.way, np.float64).reshape(-1, 3)

    def graph(self) -> Sequence[GraphLines]:
        return [GraphLines("boundary arc", "#0072b2", np.array([[[0.0, 0.8, 1.0], [4.0, 0.8, 1.0]]]))]

    def frontiers_m(self) -> Sequence[Place]:
        return [(9.0, 0.8, 1.0)]

    def ask(self, command: Command, on_answer: Callable[[Answer | None], None]) -> None:
        self.asked.append(command)
        on_answer(self.answer)


class FakeStation:
    """A `Station` of such vehicles."""

    def __init__(self, *vehicles: FakeVehicle) -> None:
        self.known = list(vehicles)

    def vehicles(self) -> Sequence[FakeVehicle]:
        return self.known
