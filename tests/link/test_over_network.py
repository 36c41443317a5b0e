"""Vehicle and ground over Zenoh: on loopback, over a network that fails, and with certificates."""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.errors import InputError
from companion.link.answering import opened_answer
from companion.link.authority import Authority
from companion.link.certificates import REVOKED, Certificates
from companion.link.envelope import read_envelope
from companion.link.sealing import Proofs, Seal
from companion.link.session import LinkError, close_session, open_session
from companion.link.vehicle.process import ANSWER_TIMEOUT_S
from companion.link.wire import Order, Report, SignedOrder, command_topic, decoded, encoded, telemetry_topic
from companion.link.words import Answer, Command
from sitl.launch.processes import free_tcp_port, free_udp_ports
from tests.link.exchange import MAP, Mine
from tests.link.rig import BadNetwork, RiggedVehicle, answer_to, known, rigged, station, until
from tests.mapping.journal.journals import held

CUT_S = 5.0
"""Longer than a connection takes to be made anew."""


def test_telemetry_map_way_and_commands_go_over(tmp_path: Path, mine: Mine) -> None:
    with rigged(mine) as vehicle, station(tmp_path / "ground", vehicle.endpoint) as ground:
        seen = known(ground)
        until(lambda: seen.has_whole_map)
        assert held(seen.source()) == held(mine.journal)
        before = seen.changed(0)
        mine.grow(3)
        until(lambda: held(seen.source()) == held(mine.journal))
        assert 0 < len(seen.changed(before.revision).chunks) <= 3
        assert seen.telemetry is not None
        assert seen.age_s < 1.0
        assert answer_to(seen, Command.STOP) == Answer(accepted=True)
        assert vehicle.obeyed == [(Command.STOP, "anna")]
        until(lambda: len(seen.way_m()) > 2)


def test_both_sides_begin_anew_and_the_copy_goes_on(tmp_path: Path, mine: Mine) -> None:
    with rigged(mine) as vehicle:
        with station(tmp_path / "ground", vehicle.endpoint) as ground:
            until(lambda: known(ground).has_whole_map)
        mine.grow()
        with station(tmp_path / "ground", vehicle.endpoint) as ground:
            (seen,) = ground.vehicles()
            assert seen.name == "drone1"
            until(lambda: len(seen.changed(0).chunks) > 0)
            until(lambda: held(known(ground).source()) == held(mine.journal))
            before = seen._report
            assert before is not None
            vehicle.stop()
            mine.grow()
            vehicle.start()
            until(lambda: held(seen.source()) == held(mine.journal))
            until(lambda: seen._report is not None and seen._report.session != before.session)
            assert answer_to(seen, Command.PAUSE) == Answer(accepted=True)
    assert (tmp_path / "ground" / "drone1" / MAP / "map.journal").is_dir()


def raw(vehicle: RiggedVehicle, order: Order, certificates: Certificates | None = None, text: str = "") -> Answer:
    """The answer to an order that is sent as it is."""
    signed = SignedOrder(text or encoded(order).decode())
    if certificates is not None:
        signed = replace(signed, certificate=certificates.certificate, signature=certificates.sign(signed.order))
    session = open_session([], [vehicle.endpoint], certificates)
    try:
        until(lambda: session.info.peers_zid())
        replies: list[bytes] = []
        give_up_s = time.monotonic() + 5.0
        while not replies and time.monotonic() < give_up_s:
            replies += _replies(session, encoded(signed))
        opened = opened_answer(Proofs(None), "drone1", encoded(signed), replies[0])
        assert opened is not None
        return decoded(Answer, opened)
    finally:
        close_session(session)


def _replies(session: object, message: bytes) -> list[bytes]:
    replies = session.get(command_topic("drone1"), payload=message, timeout=3.0)  # type: ignore[attr-defined]
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]


def test_orders_for_another_old_and_replayed_ones_are_refused(tmp_path: Path, mine: Mine) -> None:
    with rigged(mine) as vehicle, station(tmp_path / "ground", vehicle.endpoint) as ground:
        seen = known(ground)
        report = seen._report
        assert report is not None
        good = Order(secrets.token_hex(16), 1, "drone1", report.session, report.clock_s, Command.LAND, "anna")
        assert raw(vehicle, good).accepted
        assert vehicle.obeyed == [(Command.LAND, "anna")]
        fresh = replace(good, id=secrets.token_hex(16))
        for wrong, why in (
            (good, "replay"),
            (replace(fresh, vehicle="drone2"), "for the vehicle"),
            (replace(fresh, clock_s=report.clock_s - 20.0), "ago"),
            (replace(fresh, session="0" * 16), "began anew"),
        ):
            answer = raw(vehicle, wrong)
            assert not answer.accepted
            assert why in answer.reason
        assert not raw(vehicle, good, text="stop!").accepted
        until(lambda: len(vehicle.refused) == 5)
        assert vehicle.obeyed == [(Command.LAND, "anna")], "nothing reached the application"


