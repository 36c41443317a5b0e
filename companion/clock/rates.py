"""How fast another clock can run, and how fast that can change. A rate here is seconds of ours per second of it."""

MOST_RATE = 0.05
"""No clock runs further from ours than this: PX4's simulator loses 0.8 to 3.1 %."""
CRYSTAL_RATE = 5e-4
"""No two crystals are this far apart (100 ppm at worst): what runs further from ours is a simulation."""
CRYSTAL_WANDER = 1e-4
"""The rate of a crystal changes by no more than this."""
SIMULATION_WANDER = 0.025
"""That of a simulation follows the load of its computer: from 0.8 to 3.1 % within seconds."""
STEP_S = 0.004
"""The clock of a simulation goes in steps; PX4's are this long on it."""
GRAIN_S = 0.5 * STEP_S * (1.0 + MOST_RATE)
"""So what it says is right to half a step, which may be longer on our clock."""
