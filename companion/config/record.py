"""The flight recording."""

from __future__ import annotations

from pydantic import Field

from companion.config.section import Section


class RecordSettings(Section):
    """What is recorded of a flight, as MCAP: opens in Foxglove and Rerun."""

    enabled: bool = Field(True, description="whether flights are recorded")
    folder: str = Field("flights", min_length=1, description="each flight makes a new folder in it")
    depth: bool = Field(True, description="record the depth images too, so that the flight can be replayed")
    largest_mb: float = Field(
        4000.0, ge=10.0, le=1e6, description="size of a recording at which it stops; depth images go first, in MB"
    )
