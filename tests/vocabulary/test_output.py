"""Output that nobody takes any more: the work goes on, and it is told once."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest

WORKS = """
import sys
from companion.output import lossy_output
with lossy_output() as lost:
    for line in range(3):
        print("line", line, flush=True)
    print("half a line", end="")
    print("the work was done:", lost(), file=sys.stderr)
"""


def done(stdout: int, **variables: str) -> str:
    """What a process says on standard error whose standard output is that one."""
    ended = subprocess.run(
        [sys.executable, "-c", WORKS],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **variables},
        check=True,
    )
    return ended.stderr


@pytest.mark.parametrize("variables", [{}, {"PYTHONUNBUFFERED": "1"}])
def test_a_full_device_is_told_once_and_the_work_goes_on(variables: dict[str, str]) -> None:
    """Protects a flight, and what it was for, from a log on a full disk."""
    with open("/dev/full", "wb") as full:  # noqa: PTH123 - as a shell redirects
        assert done(full.fileno(), **variables) == (
            "standard output: No space left on device; what would be printed from here on is lost\n"
            "the work was done: [Errno 28] No space left on device\n"
        )


def test_a_pipe_that_is_closed_is_not_worth_a_word() -> None:
    """Protects `| head`: who has read enough is told nothing."""
    read, write = os.pipe()
    os.close(read)
    assert done(write) == "the work was done: None\n"
    os.close(write)


def test_output_that_was_closed_at_the_start() -> None:
    """Protects a service that is started without any."""
    ended = subprocess.run(f"exec {sys.executable} -c '{WORKS}' >&-", shell=True, stderr=subprocess.PIPE, check=True)  # noqa: S602
    assert ended.stderr == b"the work was done: None\n"


INTERRUPTED = """
import signal
from companion.output import lossy_output
def interrupt(number, frame):
    raise KeyboardInterrupt
signal.signal(signal.SIGALRM, interrupt)
with lossy_output():
    line = 0
    while line < 300:
        try:
            signal.setitimer(signal.ITIMER_REAL, 3e-4)
            while True:
                line += 1
                print("line", line, flush=True)
        except KeyboardInterrupt:
            pass
    signal.setitimer(signal.ITIMER_REAL, 0)
"""


@pytest.mark.parametrize("variables", [{}, {"PYTHONUNBUFFERED": "1"}])
def test_nothing_is_written_twice_when_it_is_interrupted(variables: dict[str, str]) -> None:
    """Protects what is printed from Ctrl-C in the very moment of printing."""
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED],
        capture_output=True,
        text=True,
        env={**os.environ, **variables},
        check=True,
    )
    lines = re.findall(r"line \d+", ended.stdout)
    assert len(lines) > 200
    assert len(lines) == len(set(lines))


def test_what_is_written_arrives() -> None:
    ended = subprocess.run([sys.executable, "-c", WORKS], capture_output=True, text=True, check=True)
    assert ended.stdout == "line 0\nline 1\nline 2\nhalf a line"
