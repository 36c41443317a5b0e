"""The autopilot's parameters, in both encodings.

PX4 puts the bytes of an integer where the float would be, ArduPilot the number itself as a float. MAVSDK's own client
knows both; over `mavlink_direct` the bytes of a negative integer look like NaN and are lost. Its calls block, and its
setter sends a value in the wrong encoding before it notices: so the type is always read first.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable

from mavsdk.plugins.param import Param, ParamError, ParamResult

from companion.autopilot.interface import LinkError, Stream

LONGEST_NAME = 16
INT32 = 2**31
SAME = 1e-6
"""Relative difference that 32-bit floats may show (their own is 6e-8)."""

_UNKNOWN = frozenset({ParamResult.DOES_NOT_EXIST, ParamResult.PARAM_NAME_TOO_LONG})


class Parameters:
    """Reads and sets parameters.

    Args:
        client: MAVSDK's client for the vehicle.
        in_thread: runs a blocking call in the link's own thread, one after the other.
        heartbeats: of the autopilot: silence about a name, while it lives, means that it has no such parameter.
    """

    def __init__(
        self,
        client: Param,
        in_thread: Callable[[Callable[[], int | float | None]], Awaitable[int | float | None]],
        heartbeats: Stream,
    ) -> None:
        self._client = client
        self._in_thread = in_thread
        self._heartbeats = heartbeats

    async def get(self, name: str) -> float | int | None:
        """See `Link.get_param`. A name that does not exist takes 3 s, unless the autopilot says so."""
        if not 0 < len(name) <= LONGEST_NAME:
            return None
        return await self._in_thread(lambda: self._get(name))

    def _get(self, name: str) -> float | int | None:
        heard = self._heartbeats.count
        result = ParamResult.WRONG_TYPE
        for ask in (self._client.get_param_int, self._client.get_param_float):
            try:
                value: int | float = ask(name)
            except ParamError as error:
                result = error.result
                if result is not ParamResult.WRONG_TYPE:
                    break
            else:
                return value
        if result in _UNKNOWN or (result is ParamResult.TIMEOUT and self._heartbeats.count > heard):
            return None
        raise LinkError(f"the autopilot did not answer a question for parameter {name} ({_words(result)})")

    async def set(self, name: str, value: float | int) -> None:
        """See `Link.set_param`."""
        if not math.isfinite(value):
            raise LinkError(f"parameter {name} cannot be set to {value}: not a finite number")
        found = await self.get(name)
        if found is None:
            raise LinkError(f"the autopilot has no parameter {name}: is this another firmware version?")
        if isinstance(found, int) and (value != int(value) or not -INT32 <= value < INT32):
            raise LinkError(f"parameter {name} is a 32-bit integer (now {found}): it cannot be set to {value}")
        await self._in_thread(lambda: self._set(name, value, isinstance(found, int)))
        now = await self.get(name)
        if now is None or not math.isclose(now, value, rel_tol=SAME, abs_tol=1e-9):
            raise LinkError(f"parameter {name} was set to {value}, but {now} was read back")

    def _set(self, name: str, value: float | int, integer: bool) -> None:
        try:
            if integer:
                self._client.set_param_int(name, int(value))
            else:
                self._client.set_param_float(name, float(value))
        except ParamError as error:
            raise LinkError(f"parameter {name} could not be set to {value} ({_words(error.result)})") from error


def _words(result: ParamResult) -> str:
    return str(result.name).lower().replace("_", " ")
