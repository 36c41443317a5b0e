"""What the tests with real autopilots need of their surroundings."""

from __future__ import annotations

import os

import pytest

from companion.errors import InputError
from sitl.launch.real import RealAutopilot, find
from validation.real.program import OWN_NETWORK


def real_or_skip(personality: str) -> RealAutopilot:
    """The real autopilot that the environment names; the test is skipped with the reason where it names none."""
    try:
        found = find(personality)
    except InputError as error:
        pytest.skip(str(error))
    if os.environ.get(OWN_NETWORK) != "1":
        pytest.skip("it listens on every interface of the computer: `make test-real` gives it a network of its own")
    return found
