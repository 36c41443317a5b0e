"""Vehicle and ground without a network between them, or with a bad one: what is asked and answered goes by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.link.ground.sync import MapSync
from companion.link.map_wire import answer, asked, read_answer, read_ask
from companion.link.vehicle.map_teller import MapTeller
from companion.mapping.journal import Journal
from tests.mapping.journal.journals import HEADER, Chunk, held, piece, surface
from tests.shared.clocks import HandClock

MAP = "20260101-120000"


class Mine:
    """A map that grows, as the map's process writes it: mostly where it changed last."""

    def __init__(self, folder: Path, seed: int = 1) -> None:
        self.folder = folder / MAP
        self.journal = Journal.open(self.folder / "map.journal", HEADER, segment_bytes=400_000)
        self._random = np.random.default_rng(seed)
        self._at = 0

    def grow(self, chunks: int = 6) -> None:
        """Some chunks change, new ones among them."""
        self._at += 1
        changed: dict[Chunk, np.ndarray] = {}
        for _ in range(chunks):
            x, y, z = self._at // 3 + int(self._random.integers(0, 4)), *map(int, self._random.integers(-2, 2, 2))
            changed[x, y, z] = surface(int(self._random.integers(0, 1 << 30)))
        self.journal.append(piece(changed))
        self.journal.compact_step(1.0)
        self.journal.commit()


class Exchange:
    """Both sides of the link.

    Args:
        folder: the ground's.
        mine: the vehicle's map.
        loss: share of the messages that get lost, in each direction.
    """

    def __init__(self, folder: Path, mine: Mine, loss: float = 0.0) -> None:
        self.clock = HandClock()
        self.loss = loss
        self.sent_bytes = 0
        self.asks: list[str] = []
        self._mine = mine
        self._folder = folder
        self._random = np.random.default_rng(2)
        self._sessions = 0
        self.restart_vehicle()
        self.sync = MapSync(folder, "ground", self.clock)
        self.sync.follow(MAP)

    def restart_vehicle(self) -> None:
        """The process of the link begins anew."""
        self._sessions += 1
        self.teller = MapTeller(f"{self._sessions:016x}", self._mine.folder / "map.journal", self.clock)

    def restart_ground(self) -> None:
        """The ground begins anew, with what is on its disk."""
        self.sync.close()
        self.sync = MapSync(self._folder, "ground", self.clock)
        self.sync.follow(MAP)

    def follow(self) -> None:
        """The vehicle's side reads what is in the journal."""
        while self.teller.follow():
            pass

    def once(self, bytes_per_s: float = 1e6) -> None:
        """One question, and its answer where both come through."""
        ask = self.sync.next_ask()
        self.asks.append(ask.what)
        self.clock.advance(0.05)
        if self._random.random() < self.loss:
            self.clock.advance(1.0)
            self.sync.lost()
            return
        data = answer(*self.teller.tell(read_ask(asked(ask))))
        self.sent_bytes += len(data)
        took_s = 0.05 + len(data) / bytes_per_s
        self.clock.advance(took_s)
        if self._random.random() < self.loss:
            self.sync.lost()
            return
        self.sync.take(ask, *read_answer(data), len(data), took_s)

    def until_equal(self, most: int = 2000) -> int:
        """Ask until the ground says that it has all; how many questions that took."""
        self.follow()
        for count in range(1, most):
            self.once()
            if self.sync.has_all and self.asks[-1] == "chunks":
                return count
        raise AssertionError(f"the ground has not all of the map after {most} questions")

    def assert_equal(self) -> None:
        """The ground's copy is the vehicle's map, bit for bit, and so say their sums."""
        copy = self.sync.copy
        assert copy is not None
        assert held(copy) == held(self._mine.journal)