def test_an_application_that_hangs_is_told_of(tmp_path: Path, mine: Mine) -> None:
    with rigged(mine) as vehicle, station(tmp_path / "ground", vehicle.endpoint) as ground:
        seen = known(ground)
        vehicle.obeys = False
        answer = answer_to(seen, Command.STOP)
        assert answer is not None
        assert f"did not answer in {ANSWER_TIMEOUT_S:g} s" in answer.reason


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.make(tmp_path / "authority")
    made.issue("drone1", "vehicle", tmp_path / "drone1")
    made.issue("anna", "command", tmp_path / "anna")
    made.issue("bob", "watch", tmp_path / "bob")
    return made


@pytest.mark.timeout(300)
@pytest.mark.parametrize("outage_s", [0.4, pytest.param(60.0, marks=pytest.mark.long)])
def test_a_third_lost_and_outages_leave_the_maps_equal(
    outage_s: float, tmp_path: Path, mine: Mine, authority: Authority
) -> None:
    """Three of ten packets are lost, both ways, and twice nothing comes through."""
    (port,) = free_udp_ports(1)
    with (
        rigged(mine, listen=[f"quic/127.0.0.1:{port}"], certificates=str(tmp_path / "drone1")),
        BadNetwork(port, 0.3) as network,
        station(tmp_path / "ground", f"quic/127.0.0.1:{network.port}", certificates=tmp_path / "anna") as ground,
    ):
        seen = known(ground)
        for step in range(30):
            mine.grow()
            network.silent = step in (10, 20)
            time.sleep(outage_s if network.silent else 0.1)
        network.silent = False
        until(lambda: seen.has_whole_map and held(seen.source()) == held(mine.journal), 60.0)
        assert network.lost > 0.2 * network.passed
        assert answer_to(seen, Command.STOP) == Answer(accepted=True)
    assert authority.issued()


def test_with_certificates_who_may_command_commands_and_who_may_watch_watches(
    tmp_path: Path, mine: Mine, authority: Authority
) -> None:
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    with rigged(mine, listen=[endpoint], certificates=str(tmp_path / "drone1")) as vehicle:
        with station(tmp_path / "ground", endpoint, certificates=tmp_path / "anna") as ground:
            assert answer_to(known(ground), Command.STOP) == Answer(accepted=True)
        assert vehicle.obeyed == [(Command.STOP, "anna")]
        with station(tmp_path / "ground2", endpoint, certificates=tmp_path / "bob") as ground:
            seen = known(ground)
            until(lambda: seen.has_whole_map)
            answer = answer_to(seen, Command.STOP)
            assert answer is not None
            assert "bob may watch, not command" in answer.reason
            report = seen._report
            assert report is not None
        order = Order(secrets.token_hex(16), 1, "drone1", report.session, report.clock_s, Command.LAND, "anna")
        answer = raw(vehicle, order, Certificates(tmp_path / "bob"))
        assert not answer.accepted, "bob cannot sign for anna"
        authority.revoke("anna")
        (tmp_path / "drone1" / REVOKED).write_bytes((tmp_path / "authority" / REVOKED).read_bytes())
        answer = raw(vehicle, replace(order, id=secrets.token_hex(16)), Certificates(tmp_path / "anna"))
        assert "revoked" in answer.reason
        assert vehicle.obeyed == [(Command.STOP, "anna")]
        vehicle.stop()
        vehicle.start()
        with station(tmp_path / "ground3", endpoint, certificates=tmp_path / "anna") as ground:
            with station(tmp_path / "ground4", endpoint, certificates=tmp_path / "bob") as other:
                known(other)
            assert not ground.vehicles(), "who is revoked hears nothing when the link has begun anew"


