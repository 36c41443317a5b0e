"""What an earlier simulated mission has left in its folder to the next sortie in the same mine."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from pathlib import Path

from companion.config.mapping import MapSettings
from companion.errors import InputError
from companion.mapping import VoxelMap
from companion.mapping.files.ground_file import GROUND_NAME, read_known_ground
from companion.mapping.journal import JOURNAL_NAME, Header, Journal
from companion.model import Pose
from sitl.mines import World
from sitl.sim.earlier import Earlier

_POSE = ("x_m", "y_m", "z_m", "yaw_rad")


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """One mission that has ended.

    Attributes:
        folder: of it.
        world: the name of its mine.
        start: where its vehicle began.
        left: its known ground and its map.
    """

    folder: Path
    world: str
    start: Pose
    left: Earlier

    @classmethod
    def read(cls, folder: Path, settings: MapSettings) -> EarlierRun:
        """The mission in a folder of `companion sim`, which one vehicle has flown.

        Args:
            folder: of it.
            settings: of the map that goes on.

        Raises:
            InputError: there is none, or its map is of another kind.
            CompanionError: its map cannot be read.
        """
        summary, trajectory = folder / "summary.json", folder / "trajectory.csv"
        try:
            world = str(json.loads(summary.read_text(encoding="utf-8"))["world"])
            with trajectory.open(encoding="utf-8", newline="") as file:
                row = next(csv.DictReader(file))
            start = Pose(0.0, *(float(row[name]) for name in _POSE))
        except OSError as error:
            raise InputError(
                f"--resume {folder}: {error.filename}: {error.strerror}; give the folder of a mission of one vehicle"
            ) from None
        except (ValueError, LookupError, TypeError, StopIteration):
            raise InputError(
                f"--resume {folder}: {summary.name} or {trajectory.name} is damaged; nothing can go on from there"
            ) from None
        ground = read_known_ground(folder / GROUND_NAME)
        voxels = VoxelMap(settings)
        with Journal.read_only(folder / JOURNAL_NAME) as journal:
            if differences := Header.of(settings).differences(journal.header):
                raise InputError(f"--resume {folder}: a map of another kind: {', '.join(differences)} (mapping)")
            voxels.merge(journal)
        return cls(folder, world, start, Earlier(ground, voxels))

    def mine_of(self, mine: World, same_start: bool) -> World:
        """The mine of the next sortie.

        Args:
            mine: the one that was asked for.
            same_start: whether it begins where this mission began; else where the mine says.

        Raises:
            InputError: it is another mine.
        """
        if mine.name != self.world:
            raise InputError(
                f"--resume {self.folder}: was flown in {self.world}, not in {mine.name}; give that --world"
            )
        return replace(mine, start=self.start) if same_start else mine
