"""Settings of the voxel map."""

from __future__ import annotations

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from companion.config.section import Section, refuse

Model = Literal["robust", "octomap"]

OCTOMAP: dict[str, Any] = {
    "hit_probability": 0.7,
    "miss_probability": 0.4,
    "clamp_min_probability": 0.1192,
    "clamp_max_probability": 0.971,
    "occupied_probability": 0.5,
    "depth_noise_per_m": 0.0,
    "margin_m": 0.0,
}
"""What `model: octomap` fills in: the defaults of OctoMap's own OcTree, to the last digit."""


class MapSettings(Section):
    """How depth images become a map of free, occupied and unknown voxels.

    The sensor model is OctoMap's (Hornung et al. 2013), and so are its probabilities: log-odds with clamps, one update
    for each voxel and frame. Two things differ, because what noise puts behind a wall is never looked at again and so
    never taken back: a hit counts less where the noise is wider than a voxel, and a voxel is occupied from 0.7 on
    instead of 0.5, which takes two good hits or several poor ones. Either alone changes next to nothing. Whoever wants
    to compare with OctoMap takes ``model: octomap``, which has neither.

    Measured in a box tunnel (4 m x 3 m, 36 m long, with boxes in it), one flight through it, 160 x 120 px to 6 m, depth
    noise 0.002 z², 2 % dropouts, pose noise 1 cm and 0.2°:

        ============================ ======= ========= ============ ========== =======================
        .                            voxel   precision completeness mean error surface in a free voxel
        ============================ ======= ========= ============ ========== =======================
        OctoMap's model, 580 frames  0.1 m   90.4 %    99.9 %       4.8 cm     0.1 %
        these defaults, 580 frames   0.1 m   98.0 %    99.7 %       4.1 cm     0.1 %
        these defaults, 116 frames   0.1 m   99.5 %    98.9 %       3.3 cm     0.2 %
        OctoMap's model, 580 frames  0.05 m  85.5 %    99.4 %       3.3 cm     0.2 %
        these defaults, 580 frames   0.05 m  94.0 %    98.3 %       2.6 cm     0.3 %
        ============================ ======= ========= ============ ========== =======================
    """

    model: Model = Field(
        "robust",
        description="sensor model for what is left out below: robust (for noisy depth, the defaults shown here) or "
        "octomap (OctoMap's own numbers, so that maps compare)",
    )
    voxel_m: float = Field(0.1, ge=0.02, le=1.0, description="edge of a voxel, in m")
    max_range_m: float = Field(
        6.0, ge=0.5, le=30.0, description="depth that the map believes; a reading beyond it says free up to here, in m"
    )
    hit_probability: float = Field(
        0.7, gt=0.0, le=0.99, description="occupancy that one exact hit alone gives a voxel, above 0.5"
    )
    miss_probability: float = Field(
        0.4, ge=0.01, lt=1.0, description="occupancy that one look through a voxel alone gives it, below 0.5"
    )
    clamp_min_probability: float = Field(
        0.12, ge=0.001, lt=1.0, description="no voxel becomes surer of being free than this, below 0.5"
    )
    clamp_max_probability: float = Field(
        0.97, gt=0.0, le=0.999, description="no voxel becomes surer of being occupied than this"
    )
    occupied_probability: float = Field(
        0.7, ge=0.5, lt=1.0, description="a voxel is occupied from this on; between 0.5 and this it is unknown"
    )
    depth_noise_per_m: float = Field(
        0.002, ge=0.0, le=0.1, description="noise of the camera: its standard deviation over the depth squared, in 1/m"
    )
    margin_m: float = Field(
        0.0, ge=0.0, le=1.0, description="free space ends this far and the noise before a measured surface, in m"
    )
    saturated_m: float | None = Field(
        None,
        gt=0.0,
        le=1000.0,
        description="a reading at or beyond this is the camera's word for no return and says nothing, in m (65.5 for "
        "many 16-bit cameras); null: every reading beyond the range says free up to there",
    )
    memory_mb: int = Field(
        1024,
        ge=64,
        le=65536,
        description="memory for the map, in MB; what does not fit waits in the journal on the disk until it is seen "
        "again",
    )
    journal_period_s: float = Field(
        0.5,
        ge=0.1,
        le=10.0,
        description="what changed is put on the disk this often, in s: so much is lost when the map's process or the "
        "computer dies",
    )

    @model_validator(mode="after")
    def _fill_by_model(self) -> Self:
        """What the file leaves out is the model's. In place: this is still the making of a frozen object."""
        if self.model == "octomap":
            left_out = {key: value for key, value in OCTOMAP.items() if key not in self.model_fields_set}
            self.__dict__.update(left_out)
        return self

    @model_validator(mode="after")
    def _saturation_beyond_range(self) -> Self:
        if self.saturated_m is not None and self.saturated_m < self.max_range_m:
            raise refuse(
                f"mapping.saturated_m = {self.saturated_m:g} m must be at least mapping.max_range_m = "
                f"{self.max_range_m:g} m, or readings that the map believes would say nothing; give what the camera "
                "sends when nothing comes back",
                "mapping.saturated_m",
                "mapping.max_range_m",
            )
        return self

    @model_validator(mode="after")
    def _probabilities_leave_room(self) -> Self:
        for name, wrong, bound in (
            ("hit_probability", self.hit_probability <= 0.5, "above 0.5: a hit speaks for occupied"),
            ("miss_probability", self.miss_probability >= 0.5, "below 0.5: a miss speaks for free"),
            ("clamp_min_probability", self.clamp_min_probability >= 0.5, "below 0.5, or nothing could become free"),
        ):
            if wrong:
                raise refuse(f"mapping.{name} = {getattr(self, name):g} must be {bound}", f"mapping.{name}")
        if self.clamp_max_probability <= self.occupied_probability:
            raise refuse(
                f"mapping.clamp_max_probability = {self.clamp_max_probability:g} must be above "
                f"mapping.occupied_probability = {self.occupied_probability:g}, or nothing could become occupied",
                "mapping.clamp_max_probability",
                "mapping.occupied_probability",
            )
        return self
