"""Several vehicles in one mine."""

from __future__ import annotations

from pydantic import Field

from companion.config.section import Section


class FleetSettings(Section):
    """The height layers of law (11)."""

    group_range_m: float = Field(
        4.0, gt=0.5, le=200.0, description="vehicles nearer than this share a group and its height layers, in m (d_r)"
    )
    tunnel_height_m: float = Field(
        3.0, ge=1.0, le=50.0, description="least distance from ground to roof in the mine, in m (d_M)"
    )
    largest_group: int = Field(3, ge=1, le=20, description="most vehicles that can meet in one group (N)")
    stale_after_s: float = Field(
        1.0, gt=0.0, le=60.0, description="a position report older than this is stale; its layer stays reserved, in s"
    )
