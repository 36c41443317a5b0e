"""The map in a process of its own: what the application holds of it, what they say to each other, and the process."""
