"""What becomes of a message on its way down to the autopilot."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's answer to one message of the application.

    Attributes:
        raw: what goes to the autopilot: the message, or a stop in its place; None: nothing does.
        refused: why nothing does, as it is counted; empty when something does.
    """

    raw: bytes | None
    refused: str = ""

    @classmethod
    def passed(cls, raw: bytes) -> Verdict:
        """This goes to the autopilot."""
        return cls(raw)

    @classmethod
    def refusal(cls, why: str) -> Verdict:
        """Nothing does."""
        return cls(None, why)
