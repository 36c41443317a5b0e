"""The link over MAVSDK 4: one connection, messages as they come, sent as they are asked.

MAVSDK's `mavlink_direct` is used through its callbacks, not its asyncio queues: those have no bound, and after a hang
of our event loop they hand out old data as if it had just come. Here each message is stamped in MAVSDK's own thread
when it arrives, and only the newest is kept. What this cannot see is a thread that holds the interpreter for long:
messages then wait in MAVSDK and are stamped late. That is why poses are stamped by the autopilot's own clock.

MAVSDK opens no socket: those that it opens are bound to every address of the computer, and it believes every sender.
Its connection is ``raw://``, which hands its bytes to a `Transport` of ours and takes ours.

MAVSDK sends a heartbeat of its own (onboard computer, state UNINIT) as soon as it has seen a vehicle. It is not passed
on: ground stations would see this component change its state twice a second. The true one is the status reporter's.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import json
import logging
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import mavsdk.logging
from mavsdk.cmavsdk_loader import _cmavsdk_lib
from mavsdk.connection_result import ConnectionResult
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkDirectServerError, MavlinkMessage
from mavsdk.plugins.param import Param

from companion.autopilot.commands import Commands
from companion.autopilot.discovery import Neighbours, kind_of
from companion.autopilot.inbox import Inbox
from companion.autopilot.interface import Handler, LinkError, Message, Stream, Transport
from companion.autopilot.parameters import Parameters
from companion.autopilot.px4_events import Px4Events
from companion.clock import Clock
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.codec import NAMES, Framer, decode
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavComponent, MavState
from companion.text_table import printable

POLL_S = 0.05

T = TypeVar("T")
_MAKING = threading.Lock()
"""Two threads that make an instance of MAVSDK at the same time end the process with a segmentation fault."""
_logger = logging.getLogger(__name__)


@functools.cache
def _log_mavsdk() -> object:
    """What MAVSDK would print goes to our log, quietly: an error that matters is raised by us, in words of our own.

    It logs the STATUSTEXTs of everybody. Its own `log_subscribe` prints when one is no UTF-8, and has it printed.

    Returns:
        What the library calls; it has to be kept.
    """
    levels = {mavsdk.logging.LogLevel.WARN: logging.DEBUG, mavsdk.logging.LogLevel.ERROR: logging.INFO}

    def forward(level: int, text: bytes | None, _file: bytes | None, _line: int, _user_data: object) -> bool:
        _logger.log(levels.get(level, logging.DEBUG), "MAVSDK: %s", printable((text or b"").decode(errors="replace")))
        return True

    callback = mavsdk.logging.LogCallback(forward)
    _cmavsdk_lib.mavsdk_log_subscribe(callback, None)
    return callback


class MavsdkLink:
    """A connection to the autopilot of one vehicle; implements `companion.autopilot.interface.Link`.

    An async context manager: entering waits for the heartbeat of our autopilot, leaving ends every thread.

    Args:
        settings: which system id the autopilot has, others are ignored; where it is, for errors to name.
        clock: stamps arrivals.
        transport: carries the bytes.

    Attributes:
        malformed: messages that could not be read.

    Raises:
        LinkError: on entering, when our autopilot is not there: says what was seen instead.
    """

    def __init__(self, settings: AutopilotSettings, clock: Clock, transport: Transport) -> None:
        self._settings = settings
        self._transport = transport
        self._clock = clock
        self._kind: AutopilotKind | None = None
        self._neighbours = Neighbours(settings)
        self._subscribed: set[str] = set()
        self._executor: ThreadPoolExecutor | None = None
        self._mavsdk: Mavsdk | None = None
        self._direct: MavlinkDirectServer | None = None
        self._parameters: Parameters | None = None
        self._px4_events: Px4Events | None = None
        self.malformed = 0

    async def __aenter__(self) -> MavsdkLink:
        self._loop = asyncio.get_running_loop()
        self._inbox = Inbox(self._settings.system_id, self._call_soon)
        self._commands = Commands(self.send, self._settings.system_id)
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="mavsdk")
        try:
            await self._in_thread(self._open)
            self.events("HEARTBEAT", self._neighbours.note, anyone=True)
            self.events("COMMAND_ACK", self._commands.acknowledged, anyone=True)
            await self._connect()
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._close()

    @property
    def kind(self) -> AutopilotKind:
        """Which firmware answered."""
        if self._kind is None:
            raise LinkError("the link is not connected yet")
        return self._kind

    @property
    def system_id(self) -> int:
        """Of the vehicle, and so of this application too."""
        return self._settings.system_id

    @property
    def arming_problems(self) -> tuple[str, ...]:
        """See `Link.arming_problems`."""
        return () if self._px4_events is None else self._px4_events.problems

    @property
    def dropped(self) -> int:
        """Messages that came faster than their handlers took them."""
        return self._inbox.dropped

    def watch(self, name: str) -> Stream:
        """See `Link.watch`."""
        stream = self._inbox.watch(name)
        self._subscribe(name)
        return stream

    def events(self, name: str, handler: Handler, anyone: bool = False) -> None:
        """See `Link.events`."""
        self._inbox.events(name, handler, anyone)
        self._subscribe(name)

    def send(self, name: str, fields: Mapping[str, Any]) -> None:
        """See `Link.send`. Takes about 0.1 ms."""
        if self._direct is None:
            raise LinkError(f"{name} cannot be sent: the link is closed")
        try:
            text = json.dumps({key: _to_wire(value) for key, value in fields.items()}, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise LinkError(f"{name} cannot be sent: {error} in {dict(fields)}") from error
        try:
            self._direct.send_message(MavlinkMessage(name, 0, 0, 0, 0, text))
        except MavlinkDirectServerError as error:
            raise LinkError(f"{name} cannot be sent: {error.result.name.lower()} in {text}") from error

    async def command(self, command: int, *params: float, timeout_s: float | None = None) -> int:
        """See `Link.command`; waits as long as the settings say unless told otherwise."""
        return await self._commands.ask(command, params, timeout_s or self._settings.command_timeout_s)

    async def get_param(self, name: str) -> float | int | None:
        """See `Link.get_param`."""
        return await self._known_parameters().get(name)

    async def set_param(self, name: str, value: float | int) -> None:
        """See `Link.set_param`."""
        await self._known_parameters().set(name, value)

    def _known_parameters(self) -> Parameters:
        if self._parameters is None:
            raise LinkError("parameters cannot be asked for: the link is closed")
        return self._parameters

    async def _in_thread(self, call: Callable[[], T]) -> T:
        """MAVSDK's calls block. One thread, so that closing waits for the call before it."""
        if self._executor is None:
            raise LinkError("the link is closed")
        return await self._loop.run_in_executor(self._executor, call)

    def _open(self) -> None:
        with _MAKING:
            _log_mavsdk()
            configuration = Configuration.create_manual(self._settings.system_id, MavComponent.ONBOARD_COMPUTER, False)
            self._mavsdk = Mavsdk(configuration)
            configuration.destroy()
        # The server plugin hears every system and needs none to be discovered before it can send.
        self._direct = MavlinkDirectServer(self._mavsdk.server_component_by_id(MavComponent.ONBOARD_COMPUTER))
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._pass_on)
        opened = self._mavsdk.add_any_connection("raw://")
        if opened is not ConnectionResult.SUCCESS:
            raise LinkError(f"MAVSDK opens no raw connection: {opened.name.lower()}")

    async def _connect(self) -> None:
        deadline_s = self._loop.time() + self._settings.connect_timeout_s
        heartbeats = self.watch("HEARTBEAT")
        if self._mavsdk is None:
            raise LinkError("the link is closed")
        self._transport.open(self._mavsdk.pass_received_raw_bytes)
        while not await self._found(heartbeats):
            if self._loop.time() >= deadline_s:
                raise LinkError(self._neighbours.instead_of_ours())
            await asyncio.sleep(POLL_S)

    async def _found(self, heartbeats: Stream) -> bool:
        if heartbeats.newest is None:
            return False
        kind = kind_of(heartbeats.newest)
        if kind is None or not await self._in_thread(lambda: self._find_plugins(heartbeats, kind)):
            return False
        self._kind = kind
        if self._px4_events is not None:
            self._subscribe("EVENT")
        return True

    def _find_plugins(self, heartbeats: Stream, kind: AutopilotKind) -> bool:
        """MAVSDK's plugins need the system as MAVSDK has discovered it, a moment after its heartbeat."""
        if self._mavsdk is None:
            return False
        for system in self._mavsdk.get_systems():
            if system.get_system_id() == self._settings.system_id and system.has_autopilot():
                self._parameters = Parameters(Param(system), self._in_thread, heartbeats)
                if kind is AutopilotKind.PX4:
                    self._px4_events = Px4Events(system, self._inbox.put, self._clock)
                return True
        return False

    def _subscribe(self, name: str) -> None:
        if self._direct is None:
            raise LinkError(f"{name} cannot be heard: the link is closed")
        if name not in self._subscribed:
            self._subscribed.add(name)
            self._direct.subscribe_message(name, self._received)

    def _received(self, raw: MavlinkMessage, _user_data: object) -> None:
        """Called in MAVSDK's thread. Must not raise: MAVSDK would print."""
        received_s = self._clock.now_s()
        if not self._inbox.wants(raw.message_name, raw.system_id, raw.component_id):
            return
        try:
            fields = {key: _from_wire(value) for key, value in json.loads(raw.fields_json).items()}
        except (ValueError, AttributeError, RecursionError):
            self.malformed += 1
            return
        if raw.message_name == "EVENT" and self._px4_events is not None:
            self._px4_events.on_raw(fields)
        self._inbox.put(Message(raw.message_name, fields, received_s, raw.system_id, raw.component_id))

    def _pass_on(self, raw: bytes) -> None:
        """Called in MAVSDK's threads with what it wants to send."""
        if not _is_mavsdks_own_heartbeat(raw):
            self._transport.send(raw)

    def _call_soon(self, call: Callable[[], None]) -> None:
        # When the loop has been closed under us, nobody is left to tell.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call)

    async def _close(self) -> None:
        """Ends MAVSDK's threads and ours, also when cancelled; waits at most for the call that is running, 3 s."""
        executor, self._executor = self._executor, None
        if executor is None:
            return
        self._transport.close()
        closing = self._loop.run_in_executor(executor, self._destroy)
        try:
            await asyncio.shield(closing)
        finally:
            executor.shutdown(wait=True)

    def _destroy(self) -> None:
        mavsdk_instance, self._mavsdk = self._mavsdk, None
        self._direct = None
        self._parameters = None
        self._px4_events = None
        if mavsdk_instance is not None:
            mavsdk_instance.destroy()


def _is_mavsdks_own_heartbeat(raw: bytes) -> bool:
    """A HEARTBEAT whose ``system_status`` is UNINIT, which ours never says; MAVSDK speaks MAVLink 2."""
    (frame, *_) = (*Framer(datagram=True).frames(raw), None)
    if frame is None or NAMES.get(frame.message_id) != "HEARTBEAT":
        return False
    fields = decode(frame)
    return fields is not None and fields["system_status"] == MavState.UNINIT


def _to_wire(value: Any) -> Any:
    """NaN as JSON has it; MAVSDK reads null as NaN."""
    if isinstance(value, float) and math.isnan(value):
        return None
    if isinstance(value, (list, tuple)):
        return [_to_wire(item) for item in value]
    return value


def _from_wire(value: Any) -> Any:
    if value is None:
        return math.nan
    if isinstance(value, list):
        return [_from_wire(item) for item in value]
    return value
