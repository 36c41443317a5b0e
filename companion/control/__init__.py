"""The paper's navigation law: Measurement -> Setpoint.

Pure: no I/O, no clock, no asyncio, no randomness but the generator handed in. `navigator.Navigator` is the state
machine of Section 3 of the paper; the other modules are its equations, one idea a file. Nothing is imported here: the
configuration needs `parameters`, and must not wait for the compiler that the others need.
"""
