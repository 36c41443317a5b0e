"""What people ask for: start and stop, by key, by signal, or by a command from a ground station."""

from __future__ import annotations

import asyncio
import contextlib
import math
import signal
import sys
from collections.abc import Iterator
from typing import Any

from companion.autopilot.wire import ONBOARD_COMPONENT, Link, LinkError, Message
from companion.errors import InputError

MISSION_START = 300
"""MAV_CMD_MISSION_START, sent to this component: start the flight."""
PAUSE_CONTINUE = 193
"""MAV_CMD_DO_PAUSE_CONTINUE with parameter 1 = 0: end the flight as configured."""

_ACCEPTED, _DENIED, _UNSUPPORTED = 0, 2, 3


class Orders:
    """Start and stop, from wherever they come.

    Args:
        by_command: whether a ground station may start the flight; it may always stop it.
    """

    def __init__(self, by_command: bool) -> None:
        self.start = asyncio.Event()
        self.stop = asyncio.Event()
        self.interrupted = False
        """Whether the stop came as a signal: Ctrl-C, or the end of the service."""
        self._by_command = by_command

    def listen(self, link: Link) -> None:
        """Obey a ground station's commands to this component."""

        def received(message: Message) -> None:
            self._command(link, message)

        link.events("COMMAND_LONG", received, anyone=True)
        link.events("COMMAND_INT", received, anyone=True)

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """SIGINT and SIGTERM ask for the end of the flight instead of breaking it off."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, self._interrupt)
        try:
            yield
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.remove_signal_handler(number)

    @contextlib.contextmanager
    def enter_key(self) -> Iterator[None]:
        """The Enter key starts.

        Raises:
            InputError: there is no terminal, and nothing that stands for one.
        """
        loop = asyncio.get_running_loop()

        def pressed() -> None:
            if not sys.stdin.readline():
                # The end of the input, as under a service manager: nobody will ever press a key.
                loop.remove_reader(sys.stdin)
                return
            self.start.set()

        try:
            loop.add_reader(sys.stdin, pressed)
        except (OSError, ValueError):  # /dev/null, or no input at all, as under a service manager
            raise InputError(
                "mission.start = key, but there is no terminal: use --start command (a ground station starts the "
                "flight) or --start now"
            ) from None
        try:
            yield
        finally:
            loop.remove_reader(sys.stdin)

    def _interrupt(self) -> None:
        self.interrupted = True
        self.stop.set()

    def _command(self, link: Link, message: Message) -> None:
        fields = message.fields
        if fields.get("target_system") != link.system_id or fields.get("target_component") != ONBOARD_COMPONENT:
            return
        command = fields.get("command")
        result = self._obey(command, fields.get("param1"))
        answer: dict[str, Any] = {
            "command": command,
            "result": result,
            "progress": 0,
            "result_param2": 0,
            "target_system": message.system_id,
            "target_component": message.component_id,
        }
        # A ground station that is gone when the answer leaves has its order all the same.
        with contextlib.suppress(LinkError):
            link.send("COMMAND_ACK", answer)

    def _obey(self, command: object, parameter: object) -> int:
        if command == MISSION_START:
            if not self._by_command:
                return _DENIED
            self.start.set()
            return _ACCEPTED
        if command == PAUSE_CONTINUE:
            pause = isinstance(parameter, int | float) and math.isfinite(parameter) and parameter == 0.0
            if not pause:
                return _DENIED
            self.stop.set()
            return _ACCEPTED
        return _UNSUPPORTED
