"""How the ground's copy follows a vehicle's map: what is asked next, and what an answer means. No network in here."""

from __future__ import annotations

import logging
import math
import re
from dataclasses import fields
from pathlib import Path

import numpy as np

from companion.clock import Clock
from companion.link.coarse import read_coarse
from companion.link.ground.copy import MapCopy
from companion.link.map_wire import BUCKETS, Ask, Told, bits_of
from companion.link.wire import WireError
from companion.mapping.journal import JOURNAL_NAME, Header, JournalError

FRESH_S = 3.0
"""What was known to be all of the map is all of it for this long without another word."""

COARSE_BEHIND_S = 8.0
"""With more missing than comes in this time, a coarse picture comes first."""

COARSE_PERIOD_S = 4.0
"""And again of what has changed meanwhile, this often."""

LEAST_BEHIND_S = 0.001

ANEW_PERIOD_S = 60.0

FIRST_BYTES = 8_000
LEAST_BYTES, MOST_BYTES = 2_000, 64_000
ANSWER_S = 0.4
"""As much is asked for as comes in this time."""

_MAP_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")

_log = logging.getLogger(__name__)


def is_map_name(text: str) -> bool:
    """Whether a vehicle's map may be called so: it is the name of a folder here."""
    return _MAP_NAME.fullmatch(text) is not None


