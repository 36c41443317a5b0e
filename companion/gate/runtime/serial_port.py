"""Serial ports: opened as often as they are plugged in, and in words when they cannot be."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import termios
from pathlib import Path

import serial

from companion.gate.runtime.streams import Line
from companion.mavlink.codec import LONGEST_FRAME

WAITING_S = 0.1
"""What a slow serial line could send in this time may wait in it: older setpoints would be no setpoints."""
BITS_PER_BYTE = 10
BY_ID = Path("/dev/serial/by-id")
MOST_NAMES = 4


class SerialPort:
    """Opens one port, for us alone; as often as it is plugged in.

    Args:
        device: its path.
        baud: bits per second.
    """

    def __init__(self, device: str, baud: int) -> None:
        self.most_waiting = max(LONGEST_FRAME, int(baud / BITS_PER_BYTE * WAITING_S))
        self.lost = "nothing can be read any more: was it unplugged?"
        self._device = device
        self._baud = baud

    def fileno(self) -> int | None:
        """See `Opener`."""
        return None

    def open(self) -> Line | None:
        """See `Opener`."""
        try:
            return _OpenPort(serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True))
        except OSError as error:
            raise OSError(_in_words(self._device, error)) from error
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


def _in_words(device: str, error: OSError) -> str:
    """What is wrong with a port, and what to do."""
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"there is no {device}: look at cable and power, or configure another; {_there()}"
    if error.errno in (errno.EACCES, errno.EPERM):
        return (
            f"{device} may not be opened by this user: add it to the group that owns the port "
            "(sudo usermod -aG dialout $USER), then log in again"
        )
    if error.errno in (errno.EBUSY, errno.EAGAIN):
        return (
            f"{device} is used by another program (a ground station, ModemManager, a login on the port): end it; "
            f"sudo fuser {device} names it"
        )
    return f"{device}: {error}"


def _there() -> str:
    """The ports of USB that are plugged in, by the names that stay the same."""
    try:
        names = sorted(os.listdir(BY_ID))  # noqa: PTH208 - names are wanted, not paths
    except OSError:
        return f"no serial port of USB is plugged in ({BY_ID} is empty)"
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f"plugged in: {', '.join(str(BY_ID / name) for name in names[:MOST_NAMES])}{more}"
