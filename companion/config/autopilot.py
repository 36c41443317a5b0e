"""The flight controller and the link to it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from companion.config.section import Section
from companion.mavlink.link_url import LINK_FORMS, parse_link


def _link_url(url: str) -> str:
    try:
        parse_link(url)
    except ValueError:
        raise PydanticCustomError("link_url", LINK_FORMS) from None
    return url


LinkUrl = Annotated[str, AfterValidator(_link_url)]
"""Where a MAVLink partner is."""


class AutopilotSettings(Section):
    """How the flight controller is reached, and what is expected of it."""

    url: LinkUrl = Field("udpin://127.0.0.1:14540", description=f"where the flight controller is: {LINK_FORMS}")
    system_id: int = Field(
        1, ge=1, le=250, description="MAVLink system id of this vehicle; the application is component 191 of it"
    )
    connect_timeout_s: float = Field(30.0, gt=0.0, le=600.0, description="how long to wait for the autopilot, in s")
    ready_timeout_s: float = Field(
        60.0,
        ge=0.0,
        le=600.0,
        description="how long to wait for the autopilot's position, and until ArduPilot can be armed, in s",
    )
    command_timeout_s: float = Field(2.0, ge=0.5, le=30.0, description="how long to wait for an acknowledgement, in s")
    attitude_hz: float = Field(50.0, ge=5.0, le=200.0, description="rate at which attitudes are asked for")
    position_hz: float = Field(
        50.0, ge=5.0, le=200.0, description="rate at which positions and velocities are asked for"
    )
    gps: bool = Field(
        True, description="false: no GPS, the autopilot knows its position from external (visual) odometry only"
    )
    odometry_frame: Literal["local_ned", "local_frd"] = Field(
        "local_ned",
        description="in which frame the source of the odometry sends ODOMETRY to PX4 without GPS; ignored otherwise. "
        "local_ned, with any heading, is told an origin and can hold; with local_frd and an origin every landing would "
        "fly to 0°/0°, so none is told, and hold is a landing",
    )
    silence_s: float = Field(
        0.5,
        ge=0.2,
        le=2.0,
        description="the autopilot must react when setpoints stop for this long (PX4 COM_OF_LOSS_T, ArduPilot "
        "GUID_TIMEOUT); pre-flight checks it",
    )
