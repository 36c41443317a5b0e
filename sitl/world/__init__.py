"""A mine around the vehicle of a simulated autopilot: sensors rendered where it truly is.

Any simulator serves whose autopilot tells the truth over MAVLink (PX4 SIH, ArduPilot SITL, the stub of this package).
Depth and ranges leave over the stream that a camera process would offer; the autopilot gets the odometry that a
visual-inertial camera would give it.
"""
