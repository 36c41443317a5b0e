"""Lines are written whole and in order; a reader that does not read delays nothing and is told what it missed."""

from __future__ import annotations

import os
import re
import time

from companion.gate.runtime.log import WAITING_LINES, Log


def test_lines_come_in_order_with_the_time_of_day() -> None:
    reading, writing = os.pipe()
    log = Log(writing, wall_clock=lambda: 1_700_000_000.0625)
    for number in range(3):
        log.say(f"line {number}")
    log.close(5.0)
    lines = os.read(reading, 4096).decode().splitlines()
    assert [line.partition(" gate: ")[2] for line in lines] == ["line 0", "line 1", "line 2"]
    assert all(re.match(r"\d\d:\d\d:20\.062 gate: ", line) for line in lines)
    os.close(reading)
    os.close(writing)


def test_a_full_pipe_delays_nobody_and_the_loss_is_told() -> None:
    reading, writing = os.pipe()
    log = Log(writing)
    # More than the pipe and the queue hold.
    began_s = time.monotonic()
    for _ in range(WAITING_LINES * 3):
        log.say("x" * 1000)
    took_s = time.monotonic() - began_s
    assert log.lost > 0
    log.close(0.05)
    # Far below what a person would need to read it: nobody waited for that.
    assert took_s < 2.0
    os.set_blocking(reading, True)
    taken = b""
    while b"lost" not in taken or not taken.endswith(b"\n"):
        taken += os.read(reading, 1 << 20)
        log.close(0.2)
    assert f"{log.lost} lines of the gate were lost".encode() in taken
    os.close(reading)
    os.close(writing)


def test_a_terminal_that_is_gone_ends_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    log = Log(writing)
    log.say("nobody")
    log.say("reads this")
    log.close(5.0)
    assert log.lost == 0
    os.close(writing)


def test_a_line_longer_than_the_pipe_is_written_in_parts() -> None:
    reading, writing = os.pipe()
    log = Log(writing)
    log.say("y" * 200_000)
    taken = b""
    while not taken.endswith(b"\n"):
        taken += os.read(reading, 1 << 20)
    assert taken.count(b"y") == 200_000
    log.close(5.0)
    os.close(reading)
    os.close(writing)
