"""Programs that try to break the whole: faults in flight, garbage on every wire, changes that some test must notice."""
