"""One map of all vehicles: each where it lies in the frame that they share, and added up; the paper's V of (5)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from companion.control.sharing import Frame
from companion.errors import CompanionError
from companion.ground.station import VehicleView
from companion.mapping.files.merge import LEAST, MOST, IndexedMap, MergedMap
from companion.mapping.files.moved import MovedMap
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import NOTHING
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSource


class NoWholeMapError(CompanionError):
    """The maps cannot be put together."""


@contextmanager
def whole_map(vehicles: Sequence[VehicleView], leaves_out: Callable[[str], None]) -> Iterator[MapSource]:
    """All maps as one while the block runs; copies of them lie on the disk as long.

    Sums are clamped to the least and the greatest value that any of the maps holds.

    Args:
        vehicles: whose maps.
        leaves_out: is told of each vehicle that is not in it, and why.

    Raises:
        NoWholeMapError: no map can be in it, their voxels differ, or one lies nowhere.
        OSError: there is no room for the copies.
    """
    with ExitStack() as stack:
        room = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="companion-ground-")))
        lowest, highest, threshold = 0, 0, 0
        maps: list[IndexedMap] = []
        for number, vehicle in enumerate(vehicles):
            told = vehicle.telemetry
            if told is None or told.frame is None:
                leaves_out(f"{vehicle.name} has not said where its map lies")
                continue
            try:
                source = vehicle.source()
            except CompanionError:
                leaves_out(f"{vehicle.name} has no map yet")
                continue
            kept = _Kept(source)
            header = Header(source.voxel_m, source.threshold, LEAST, MOST, "of the vehicle")
            copy = stack.enter_context(Journal.open(room / str(number), header))
            copy.append_all(kept)
            lowest, highest = min(lowest, kept.lowest), max(highest, kept.highest)
            threshold = max(threshold, source.threshold)
            lies = Frame(*told.frame)
            try:
                maps.append(copy if lies == Frame() else MovedMap(copy, lies))
            except ValueError as error:
                raise NoWholeMapError(f"{vehicle.name}: {error}; look at its fleet.start_pose") from None
        if not maps:
            raise NoWholeMapError("no vehicle has a map and has said where it lies (fleet.start_pose)")
        try:
            merged = MergedMap(maps, threshold, lowest, highest)
        except ValueError as error:
            raise NoWholeMapError(f"{error}; fly with one mapping.voxel_m") from None
        yield merged


class _Kept:
    """A map that is read once, and what its values were: nobody says its clamps."""

    def __init__(self, source: MapSource) -> None:
        self._source = source
        self.voxel_m, self.threshold = source.voxel_m, source.threshold
        self.lowest, self.highest = 0, 0

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """As they are."""
        for piece in self._source.pieces(most_chunks):
            known = piece.values[piece.values != NOTHING]
            self.lowest = min(self.lowest, int(known.min(initial=0)))
            self.highest = max(self.highest, int(known.max(initial=0)))
            yield piece
