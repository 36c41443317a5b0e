"""The ground's end of the link: every vehicle that is heard, as `companion.ground` wants them."""

from __future__ import annotations

import logging
import secrets
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Self

import zenoh

from companion.config.link import ENDPOINT_FORMS, is_encrypted, is_endpoint, is_loopback, is_name
from companion.errors import InputError
from companion.link.certificates import Certificates
from companion.link.ground.asking import Asker
from companion.link.ground.signing import Signer
from companion.link.ground.telemetry_guard import TelemetryGuard
from companion.link.ground.vehicle import LinkedVehicle
from companion.link.sealing import Proofs
from companion.link.session import close_session, open_session
from companion.link.wire import RefusedError, telemetry_topic, vehicle_of

MOST_VEHICLES = 32

_log = logging.getLogger(__name__)


class LinkStation:
    """A `Station` over the link; a context manager.

    Args:
        folder: in it each vehicle gets a folder, and in that each of its maps one with a journal. What is there already
            is gone on from.
        listen: endpoints at which vehicles are waited for.
        connect: endpoints of vehicles; tried again for ever.
        name: of the operator, where no certificate says it.
        certificates: folder with the operator's, as `companion keys operator` makes it; None: on loopback only.

    Raises:
        InputError: an endpoint can be reached by anybody, and nothing would prove who is there; or the certificates
            cannot be used.
        LinkError: an endpoint cannot be listened at.
    """

    def __init__(
        self,
        folder: Path,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        name: str = "operator",
        certificates: Path | None = None,
    ) -> None:
        for endpoint in (*listen, *connect):
            _check(endpoint, certificates)
        given = None if certificates is None else Certificates(certificates)
        self._folder = folder
        self._signer = Signer(name, given)
        self._by = secrets.token_hex(8)
        self._proofs = Proofs(given)
        self._guard = TelemetryGuard(self._by, self._proofs)
        self.refused = 0
        """Telemetry and answers that were not to be believed."""
        self._logged: set[str] = set()
        self._lock = threading.Lock()
        """Over the two before it, and what follows."""
        self._vehicles: dict[str, LinkedVehicle] = {}
        self._session = open_session(listen, connect, given)
        for path in sorted(folder.iterdir()) if folder.is_dir() else ():
            if path.is_dir() and is_name(path.name):
                self._vehicle(path.name)
        self._subscriber = self._session.declare_subscriber(telemetry_topic("*"), self._on_telemetry)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the link; every copy is kept."""
        with self._lock:
            vehicles = list(self._vehicles.values())
        for vehicle in vehicles:
            vehicle.close()
        close_session(self._session)

    def vehicles(self) -> Sequence[LinkedVehicle]:
        """Every vehicle that was ever heard of, in the order of their names."""
        with self._lock:
            return [self._vehicles[name] for name in sorted(self._vehicles)]

    def _vehicle(self, name: str) -> LinkedVehicle | None:
        with self._lock:
            if name not in self._vehicles and len(self._vehicles) < MOST_VEHICLES:
                asker = Asker(name, self._session, self._proofs, partial(self._refuse, name, "an answer"))
                self._vehicles[name] = LinkedVehicle(name, self._folder / name, asker, self._by, self._signer)
            return self._vehicles.get(name)

    def _on_telemetry(self, sample: zenoh.Sample) -> None:
        """In a thread of Zenoh's."""
        name = vehicle_of(str(sample.key_expr))
        try:
            opened = self._guard.opened(name, sample.payload.to_bytes())
        except RefusedError as refusal:
            self._refuse(name, "telemetry", str(refusal))
            return
        vehicle = None if opened is None else self._vehicle(name)
        if opened is None or vehicle is None:
            return
        report, is_of_now = opened
        if is_of_now:
            vehicle.heard(report)
        else:
            vehicle.greet()

    def _refuse(self, name: str, what: str, why: str) -> None:
        with self._lock:
            self.refused += 1
            is_first = what not in self._logged
            self._logged.add(what)
            known = self._vehicles.get(name)
        if is_first:
            _log.warning("%s in the name of %r was refused: %s; further ones are only counted", what, name[:32], why)
        # A name that only refused ones have told of is nobody's.
        if known is not None:
            known.refused(why)


def _check(endpoint: str, certificates: Path | None) -> None:
    if not is_endpoint(endpoint):
        raise InputError(f"{endpoint}: is no endpoint: {ENDPOINT_FORMS}")
    if is_encrypted(endpoint) and certificates is None:
        raise InputError(f"{endpoint}: needs certificates: make them with `companion keys operator`")
    if not is_encrypted(endpoint) and not is_loopback(endpoint):
        raise InputError(f"{endpoint}: without tls/ or quic/ only loopback (127.0.0.1) is possible")
