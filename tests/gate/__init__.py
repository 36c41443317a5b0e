"""The parts of the gate, one at a time."""
