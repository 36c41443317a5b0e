"""Telemetry is believed when it is that of the vehicle, and of now. Pure.

Else whoever has any certificate of the fleet could tell where a vehicle is, or play back where it was. A session of a
vehicle's link counts from when it quotes this ground's own, which is drawn anew each time and which the vehicle has
heard in what it was asked.
"""

from __future__ import annotations

from companion.control.fleet import MOST_VEHICLES
from companion.link.envelope import read_envelope
from companion.link.sealing import Proofs, Sessions
from companion.link.wire import RefusedError, Report, WireError, decoded

MOST_SESSIONS = 1_000
"""Of one vehicle: none is ever forgotten, or it could be played back."""


class TelemetryGuard:
    """Opens what vehicles tell the ground.

    Args:
        own: what this ground calls itself when it asks, and what is to be quoted.
        proofs: tell whose it is.
    """

    def __init__(self, own: str, proofs: Proofs) -> None:
        self._own = own
        self._proofs = proofs
        self._sessions: dict[str, Sessions] = {}

    def opened(self, sender: str, data: bytes) -> tuple[Report, bool] | None:
        """What a vehicle told, and whether it has shown that it is of now; None while it has not shown whose it is.

        Args:
            sender: whose topic it came on.
            data: what came.

        Raises:
            RefusedError: it is not to be believed.
        """
        try:
            envelope = read_envelope(data)
            who = self._proofs.whose(sender, envelope)
            if who is None:
                return None
            report = decoded(Report, envelope.message)
        except WireError as error:
            raise RefusedError(str(error)) from None
        if report.telemetry.vehicle != who.name or report.session != envelope.session:
            raise RefusedError(f"telemetry of {report.telemetry.vehicle[:32]!r} came as that of {who.name}")
        if who.name not in self._sessions and len(self._sessions) >= MOST_VEHICLES:
            raise RefusedError(f"{who.name} is one vehicle too many")
        sessions = self._sessions.setdefault(who.name, Sessions(MOST_SESSIONS, forgets=False))
        return report, sessions.take(who.name, envelope, is_of_now=self._own in envelope.heard)
