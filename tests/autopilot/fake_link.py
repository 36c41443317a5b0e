"""A link without an autopilot: tests deliver what it would have said and see what was sent to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from companion.autopilot.inbox import Inbox
from companion.autopilot.interface import Handler, LinkError, Message, Stream
from companion.clock import Clock
from companion.mavlink.firmware import AutopilotKind

ACCEPTED = 0


class FakeLink:
    """Implements `companion.autopilot.interface.Link` in memory. Handlers are called inside `deliver`, at once.

    Attributes:
        sent: every message sent, in order, as (name, fields).
        commands: every command asked, in order, as (MAV_CMD, params as they were given).
        results: what to answer: MAV_CMD -> MAV_RESULT, or a list that is used up in order (the last one stays), or None
            for silence (LinkError). A command that is not named is accepted.
        params: the autopilot's parameters; a name that is missing does not exist.
        frozen_params: names that refuse to be set (the old value is read back: LinkError).
        silent_params: names for which no answer comes (LinkError).
        on_command: called after a command was recorded, before it is answered: deliver what the autopilot would say.
        on_send: called with every message sent.
        gone: when True, `send` raises LinkError and commands stay unanswered.
    """

    def __init__(self, clock: Clock, kind: AutopilotKind = AutopilotKind.PX4, system_id: int = 1) -> None:
        self.kind = kind
        self.system_id = system_id
        self.arming_problems: tuple[str, ...] = ()
        self._clock = clock
        self._inbox = Inbox(system_id, lambda call: call())
        self.sent: list[tuple[str, dict[str, Any]]] = []
        self.commands: list[tuple[int, tuple[float, ...]]] = []
        self.results: dict[int, int | list[int] | None] = {}
        self.params: dict[str, float | int] = {}
        self.frozen_params: set[str] = set()
        self.silent_params: set[str] = set()
        self.on_command: Callable[[int, tuple[float, ...]], None] | None = None
        self.on_send: Callable[[str, dict[str, Any]], None] | None = None
        self.gone = False

    def deliver(self, name: str, fields: Mapping[str, Any], system_id: int = 1, component_id: int = 1) -> None:
        """A message arrives now, from the autopilot unless another sender is named."""
        self._inbox.put(Message(name, dict(fields), self._clock.now_s(), system_id, component_id))

    def sent_named(self, name: str) -> list[dict[str, Any]]:
        """The fields of every message of this name that was sent, in order."""
        return [fields for sent, fields in self.sent if sent == name]

    def watch(self, name: str) -> Stream:
        return self._inbox.watch(name)

    def events(self, name: str, handler: Handler, anyone: bool = False) -> None:
        self._inbox.events(name, handler, anyone)

    def send(self, name: str, fields: Mapping[str, Any]) -> None:
        if self.gone:
            raise LinkError("the link is gone")
        self.sent.append((name, dict(fields)))
        if self.on_send is not None:
            self.on_send(name, dict(fields))

    async def command(self, command: int, *params: float, timeout_s: float = 2.0) -> int:
        """Record the command and give the scripted answer."""
        self.commands.append((command, params))
        result = self.results.get(command, ACCEPTED)
        if self.on_command is not None:
            self.on_command(command, params)
        if isinstance(result, list):
            result = result.pop(0) if len(result) > 1 else result[0]
        if result is None or self.gone:
            raise LinkError(f"no answer to command {command} within {timeout_s} s")
        return result

    async def get_param(self, name: str) -> float | int | None:
        if self.gone or name in self.silent_params:
            raise LinkError(f"no answer to a question for parameter {name}")
        return self.params.get(name)

    async def set_param(self, name: str, value: float | int) -> None:
        """Change the scripted value, unless it does not exist or is frozen."""
        found = await self.get_param(name)
        if found is None:
            raise LinkError(f"the autopilot has no parameter {name}")
        if name in self.frozen_params:
            raise LinkError(f"parameter {name} was set to {value} but {found} was read back")
        self.params[name] = type(found)(value)