class MapSync:
    """Follows one vehicle's map. Members that the page asks may be asked from any thread.

    Args:
        folder: of the vehicle; each of its maps has a folder in it.
        by: who asks, for the vehicle.
        clock: for ages.

    Attributes:
        map: the name of the map that is followed; empty: none yet.
        copy: of it; None before anything came.
        number: grows with each copy that begins anew or is of another map: what was shown is void then.
        problem: what is wrong, in words; empty when nothing is.
    """

    def __init__(self, folder: Path, by: str, clock: Clock) -> None:
        self.map = ""
        self.copy: MapCopy | None = None
        self.number = 0
        self.problem = ""
        self._folder = folder
        self._by = by
        self._clock = clock
        self._epoch = ""
        self._after = self._until = 0
        self._buckets = ""
        self._coarse_after = 0
        self._next_coarse_s = -math.inf
        self._most_bytes = FIRST_BYTES
        self._bytes_per_s = 0.0
        self._behind_s = math.inf
        self._behind_bytes = 0
        self._told_s = -math.inf
        self._mismatches = 0
        self._anew_s = -math.inf

    def close(self) -> None:
        """Let go of the copy."""
        copy, self.copy = self.copy, None
        if copy is not None:
            try:
                copy.close()
            except OSError as error:
                _log.error("%s: the copy of the map was not kept: %s", copy.folder, error.strerror)

    @property
    def has_all(self) -> bool:
        """Whether the copy was the vehicle's map by its last word."""
        return self._behind_s == 0.0

    @property
    def age_s(self) -> float:
        """How old what is missing is; 0 when nothing is, infinite when nothing is known."""
        silent_s = self._clock.now_s() - self._told_s
        return 0.0 if self.has_all and silent_s <= FRESH_S else self._behind_s + silent_s

    def follow(self, name: str) -> None:
        """From now on follow the map of this name; the copy that is on the disk is its beginning."""
        if name == self.map:
            return
        self.close()
        self.map, self._epoch, self._behind_s = name, "", math.inf
        self.number += 1
        self.problem = ""
        if (self._folder / name / JOURNAL_NAME).is_dir():
            self._open(None)

    def next_ask(self) -> Ask:
        """What to ask now."""
        if not self._epoch or self.copy is None:
            return Ask("sums", self.map, by=self._by)
        is_thin = self._behind_bytes > COARSE_BEHIND_S * self._bytes_per_s > 0.0
        is_coarse = is_thin and self._clock.now_s() >= self._next_coarse_s
        return Ask(
            "coarse" if is_coarse else "chunks",
            self.map,
            self._epoch,
            max(self._after, self._coarse_after) if is_coarse else self._after,
            self._until,
            self._buckets if self._after < self._until else "",
            self._most_bytes,
            self._by,
        )

    def take(self, ask: Ask, told: Told, body: bytes, size_bytes: int, took_s: float) -> None:
        """Take an answer.

        Args:
            ask: what was asked.
            told: the head of the answer.
            body: its body.
            size_bytes: of the answer as it came.
            took_s: from the question to the answer.

        Raises:
            WireError: it makes no sense.
            JournalError: the copy cannot be opened.
            OSError: the disk is full or broken; the same is asked again.
        """
        if told.map != self.map:
            return
        silent_s, self._told_s = self._clock.now_s() - self._told_s, self._clock.now_s()
        if ask.what == "sums":
            self._compare(told, body)
        elif told.epoch != self._epoch:
            # What has changed since the last word is not known before the two have compared.
            self._epoch, self._behind_s = "", max(self._behind_s, silent_s, LEAST_BEHIND_S)
        elif ask.what == "coarse" and self.copy is not None:
            self.copy.take_coarse(read_coarse(body))
            self._coarse_after = told.until
            if told.until == told.head:
                self._next_coarse_s = self._clock.now_s() + COARSE_PERIOD_S
        elif ask.what == "chunks" and self.copy is not None:
            self._pace(size_bytes, took_s)
            if self.copy.take(body) or told.until > self._after:
                self.copy.keep()
            self._after = told.until
            self._behind_bytes, self._behind_s = told.behind_bytes, max(told.behind_s, LEAST_BEHIND_S)
            if told.until == told.head:
                self._verify(told)

    def lost(self) -> None:
        """No answer came in time: maybe it was too large."""
        self._most_bytes = max(LEAST_BYTES, self._most_bytes // 2)

    def _pace(self, size_bytes: int, took_s: float) -> None:
        rate = size_bytes / max(took_s, 1e-3)
        self._bytes_per_s = rate if self._bytes_per_s == 0.0 else 0.7 * self._bytes_per_s + 0.3 * rate
        # Compressed it is about half of what was asked for.
        wanted = min(2.0 * self._most_bytes, 2.0 * ANSWER_S * self._bytes_per_s)
        self._most_bytes = int(min(max(wanted, LEAST_BYTES), MOST_BYTES))

    def _compare(self, told: Told, body: bytes) -> None:
        if told.header is None:
            return
        header = _header(told.header)
        if self.copy is None:
            self._open(header)
        copy = self.copy
        if copy is None or len(body) != 8 * BUCKETS:
            raise WireError("no sums of the map came")
        differ = np.frombuffer(body, np.uint64) != copy.sums
        self._epoch, self._until = told.epoch, told.head
        self._after = 0 if differ.any() else told.head
        self._coarse_after, self._buckets = 0, bits_of(differ)
        if not differ.any():
            self._behind_s, self._behind_bytes, self._mismatches = 0.0, 0, 0

    def _verify(self, told: Told) -> None:
        """Whether the copy is the vehicle's map, now that nothing is missing."""
        if self.copy is None or self.copy.sum == told.sum:
            self._behind_s, self._mismatches = 0.0, 0
            return
        # Something is here that is not there, or was damaged on the disk: compare again, then begin anew.
        self._mismatches += 1
        self._epoch = ""
        now_s = self._clock.now_s()
        if self._mismatches > 1 and now_s - self._anew_s > ANEW_PERIOD_S:
            self._anew_s, self._mismatches = now_s, 0
            self._begin_anew()

    def _begin_anew(self) -> None:
        if self.copy is None:
            return
        folder, header = self.copy.folder, self.copy.header
        _log.warning("%s: the copy has what the vehicle's map has not (any more): it begins anew", folder)
        self.close()
        self.number += 1
        self.copy = MapCopy.anew(folder, header)

    def _open(self, header: Header | None) -> None:
        folder = self._folder / self.map
        try:
            self.copy = MapCopy(folder, header)
        except JournalError:
            if header is None:
                # What is on the disk cannot be read; the vehicle has everything.
                return
            self.number += 1
            self.copy = MapCopy.anew(folder, header)


def _header(said: dict[str, object]) -> Header:
    try:
        header = Header(**{field.name: said[field.name] for field in fields(Header)})  # type: ignore[arg-type]
        is_possible = math.isfinite(header.voxel_m) and 0.0 < header.voxel_m < 100.0
        if not is_possible or not isinstance(header.settings, dict) or len(str(said)) > 100_000:
            raise ValueError
        return Header(
            float(header.voxel_m),
            int(header.threshold),
            int(header.lowest),
            int(header.highest),
            str(header.frame),
            header.settings,
        )
    except (KeyError, TypeError, ValueError):
        raise WireError("no header of a map came") from None
