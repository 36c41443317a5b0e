"""The gate: a small process of its own on the wire between the application and the flight controller.

It owns the only link to the flight controller, lets pass what is on a list, checks every setpoint, and stops the
vehicle itself when anything behind the setpoints is late or wrong. It is written to be believed: the standard library,
pyserial and `companion.mavlink`, nothing else; no numpy, no numba, no asyncio.

What decides is pure (`gate`, `escalation`, `setpoint_limits`, `motion`, `allowlist`): messages and the time go in,
messages come out. What touches the system is thin, and in `runtime`.
"""
