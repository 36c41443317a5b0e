"""The paper's navigation law: Measurement -> Setpoint.

Pure: no I/O, no clock, no asyncio, no randomness but the generator handed in. `Navigator` is the state machine of
Section 3 of the paper; the other modules are its equations, one idea a file.
"""

from companion.control.navigator import Navigator, Status
from companion.control.parameters import Parameters
from companion.control.target import TargetKind

__all__ = ["Navigator", "Parameters", "Status", "TargetKind"]
