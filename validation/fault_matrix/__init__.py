"""The fault matrix: each fault is injected into a real flight of real processes towards a wall.

    python -m validation.fault_matrix --list
    python -m validation.fault_matrix --only "SIGKILL application" --personality px4

Autopilot, relay, gate, application, relay, world: everything runs on this computer, over MAVLink and the sensors'
stream, as on a vehicle. What is measured is what went over the wire and where the vehicle truly was.
"""
