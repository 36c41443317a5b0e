"""Commands and their acknowledgements: COMMAND_LONG, sent again until answered."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from companion.autopilot.interface import LinkError, Message
from companion.mavlink.ids import MavCmd, MavComponent, MavResult

RESEND_S = 0.5
LAST_WORD_S = 0.1
"""PX4 acknowledges a change of mode twice: its receiver at once, 4 to 12 ms later the commander, whose word it is."""
TWICE_ANSWERED = frozenset({MavCmd.DO_SET_MODE})
LONGEST_S = 60.0
"""A command that stays in progress for longer than this is given up."""
ANSWERING = (MavComponent.AUTOPILOT1, MavComponent.ONBOARD_COMPUTER2)


class Commands:
    """Asks one autopilot for commands.

    Commands of the same number wait for each other, since an acknowledgement names nothing but the number; different
    ones do not.

    Args:
        send: sends one message.
        system_id: of the vehicle.
    """

    def __init__(self, send: Callable[[str, Mapping[str, Any]], None], system_id: int) -> None:
        self._send = send
        self._system_id = system_id
        self._waiting: dict[int, asyncio.Queue[int]] = {}
        self._turns: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)

    def acknowledged(self, message: Message) -> None:
        """A COMMAND_ACK came in: the autopilot's, or that of the gate, which refused it; others are ignored."""
        if (message.system_id, message.component_id) not in {(self._system_id, who) for who in ANSWERING}:
            return
        system_id, component_id = message.fields.get("target_system", 0), message.fields.get("target_component", 0)
        if system_id not in (0, self._system_id) or component_id not in (0, MavComponent.ONBOARD_COMPUTER):
            return
        command, result = message.fields.get("command"), message.fields.get("result")
        if not isinstance(command, int) or not isinstance(result, int):
            return
        answers = self._waiting.get(command)
        if answers is not None and not answers.full():
            answers.put_nowait(result)

    async def ask(self, command: int, params: tuple[float, ...], timeout_s: float) -> int:
        """The MAV_RESULT of a command; "in progress" is waited for, ``timeout_s`` after each time it is heard.

        Raises:
            LinkError: no answer.
        """
        async with self._turns[command]:
            answers: asyncio.Queue[int] = asyncio.Queue(maxsize=8)
            self._waiting[command] = answers
            try:
                return await self._ask(command, params, timeout_s, answers)
            finally:
                del self._waiting[command]

    async def _ask(self, command: int, params: tuple[float, ...], timeout_s: float, answers: asyncio.Queue[int]) -> int:
        fields = command_long(self._system_id, command, params)
        loop = asyncio.get_running_loop()
        begun_s = loop.time()
        deadline_s = begun_s + timeout_s
        confirmation, heard = 0, False
        next_send_s = begun_s
        while (now_s := loop.time()) < deadline_s:
            if not heard and now_s >= next_send_s:
                self._send("COMMAND_LONG", fields | {"confirmation": min(confirmation, 255)})
                confirmation += 1
                next_send_s = now_s + RESEND_S
            wait_s = (deadline_s if heard else min(deadline_s, next_send_s)) - now_s
            try:
                result = await asyncio.wait_for(answers.get(), max(wait_s, 0.001))
            except TimeoutError:
                continue
            if result != MavResult.IN_PROGRESS:
                return await _last_of(answers, result) if command in TWICE_ANSWERED else result
            heard = True
            deadline_s = min(loop.time() + timeout_s, begun_s + LONGEST_S)
        said = "it said 'in progress' and nothing more" if heard else f"asked {confirmation} times"
        raise LinkError(
            f"the autopilot (system {self._system_id}) did not answer command {command} within {timeout_s:g} s "
            f"({said}); look at the link: is it still sending heartbeats?"
        )


async def _last_of(answers: asyncio.Queue[int], result: int) -> int:
    """The last answer: an acceptance may be followed by the refusal of whoever has to carry it out."""
    try:
        async with asyncio.timeout(LAST_WORD_S):
            while result == MavResult.ACCEPTED:
                result = await answers.get()
    except TimeoutError:
        pass
    return result


def command_long(system_id: int, command: int, params: Iterable[float]) -> dict[str, Any]:
    """The fields of a COMMAND_LONG to the autopilot of a vehicle; the parameters that are left out are zero."""
    fields: dict[str, Any] = {"target_system": system_id, "target_component": MavComponent.AUTOPILOT1}
    return fields | {"command": command} | {f"param{number}": value for number, value in enumerate(params, 1)}
