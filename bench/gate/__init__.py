"""The gate: its delay, its processor time and its memory."""
