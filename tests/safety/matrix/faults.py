"""All faults of the matrix."""

from __future__ import annotations

from tests.safety.matrix.injection import Injection
from tests.safety.matrix.link_faults import LINK_FAULTS
from tests.safety.matrix.process_faults import APPLICATION_FAULTS, COMPUTER_FAULTS, PROCESS_FAULTS
from tests.safety.matrix.sensor_faults import SENSOR_FAULTS

FAULTS: tuple[Injection, ...] = (
    *PROCESS_FAULTS,
    *APPLICATION_FAULTS,
    *SENSOR_FAULTS,
    *LINK_FAULTS,
    *COMPUTER_FAULTS,
)
"""In the order of the table."""

BY_NAME: dict[str, Injection] = {fault.name: fault for fault in FAULTS}

CELLS: tuple[tuple[str, str], ...] = tuple((fault.name, one) for fault in FAULTS for one in fault.personalities)
"""Every fault with every autopilot: the flights of the whole matrix."""
