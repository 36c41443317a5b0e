"""One flight, from the pre-flight checks to the summary: `python -m companion.flight` is started by the gate."""
