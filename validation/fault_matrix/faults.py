"""All faults of the matrix."""

from __future__ import annotations

from validation.fault_matrix.injection import Injection
from validation.fault_matrix.link_faults import LINK_FAULTS
from validation.fault_matrix.process_faults import APPLICATION_FAULTS, COMPUTER_FAULTS, PROCESS_FAULTS
from validation.fault_matrix.sensor_faults import SENSOR_FAULTS

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
