"""Time, handed in: the clock of this computer, and where the clock of another one stands against it.

Everything in the application is stamped in seconds of `time.monotonic` of the computer that it runs on. What other
clocks say (the autopilot's time since boot, a camera's time) is moved over by a `ClockAlignment`.
"""

from companion.clock.alignment import ClockAlignment
from companion.clock.local import Clock, MonotonicClock
from companion.clock.rates import CRYSTAL_RATE

__all__ = ["CRYSTAL_RATE", "Clock", "ClockAlignment", "MonotonicClock"]
