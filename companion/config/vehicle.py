"""The airframe as the software needs to know it, and several of them in one mine."""

from __future__ import annotations

from pydantic import Field

from companion.config.section import Section

MOST_NUMBER = 255
"""Of a vehicle in its fleet."""


class VehicleSettings(Section):
    """The body that must not touch anything."""

    body_radius_m: float = Field(
        0.35, gt=0.05, le=2.0, description="radius of the body, propellers included, in m; a wall in it is a contact"
    )
    body_height_m: float = Field(0.3, gt=0.02, le=2.0, description="height of the body, in m")


class FleetSettings(Section):
    """Several vehicles: the height layers of law (11), and the distance that is kept until those are reached."""

    group_range_m: float = Field(
        4.0, gt=0.5, le=200.0, description="vehicles nearer than this share a group and its height layers, in m (d_r)"
    )
    tunnel_height_m: float = Field(
        3.0, ge=1.0, le=50.0, description="least distance from ground to roof in the mine, in m (d_M)"
    )
    largest_group: int = Field(3, ge=1, le=20, description="most vehicles that can meet in one group (N)")
    margin_m: float = Field(
        0.3,
        ge=0.1,
        le=10.0,
        description="least distance in the plane between the bodies of two vehicles that are less than "
        "control.vertical_margin_m apart in height, in m",
    )
    number: int | None = Field(
        None,
        ge=1,
        le=MOST_NUMBER,
        description="of this vehicle among the others, each its own: the smaller, the higher its layer; they hear each "
        "other over the link; null: it flies alone",
    )
    start_pose: tuple[float, float, float, float] = Field(
        (0.0, 0.0, 0.0, 0.0),
        description="where it stands before it takes off, x, y and z of the middle of its body in m and its heading in "
        "rad to the left of x, in one frame for all vehicles",
    )
    stale_after_s: float = Field(
        1.0, gt=0.0, le=60.0, description="a position report older than this is stale; its layer stays reserved, in s"
    )
