"""Answers the ground's questions about the map, from the journal that the map's process writes."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.clock import Clock
from companion.link.coarse import coarse_body
from companion.link.map_wire import Ask, Told, read_bits
from companion.link.numbering import Changed, ChunkNumbers
from companion.mapping.journal import JournalFollower

PLACE_BYTES = 12
"""Of one place of the way."""

MOST_COARSE = 512
"""Chunks of one coarse answer."""


class MapTeller:
    """What is told of one map. For one thread.

    Args:
        session: of this process; part of the epoch.
        journal: folder of the journal, which need not exist yet.
        clock: for ages.

    Attributes:
        map: the name of the folder that the map is in.
        drawing: graph and frontiers as bytes, as `companion.link.drawing` writes them.
        way: (n, 3) float32, in m, as it was flown since this process began.
    """

    def __init__(self, session: str, journal: Path, clock: Clock) -> None:
        self.map = journal.parent.name
        self.drawing = b""
        self.way = np.empty((0, 3), np.float32)
        self._session = session
        self._clock = clock
        self._follower = JournalFollower(journal)
        self._numbers = ChunkNumbers()

    def close(self) -> None:
        """Let go of the journal."""
        self._follower.close()

    @property
    def epoch(self) -> str:
        """In which the numbers count."""
        return f"{self._session}-{self._follower.rewinds}"

    @property
    def sum(self) -> str:
        """Over all chunks: that of a copy that is equal."""
        return self._numbers.sum

    def follow(self) -> bool:
        """Take what was appended to the journal; whether there may be more.

        Raises:
            JournalError: it is none.
            OSError: it cannot be read.
        """
        rewinds = self._follower.rewinds
        news = self._follower.poll()
        if self._follower.rewinds != rewinds:
            self._numbers = ChunkNumbers()
            return True
        self._numbers.take(news, self._clock.now_s())
        return len(news.keys) > 0

    def tell(self, ask: Ask) -> tuple[Told, bytes]:
        """The answer to a question: head and body.

        Raises:
            WireError: it makes no sense.
        """
        match ask.what:
            case "drawing":
                return self._told(ask.after), self.drawing
            case "way":
                part = self.way[ask.after : ask.after + max(1, ask.most_bytes // PLACE_BYTES)]
                return self._told(ask.after + len(part)), part.tobytes()
            case "sums":
                header = self._follower.header
                told = self._told(self._numbers.head, header=None if header is None else asdict(header))
                return told, self._numbers.sums.tobytes()
        if ask.epoch != self.epoch or ask.map != self.map:
            return self._told(0), b""
        found = self._numbers.after(ask.after, ask.until, read_bits(ask.buckets))
        return self._coarse(found) if ask.what == "coarse" else self._chunks(found, ask.most_bytes)

    def _chunks(self, found: Changed, most_bytes: int) -> tuple[Told, bytes]:
        # One is given in any case, or nothing would ever come of a large one.
        count = max(1, int(np.searchsorted(np.cumsum(found.sizes), most_bytes, side="right")))
        until = int(found.numbers[count - 1]) if count < len(found.keys) else self._numbers.head
        return self._told(until, found.sizes[count:]), b"".join(self._follower.records(found.keys[:count]))

    def _coarse(self, found: Changed) -> tuple[Told, bytes]:
        header = self._follower.header
        until = int(found.numbers[MOST_COARSE - 1]) if len(found.keys) > MOST_COARSE else self._numbers.head
        records = [] if header is None else self._follower.records(found.keys[:MOST_COARSE])
        threshold = 0 if header is None else header.threshold
        return self._told(until, found.sizes[MOST_COARSE:]), coarse_body(records, threshold)

    def _told(
        self, until: int, missing: NDArray[np.int64] | None = None, header: dict[str, object] | None = None
    ) -> Told:
        """A head, with the sizes of what is missing after ``until``."""
        numbers = self._numbers
        count = 0 if missing is None else len(missing)
        oldest_s = numbers.oldest_s(until) if count else None
        return Told(
            epoch=self.epoch,
            map=self.map,
            until=until,
            head=numbers.head,
            sum=numbers.sum,
            chunks=len(numbers),
            behind_chunks=count,
            behind_bytes=0 if missing is None else int(missing.sum()),
            behind_s=0.0 if oldest_s is None else max(0.0, self._clock.now_s() - oldest_s),
            header=header,
        )
