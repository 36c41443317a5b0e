"""Settings of the voxel map."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Probability = Annotated[float, Field(gt=0.0, lt=1.0, allow_inf_nan=False)]


class MapSettings(BaseModel):
    """How depth images become a map of free, occupied and unknown voxels.

    The sensor model is OctoMap's (Hornung et al. 2013): clamped log-odds, one update for each voxel and frame.
    OctoMap's own numbers are hit 0.7, miss 0.4, clamps 0.12 and 0.97, threshold 0.5.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    voxel_m: float = Field(0.1, ge=0.02, le=1.0, allow_inf_nan=False, description="edge of a voxel, in m")
    max_range_m: float = Field(
        6.0,
        ge=0.5,
        le=30.0,
        allow_inf_nan=False,
        description="depth up to which the map believes the camera, in m; readings beyond it say free up to here",
    )
    hit_probability: Probability = Field(0.7, description="occupancy that one hit alone gives a voxel; above 0.5")
    miss_probability: Probability = Field(0.4, description="occupancy that one look through a voxel gives; below 0.5")
    clamp_min_probability: Probability = Field(0.12, description="no voxel becomes surer of being free than this")
    clamp_max_probability: Probability = Field(0.97, description="no voxel becomes surer of being occupied than this")
    occupied_probability: Probability = Field(
        0.5, ge=0.5, description="a voxel counts as occupied from this on; from 0.5 up to it, it counts as unknown"
    )
    depth_noise_per_m: float = Field(
        0.002,
        ge=0.0,
        le=0.05,
        allow_inf_nan=False,
        description="depth noise of the camera: its standard deviation is this times the squared depth, in 1/m",
    )
    margin_voxels: float = Field(
        0.5,
        ge=0.0,
        le=3.0,
        allow_inf_nan=False,
        description="how far before a measured surface free space ends, in voxels; the noise is added to it",
    )

    @model_validator(mode="after")
    def _probabilities_in_order(self) -> Self:
        if self.hit_probability <= 0.5:
            raise ValueError(f"hit_probability is {self.hit_probability}: a hit must speak for occupied, so above 0.5")
        if self.miss_probability >= 0.5:
            raise ValueError(f"miss_probability is {self.miss_probability}: a miss must speak for free, so below 0.5")
        if self.clamp_min_probability >= 0.5:
            raise ValueError(
                f"clamp_min_probability is {self.clamp_min_probability}: it must be below 0.5, or nothing becomes free"
            )
        if self.clamp_max_probability <= self.occupied_probability:
            raise ValueError(
                f"clamp_max_probability is {self.clamp_max_probability}: it must be above occupied_probability "
                f"({self.occupied_probability}), or nothing becomes occupied"
            )
        return self
