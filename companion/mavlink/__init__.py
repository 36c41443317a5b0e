"""MAVLink as both sides of the gate use it: bytes to messages, modes, estimator, signatures.

The standard library and nothing else: all of it runs inside the gate.
"""
