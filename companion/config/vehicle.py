"""The airframe as the software needs to know it."""

from __future__ import annotations

from pydantic import Field

from companion.config.section import Section


class VehicleSettings(Section):
    """The body that must not touch anything."""

    body_radius_m: float = Field(
        0.35,
        gt=0.05,
        le=2.0,
        description="radius of the body, propellers included, in m; a wall in it is a contact",
    )
    body_height_m: float = Field(0.3, gt=0.02, le=2.0, description="height of the body, in m")
