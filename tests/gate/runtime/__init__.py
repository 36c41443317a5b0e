"""The shell around the gate: its loop, the application that it keeps, its signals, its start and its end."""
