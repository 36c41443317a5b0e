"""Small parts of the link: bandwidth, listeners, what goes over as bytes."""

from __future__ import annotations

import math

import pytest

from companion.link.drawing import Drawing, read_drawing
from companion.link.vehicle.bandwidth import OVERHEAD_BYTES, Bandwidth
from companion.link.vehicle.listeners import GONE_S, Listeners
from companion.link.vehicle.pipe import Kind, pair, receive, send
from companion.link.wire import Report, WireError, decoded, encoded
from companion.link.words import Telemetry
from tests.shared.graphs import small_graph

REPORT = Report(
    "s", 12.5, "20260101-120000", 3, Telemetry("drone1", "f", 7, 1.0, "exploring", x_m=1.0, warnings=("a",))
)


def test_no_more_than_the_limit_goes_out() -> None:
    """Whoever waits as long as told sends the limit on the long run, and a quarter of a second's at once."""
    bandwidth, now_s, sent = Bandwidth(80.0, 0.0), 0.0, 0
    while now_s < 100.0:
        size = 500
        now_s += bandwidth.take(size, now_s)
        sent += size + OVERHEAD_BYTES
    assert 10_000.0 * 100.0 <= sent <= 10_000.0 * 100.0 * 1.01 + 2_500.0


def test_what_cannot_wait_goes_out_and_the_others_wait_for_it() -> None:
    bandwidth = Bandwidth(80.0, 0.0)
    for _ in range(10):
        bandwidth.take(1_000 - OVERHEAD_BYTES, 0.0)
    assert bandwidth.take(0, 0.0) == pytest.approx((7_500 + OVERHEAD_BYTES) / 10_000)


def test_listeners_who_are_there_are_waited_for() -> None:
    listeners = Listeners()
    assert listeners.silent_s(5.0) == math.inf
    assert listeners.have_all(5.0), "nobody is there"
    listeners.heard("a", 5.0, True)
    listeners.heard("b", 6.0, False)
    assert listeners.silent_s(8.0) == 2.0
    assert not listeners.have_all(8.0)
    listeners.heard("b", 9.0)
    assert not listeners.have_all(9.0), "a command says nothing of the map"
    listeners.heard("anna", 9.0)
    assert listeners.have_all(9.1 + GONE_S), "whoever is gone is not waited for"
    listeners.heard("b", 30.0, True)
    assert listeners.have_all(30.0)
    listeners.there_is_more()
    assert not listeners.have_all(30.0)


def test_what_was_sent_before_an_end_was_closed_is_received() -> None:
    """Also when that end had something unread, as a process has that ends while it loads and says why."""
    ours, theirs = pair()
    send(ours, Kind.TELEMETRY, b"unread")
    send(theirs, Kind.TROUBLE, b"why")
    theirs.close()
    assert receive(ours) == (Kind.TROUBLE, b"why")
    with pytest.raises(EOFError):
        receive(ours)
    assert not send(ours, Kind.TELEMETRY)
    ours.close()


def test_listeners_are_bounded() -> None:
    listeners = Listeners()
    for number in range(1000):
        listeners.heard(str(number), float(number), False)
    assert listeners.silent_s(1000.0) == 1.0
    assert len(listeners._heard_s) < 100
    assert len(listeners._have_all) < 100


def test_telemetry_goes_over_as_it_is() -> None:
    assert decoded(Report, encoded(REPORT)) == REPORT


def test_what_is_no_number_does_not_go_over() -> None:
    broken = Telemetry("drone1", "f", 7, 1.0, "exploring", x_m=math.nan)
    with pytest.raises(ValueError, match="not JSON compliant"):
        encoded(broken)
    text = encoded(REPORT).decode()
    for wrong in (text.replace("12.5", "Infinity"), text.replace('"x_m":1.0', '"x_m":NaN'), text[:-1], "[]"):
        with pytest.raises(WireError):
            decoded(Report, wrong.encode())


def test_graph_and_frontiers_go_over() -> None:
    graph = small_graph()
    drawing = Drawing(graph, ((1.0, 2.0, 3.0),))
    found = read_drawing(drawing.encoded())
    assert found.frontiers_m == drawing.frontiers_m
    assert found.graph.counts() == graph.counts()
    for wrong in (b"", b"[]", b"[[1]]\n{}", b'[[1,2,"x"]]\n{}', drawing.encoded().replace(b"1.0", b"NaN", 1)):
        with pytest.raises(WireError):
            read_drawing(wrong)
