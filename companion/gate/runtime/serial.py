"""A serial port as a stream."""

from __future__ import annotations

import contextlib
import fcntl
import termios

import serial

from companion.gate.runtime.tcp import Line
from companion.mavlink.codec import LONGEST_FRAME

WAITING_S = 0.1
"""What a slow line could send in this time may wait in it: older setpoints would be no setpoints."""
BITS_PER_BYTE = 10


class SerialPort:
    """Opens one port, for us alone; as often as it is plugged in.

    Args:
        device: its path.
        baud: bits per second.
    """

    def __init__(self, device: str, baud: int) -> None:
        self.most_waiting = max(LONGEST_FRAME, int(baud / BITS_PER_BYTE * WAITING_S))
        self._device = device
        self._baud = baud

    def fileno(self) -> int | None:
        """See `Opener`."""
        return None

    def open(self) -> Line | None:
        """See `Opener`."""
        try:
            return _OpenPort(serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True))
        except (termios.error, ValueError) as error:
            raise OSError(f"{self._device}: {error}") from error

    def close(self) -> None:
        """See `Opener`."""


class _OpenPort:
    def __init__(self, port: serial.Serial) -> None:
        self._port = port
        # Programs that do not ask for the lock cannot open it either, root's excepted.
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
        # USB adapters keep bytes for 16 ms otherwise; not every port knows of it.
        with contextlib.suppress(ValueError, NotImplementedError):
            port.set_low_latency_mode(True)

    def fileno(self) -> int:
        found: int = self._port.fileno()
        return found

    def close(self) -> None:
        # What was not sent is old by now; to wait for it would stop everything else.
        with contextlib.suppress(OSError, termios.error):
            self._port.reset_output_buffer()
        self._port.close()
