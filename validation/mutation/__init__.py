"""Mutation testing: changes the pure part of the gate in small ways, one at a time; some test has to notice."""
