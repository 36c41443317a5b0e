"""The process around the gate: sockets, the application as its child, signals, logs. It does what the gate says."""
