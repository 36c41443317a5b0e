"""The course of a flight: when it begins, how it ends, and what is recorded of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from companion.config.section import Section, refuse

LEAST_MIDDLE_US = 100


def _folder(text: str) -> str:
    """A folder as it stands, with the home of a person put in its place; what only a shell understands is refused."""
    if "$" in text:
        raise ValueError("names a variable, which a settings file does not know: write the path itself")
    if re.match(r"[A-Za-z]:[\\/]", text) or "\\" in text:
        raise ValueError("is a path of Windows: folders are separated by /, and there are no drives")
    try:
        return str(Path(text).expanduser())
    except RuntimeError:
        raise ValueError(f"there is nobody called {text.partition('/')[0][1:]!r} here: write the path itself") from None


class RcSwitchSettings(Section):
    """A switch of the pilot's transmitter that starts the flight and ends it: high explores, the middle pauses."""

    channel: int | None = Field(
        None,
        ge=5,
        le=18,
        description="number of the channel in RC_CHANNELS, not one of the four sticks; null: there is no such switch",
    )
    low_us: int = Field(1300, ge=900, le=2100, description="below this pulse length the switch stands low, in µs")
    high_us: int = Field(
        1700, ge=900, le=2100, description="above this pulse length it stands high: explore, or go on, in µs"
    )
    low: Literal["home", "land", "pause"] = Field(
        "home", description="what low asks for: come home, land where it is, or pause"
    )

    @model_validator(mode="after")
    def _has_a_middle(self) -> Self:
        if self.high_us - self.low_us < LEAST_MIDDLE_US:
            raise refuse(
                f"mission.rc_switch.high_us = {self.high_us} must be at least {LEAST_MIDDLE_US} above "
                f"mission.rc_switch.low_us = {self.low_us}: a pulse that jitters would move the switch",
                "mission.rc_switch.low_us",
                "mission.rc_switch.high_us",
            )
        return self


class MissionSettings(Section):
    """The course of a flight around the exploring."""

    start: Literal["now", "key", "command"] = Field(
        "key",
        description="what starts the flight: now, the Enter key, or a command: MAV_CMD_MISSION_START from a ground "
        "station, the transmitter's switch where rc_switch has a channel, or on ArduCopter the mission item "
        "NAV_GUIDED_ENABLE",
    )
    rc_switch: RcSwitchSettings = Field(RcSwitchSettings(), description="a switch of the pilot's transmitter")
    end_action: Literal["home", "hold", "land"] = Field(
        "home",
        description="what follows the exploring when it is complete, stopped, or ended by time or battery: home (back "
        "the way that it knows, and land where it took off), hold or land where it is",
    )
    reserve_percent: float = Field(
        25.0,
        ge=0.0,
        le=90.0,
        description="share of the battery that shall be left at home, in percent: with end_action home it turns back "
        "in time, by the length of the way, the speed that it flies and what it draws; safety.battery_percent where "
        "that is more",
    )
    time_limit_s: float = Field(1200.0, gt=0.0, le=86400.0, description="of exploring; then the flight ends, in s")
    battery_low_percent: float = Field(
        25.0, ge=0.0, le=95.0, description="the flight ends when the battery has less than this left, in percent"
    )
    battery_low_v: float | None = Field(
        None,
        gt=0.0,
        le=1000.0,
        description="the flight ends when the battery's voltage stays below this for 5 s, in V, about 3.5 V a cell; "
        "null: not judged. ArduPilot's percent is a count from 100 % at each boot, so it needs this or BATT_LOW_VOLT",
    )
    take_off_timeout_s: float = Field(
        40.0, ge=5.0, le=300.0, description="the height H must be reached in this time, in s"
    )
    input_timeout_s: float = Field(
        10.0, ge=1.0, le=600.0, description="standing still without fresh inputs for this long ends the flight, in s"
    )
    link_lost: Literal["go_on", "home", "land"] = Field(
        "go_on",
        description="what follows when nobody at the ground has been heard over the link for link_lost_s: go on, come "
        "home, or land where it is",
    )
    link_lost_s: float = Field(
        60.0, ge=2.0, le=86400.0, description="for so long nobody was heard, from the take-off on, in s"
    )
    skip_checks: tuple[str, ...] = Field((), description="names of pre-flight checks to skip; recorded with the flight")


class RecordSettings(Section):
    """What is recorded of a flight, as MCAP: opens in Foxglove and Rerun."""

    enabled: bool = Field(True, description="whether flights are recorded")
    folder: Annotated[str, AfterValidator(_folder)] = Field(
        "flights", min_length=1, description="each flight makes a new folder in it; ~ is your home"
    )
    depth: bool = Field(True, description="record the depth images too, so that the flight can be replayed")
    largest_mb: float = Field(
        4000.0, ge=10.0, le=1e6, description="size of a recording at which it stops; depth images go first, in MB"
    )
