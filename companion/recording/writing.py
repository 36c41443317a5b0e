"""The writing of a recording.

The file grows by half a second at a time, each part whole: one that ends in the middle, because the process was killed
or the power went, is readable up to there.

Nothing is compressed. The native writer holds the interpreter's lock while it compresses, 30 to 60 ms for a 640 x 480
depth image, during which nothing flies the vehicle; without compression it is 2 ms.
"""

from __future__ import annotations

import json
import logging
import math
import os
import shutil
import time
from pathlib import Path

import foxglove
from foxglove import Context
from foxglove.mcap import MCAPWriteOptions, MCAPWriter

from companion.clock import Clock
from companion.mapping.files.ground_file import GROUND_NAME
from companion.model import Mode
from companion.pipeline import Tick
from companion.recording.channels import Channels
from companion.recording.content import FORMAT, METADATA, FlightInfo
from companion.recording.process import LoadMeter

FLUSH_S = 0.5
"""So much is lost when the process is killed."""
SYNC_S = 2.0
"""So much is lost when the power goes."""
SCAN_S = 0.5
PROCESS_S = 1.0
CHUNK_BYTES = 1 << 18

FRAMES_SHARE, FULL_SHARE = 0.8, 0.95
"""Depth images end at the first share of the limit, everything at the second: what is buffered and the index at the
end of the file still have to fit."""

KEEP_FREE_BYTES = 200_000_000
"""Left free on the disk when the flight begins: the map has to be written at its end."""


class RecordingFile:
    """A file-like object for the MCAP writer. It only appends.

    The first error of the disk ends the writing and is kept in `problem`; from then on everything is swallowed.

    Args:
        path: a new file; its folder is made.
        largest_bytes: limit of its size; less when the disk has less to give.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: Path, largest_bytes: float) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered: what is written is in the hands of the operating system and survives the end of this process.
        self._file = path.open("xb", buffering=0)
        self.problem: str | None = None
        self.size = 0
        self.limit = min(largest_bytes, max(shutil.disk_usage(path.parent).free - KEEP_FREE_BYTES, 0.0))

    @property
    def room_for_frames(self) -> bool:
        """Whether depth images may still be written."""
        return self.size < FRAMES_SHARE * self.limit

    @property
    def full(self) -> bool:
        """Whether the limit is reached: close the file."""
        return self.size >= FULL_SHARE * self.limit

    def write(self, data: bytes | bytearray) -> int:
        """Append; always claims success, see `problem`."""
        left = memoryview(data)
        try:
            while left and self.problem is None:
                left = left[self._file.write(left) :]
        except OSError as error:
            self.problem = _reason(error)
        self.size += len(data)
        return len(data)

    def seek(self, _offset: int, _whence: int = 0) -> int:
        """The writer only asks where it stands."""
        return self.size

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        """Have the disk keep what was written, through a loss of power too. May take long."""
        if self.problem is None:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                self.problem = _reason(error)

    def close(self) -> None:
        """Give the file back."""
        try:
            self._file.close()
        except OSError as error:
            self.problem = self.problem or _reason(error)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


class Writing:
    """The open file, what has to be done to it regularly, and what is known of the inputs so far.

    Everything here runs in the recorder's thread.

    Args:
        file: where it goes.
        info: stands at its beginning.
    """

    def __init__(self, file: RecordingFile, info: FlightInfo, clock: Clock) -> None:
        self._file = file
        self._clock = clock
        self._wall_ns, self._start_s = time.time_ns(), clock.now_s()
        self._context = context = Context()  # kept: its channels close when it goes
        options = MCAPWriteOptions(
            compression=None, chunk_size=CHUNK_BYTES, disable_seeking=True, calculate_data_section_crc=False
        )
        self._mcap: MCAPWriter = foxglove.open_mcap(file, context=context, writer_options=options)
        self._mcap.write_metadata(METADATA, _metadata(info, self._wall_ns, self._start_s))
        if info.known_ground:
            times = {"log_time": self._wall_ns, "create_time": self._wall_ns}
            self._mcap.attach(**times, name=GROUND_NAME, media_type="application/zip", data=info.known_ground)
        self.channels = Channels(context, self._wall_ns, self._start_s)
        self.told_of_frames = False
        self._mode: Mode | None = None
        self._meter = LoadMeter()
        self._next_scan_s = -math.inf
        self._next_process_s = self._next_flush_s = self._next_sync_s = -math.inf

    def tick(self, tick: Tick, number: int, with_frame: bool) -> None:
        """One sampling period; of the scan only every half a second, and a change of mode as an event too."""
        observation, measurement = tick.known()
        if tick.mode != self._mode:
            before = "the start" if self._mode is None else self._mode.value
            self.channels.event("mode", f"{before} -> {tick.mode.value}", logging.INFO, observation.t_s)
            self._mode = tick.mode
        self.channels.tick(tick, number, with_frame)
        if measurement.scan is not None and observation.t_s >= self._next_scan_s:
            self._next_scan_s = observation.t_s + SCAN_S
            self.channels.scan(measurement.scan, observation.t_s)

    def event(self, name: str, text: str, level: int) -> None:
        """Something that the recorder itself has to say, now."""
        self.channels.event(name, text, level, self._clock.now_s())

    def now_and_then(self, ticks_dropped: int, frames_dropped: int) -> None:
        """What is due by now: the load of the processor, and getting what is buffered to the disk."""
        # By the machine's time, not the flight's: a simulated clock may stand or race.
        now_s = time.monotonic()
        if now_s >= self._next_process_s:
            self._next_process_s = now_s + PROCESS_S
            t_s = self._clock.now_s()
            counts = {
                "wall_clock_steps_s": (time.time_ns() - self._wall_ns) / 1e9 - (t_s - self._start_s),
                "ticks_dropped": ticks_dropped,
                "frames_dropped": frames_dropped,
                "file_bytes": self._file.size,
            }
            self.channels.process(counts | self._meter.sample(now_s), t_s)
        if now_s >= self._next_flush_s:
            self._next_flush_s = now_s + FLUSH_S
            self._mcap.flush()
        if now_s >= self._next_sync_s:
            self._next_sync_s = now_s + SYNC_S
            self._file.sync()

    def close(self) -> None:
        """End the file."""
        self.channels.close()
        self._mcap.close()
        self._file.sync()


def _metadata(info: FlightInfo, wall_ns: int, start_s: float) -> dict[str, str]:
    return {
        "format": str(FORMAT),
        "settings": info.settings_yaml,
        "navigator_rng": info.rng_state,
        "vehicle_id": str(info.vehicle_id),
        "versions": json.dumps(info.versions),
        "wall_ns_at_start": str(wall_ns),
        "clock_s_at_start": repr(start_s),
    }
