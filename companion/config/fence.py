"""Where the vehicle may be."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from companion.config.section import Section, refuse

Range = tuple[float, float]


class FenceSettings(Section):
    """Where the vehicle may be, in the autopilot's local frame; its origin is where the autopilot was started."""

    north_m: Range | None = Field(None, description="[least, most] to the north, in m; null: anywhere")
    east_m: Range | None = Field(None, description="[least, most] to the east, in m; null: anywhere")
    height_m: Range | None = Field(None, description="[least, most] above the origin, in m; null: anywhere")
    radius_m: float | None = Field(
        None, ge=1.0, le=100_000.0, description="largest distance from the origin in the plane, in m; null: anywhere"
    )

    @model_validator(mode="after")
    def _around_the_start(self) -> Self:
        for name in ("north_m", "east_m", "height_m"):
            bounds: Range | None = getattr(self, name)
            if bounds is None:
                continue
            key = f"safety.fence.{name}"
            least_m, most_m = bounds
            if least_m >= most_m:
                raise refuse(f"{key} = [{least_m:g}, {most_m:g}] must be [least, most]", key)
            if not least_m < 0.0 < most_m:
                raise refuse(
                    f"{key} = [{least_m:g}, {most_m:g}] must hold 0, the origin, where the flight starts: it would "
                    "begin outside of the fence",
                    key,
                )
        return self
