"""The recorder: takes what a tick gives in microseconds, and writes it in a thread of its own."""

from __future__ import annotations

import logging
import queue
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from companion.clock import Clock
from companion.config.mission import RecordSettings
from companion.pipeline import Tick
from companion.recording.content import FlightInfo
from companion.recording.writing import RecordingFile, Writing

WAITING = 512
"""Most ticks and events that wait for the disk: 25 s at 20 Hz."""
FRAMES_WAITING = 8
"""Most depth images among them: 10 MB at 640 x 480."""
CLOSE_S = 5.0
"""How long the end of a flight waits for a slow disk."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Event:
    """A line of the log on its way to the file."""

    name: str
    text: str
    level: int
    t_s: float


@dataclass(frozen=True, slots=True)
class _Numbered:
    """A tick on its way to the file. The numbers show a reader whether one is missing."""

    tick: Tick
    number: int
    with_frame: bool


class Recorder:
    """Records one flight into an MCAP file. Never raises, never waits: a flight goes on without its recording.

    Use as a context manager. What goes wrong is logged once and kept in `problem`.

    Args:
        path: the file, which must not exist yet; its folder is made.
        settings: whether, what, and how much.
        info: what has to be known of the flight.
    """

    def __init__(self, path: Path, settings: RecordSettings, info: FlightInfo, clock: Clock) -> None:
        self.path = path
        self.problem: str | None = None
        """Why nothing is recorded any more; ``None`` while all is well, and when the settings want no recording."""
        self.ticks_dropped = 0
        """Ticks and events for which there was no room in the queue."""
        self.frames_dropped = 0
        """Depth images that were left out though the settings want them."""
        self._settings = settings
        self._info = info
        self._clock = clock
        self._queue: queue.Queue[_Numbered | _Event] = queue.Queue(WAITING)
        self._ticks = 0
        self._frames_waiting = 0
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def recording(self) -> bool:
        """Whether what is handed over gets into the file."""
        return self._thread is not None and self.problem is None

    @property
    def waiting(self) -> int:
        """Ticks and events that are not in the file yet. Whoever flies faster than real time waits for them."""
        return self._queue.qsize()

    def __enter__(self) -> Self:
        if self._settings.enabled:
            try:
                file = RecordingFile(self.path, self._settings.largest_mb * 1e6)
            except OSError as error:
                self._stop(error.strerror or str(error))
                return self
            self._thread = threading.Thread(target=self._run, args=(file,), name="recorder", daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Write what waits and end the file; gives a disk that hangs up after `CLOSE_S`."""
        if self._thread is not None:
            self._closing.set()
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                self._stop(f"the disk took longer than {CLOSE_S:g} s at the end")
            self._thread = None

    def tick(self, tick: Tick) -> None:
        """Record a sampling period; one without a pose has nothing that could be flown again, and leaves a gap."""
        if not self.recording or tick.observation is None:
            return
        with_frame = False
        if tick.observation.frame is not None and self._settings.depth:
            with self._lock:
                with_frame = self._frames_waiting < FRAMES_WAITING
                self._frames_waiting += with_frame
                self.frames_dropped += not with_frame
        self._put(_Numbered(tick, self._ticks, with_frame))
        self._ticks += 1

    def event(self, name: str, text: str, level: int = logging.INFO, t_s: float | None = None) -> None:
        """Record something that happened.

        Args:
            name: what kind, such as `companion.recording.content.ENGAGED`, "statustext", "check".
            text: for people.
            level: as in `logging`.
            t_s: when; by default now.
        """
        if self.recording:
            self._put(_Event(name, text, level, self._clock.now_s() if t_s is None else t_s))

    def _put(self, item: _Numbered | _Event) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.ticks_dropped += 1
            self._frame_left(item)

    def _frame_left(self, item: _Numbered | _Event) -> None:
        if isinstance(item, _Numbered) and item.with_frame:
            with self._lock:
                self._frames_waiting -= 1

    def _stop(self, problem: str) -> None:
        if self.problem is None:
            self.problem = f"{self.path}: not recorded any further: {problem}; the flight goes on without"
            _log.warning(self.problem)

    # What follows runs in the recorder's own thread.

    def _run(self, file: RecordingFile) -> None:
        try:
            writing = Writing(file, self._info, self._clock)
            try:
                while self._step(writing, file):
                    pass
            finally:
                writing.close()
        except Exception as error:  # noqa: BLE001 - whatever it is, it must not end the flight, nor pass unseen
            self._stop(f"{type(error).__name__}: {error}")
        finally:
            file.close()
        if file.problem is not None:
            self._stop(file.problem)

    def _step(self, writing: Writing, file: RecordingFile) -> bool:
        """One item of the queue; False when there is nothing more to record."""
        try:
            item = self._queue.get(timeout=0.1)
        except queue.Empty:
            item = None
            if self._closing.is_set():
                return False
        if isinstance(item, _Event):
            writing.channels.event(item.name, item.text, item.level, item.t_s)
        elif item is not None:
            self._frame_left(item)
            with_frame = item.with_frame
            if with_frame and not file.room_for_frames:
                with_frame = False
                self._frame_left_out(writing, file)
            writing.tick(item.tick, item.number, with_frame)
        writing.now_and_then(self.ticks_dropped, self.frames_dropped)
        if file.problem is not None:
            return False
        if file.full:
            reason = f"it has grown to its limit of {file.limit / 1e6:.0f} MB (record.largest_mb, or the disk)"
            writing.event("recording", f"stopped: {reason}", logging.WARNING)
            self._stop(reason)
            return False
        return True

    def _frame_left_out(self, writing: Writing, file: RecordingFile) -> None:
        with self._lock:
            self.frames_dropped += 1
        if not writing.told_of_frames:
            writing.told_of_frames = True
            text = f"no depth images from here on: {file.size / 1e6:.0f} of {file.limit / 1e6:.0f} MB are used"
            writing.event("recording", text, logging.WARNING)
            _log.warning("%s: %s", self.path, text)
