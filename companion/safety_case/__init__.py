"""Whether a configuration stops before every wall: the stopping budget, its tables, and the plan that the gate gets."""
