"""The way home: what is remembered of the way out, where the vehicle is on it, and how it goes back. Pure."""
