"""A link to an autopilot that is not there."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from companion.autopilot.interface import Message


class FakeLink:
    """Hands messages to whoever subscribed, and remembers what was asked for."""

    system_id = 1

    def __init__(self) -> None:
        self.handlers: list[tuple[str, Callable[[Message], None]]] = []
        self.commands: list[tuple[float, ...]] = []
        self.asked = asyncio.Semaphore(0)
        self.fails: Exception | None = None

    def events(self, name: str, handler: Callable[[Message], None], anyone: bool = False) -> None:
        assert anyone, "rangefinders may be components of their own"
        self.handlers.append((name, handler))

    async def command(self, command: int, *params: float, timeout_s: float = 2.0) -> int:
        assert timeout_s > 0.0
        self.commands.append((command, *params))
        self.asked.release()
        if self.fails is not None:
            raise self.fails
        return 0

    def arrives(
        self, name: str, fields: dict[str, Any], received_s: float, system_id: int = 1, component_id: int = 1
    ) -> None:
        for wanted, handler in self.handlers:
            if wanted == name:
                handler(Message(name, fields, received_s, system_id, component_id))