def test_who_is_revoked_in_flight_is_cut_off_and_the_others_are_not(
    tmp_path: Path, mine: Mine, authority: Authority
) -> None:
    """Protects what a vehicle tells from somebody who has lost his right to it: he need not fall silent by himself."""
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    with (
        rigged(mine, listen=[endpoint], certificates=str(tmp_path / "drone1")) as vehicle,
        station(tmp_path / "ground", endpoint, certificates=tmp_path / "anna") as ground,
        station(tmp_path / "ground2", endpoint, certificates=tmp_path / "bob") as other,
    ):
        watching, commanding = known(other), known(ground)
        until(lambda: watching.has_whole_map and commanding.has_whole_map)
        authority.revoke("bob")
        (tmp_path / "drone1" / REVOKED).write_bytes((tmp_path / "authority" / REVOKED).read_bytes())
        until(lambda: watching.age_s > CUT_S, 3.0 * CUT_S)
        had = held(watching.source())
        mine.grow(3)
        until(lambda: held(commanding.source()) == held(mine.journal))
        assert commanding.age_s < 1.0
        assert answer_to(commanding, Command.STOP) == Answer(accepted=True)
        assert vehicle.obeyed == [(Command.STOP, "anna")]
        assert watching.age_s > CUT_S
        assert held(watching.source()) == had


def test_telemetry_of_another_is_refused_counted_and_told(tmp_path: Path, mine: Mine, authority: Authority) -> None:
    """Who may only watch puts the vehicle somewhere else, by his own certificate and by what he has recorded."""
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    heard: list[bytes] = []
    with (
        rigged(mine, listen=[endpoint], certificates=str(tmp_path / "drone1")),
        station(tmp_path / "ground", endpoint, certificates=tmp_path / "anna") as ground,
    ):
        seen = known(ground)
        bob = Certificates(tmp_path / "bob")
        session = open_session([], [endpoint], bob)
        try:
            session.declare_subscriber(telemetry_topic("drone1"), lambda one: heard.append(one.payload.to_bytes()))
            until(lambda: len(heard) > 10)
        finally:
            close_session(session)
        genuine = read_envelope(heard[-1])
        report = decoded(Report, genuine.message)
        lie = encoded(replace(report, clock_s=report.clock_s + 9.0, telemetry=replace(report.telemetry, x_m=99.0)))
        forged = Seal(genuine.session, bob).sealed(lie, genuine.heard, 1.0)
        unsigned = Seal(genuine.session, None).sealed(lie, genuine.heard, 1.0)
        assert seen.doubt == ""
        # Straight to the ground: the vehicle forwards nothing.
        for data, why in ((forged, "bob may watch"), (unsigned, "not signed"), (heard[5], "before"), (lie, "sealed")):
            ground._on_telemetry(Sample("drone1", data))  # type: ignore[arg-type]
            assert why in seen.doubt
        ground._on_telemetry(Sample("drone9", forged))  # type: ignore[arg-type]
        assert ground.refused == 5
        assert [one.name for one in ground.vehicles()] == ["drone1"], "nobody begins to be by what is refused"
        assert seen.telemetry is not None
        assert seen.telemetry.x_m != 99.0
    assert authority.issued()


class Sample:
    """What Zenoh hands over."""

    def __init__(self, vehicle: str, data: bytes) -> None:
        self.key_expr = telemetry_topic(vehicle)
        self.payload = SimpleNamespace(to_bytes=lambda: data)


def test_nobody_elses_certificate_is_heard(tmp_path: Path, mine: Mine, authority: Authority) -> None:
    others = Authority.make(tmp_path / "others")
    others.issue("mallory", "command", tmp_path / "mallory")
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    with (
        rigged(mine, listen=[endpoint], certificates=str(tmp_path / "drone1")) as vehicle,
        station(tmp_path / "ground", endpoint, certificates=tmp_path / "mallory") as ground,
        station(tmp_path / "ground2", endpoint, certificates=tmp_path / "bob") as other,
    ):
        known(other)
        assert not ground.vehicles()
        assert not vehicle.obeyed
    assert authority.issued()


def test_a_vehicle_with_the_certificates_of_another_does_not_begin(
    tmp_path: Path, mine: Mine, authority: Authority
) -> None:
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    with pytest.raises(InputError, match=r"they are of bob \(watch\)"):
        RiggedVehicle(mine, listen=[endpoint], certificates=str(tmp_path / "bob"))
    assert authority.issued()


def test_a_port_in_use_is_told(mine: Mine) -> None:
    with rigged(mine) as vehicle, pytest.raises(LinkError, match="cannot listen at tcp/127"):
        RiggedVehicle(mine, listen=[vehicle.endpoint])


@pytest.mark.parametrize("endpoint", ["tcp/10.0.0.1:7447", "tls/127.0.0.1:7447", "nonsense"])
def test_a_ground_without_certificates_stays_on_loopback(tmp_path: Path, endpoint: str) -> None:
    with pytest.raises(InputError, match=endpoint):
        station(tmp_path, endpoint)
