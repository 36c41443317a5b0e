"""Where on its way out a vehicle is, by the walls that it sees."""

from __future__ import annotations

import math
from dataclasses import replace

from companion.control.homing.homing import Homing
from companion.control.known_ground import UPRIGHT_57_DEG, KnownGround
from companion.model import Pose
from tests.control.scene import CAMERA_RAD, Scene, box, law_parameters

#: A ring of drifts 4 m wide about a pillar, with a niche by which a place of its south side is told.
RING = Scene(box(-4.0, -2.0, 42.0, 18.0), box(4.0, 2.0, 38.0, 14.0), box(-1.0, -2.0, 0.0, -1.2))


def test_the_whole_way_out_counts_for_how_far_it_may_have_drifted() -> None:
    """Protects the landing: back near home after a long way, the first look about home is believed from further off."""
    homing = Homing(law_parameters(), KnownGround(UPRIGHT_57_DEG, 0.25))
    corners = [(0.0, 0.0), (40.0, 0.0), (40.0, 16.0), (-2.0, 16.0), (-2.0, 2.0)]
    pose = Pose(0.0, 0.0, 0.0, 1.5, 0.0)
    for (x_m, y_m), (to_x_m, to_y_m) in zip(corners, corners[1:], strict=False):
        yaw_rad, length_m = math.atan2(to_y_m - y_m, to_x_m - x_m), math.dist((x_m, y_m), (to_x_m, to_y_m))
        for along_m in range(int(length_m)):
            share = along_m / length_m
            pose = Pose(pose.t_s + 1.0, x_m + share * (to_x_m - x_m), y_m + share * (to_y_m - y_m), 1.5, yaw_rad)
            homing.fly_out(RING.measure(pose, CAMERA_RAD, pose.z_m), pose)
    truly = Pose(pose.t_s + 1.0, -1.5, 0.5, 1.5, 0.0)
    believed = replace(truly, x_m=truly.x_m + 0.8, y_m=truly.y_m + 0.5)
    homing.begin(truly.t_s)
    homing.align(RING.measure(truly, CAMERA_RAD, truly.z_m), believed, truly.t_s)
    found = homing.pose(believed)
    assert math.hypot(found.x_m - truly.x_m, found.y_m - truly.y_m) < 0.15
