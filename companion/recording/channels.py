"""The channels of a recording: well-known schemas where Foxglove and Rerun have one, JSON with a schema otherwise."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
from foxglove import Channel, Context
from foxglove.channels import (
    CameraCalibrationChannel,
    FrameTransformsChannel,
    LaserScanChannel,
    LogChannel,
    PoseInFrameChannel,
    RawImageChannel,
)
from foxglove.messages import (
    CameraCalibration,
    FrameTransform,
    FrameTransforms,
    LaserScan,
    Log,
    LogLevel,
    PoseInFrame,
    Quaternion,
    RawImage,
    Timestamp,
    Vector3,
)
from foxglove.messages import Pose as PoseMessage

from companion.geometry import quaternion
from companion.model import CLEAR, HIT, Camera, DepthFrame, Pose, Scan
from companion.pipeline import Tick
from companion.recording.content import Topic
from companion.recording.observation import encode, finite, number

WORLD, LEVEL, BODY, MOUNT, CAMERA = "world", "level", "body", "camera_mount", "camera"
"""Frames: world is east-north-up; level turns with the heading only; body is forward-left-up; the mount is the camera's
own forward-left-up; camera is the optical frame of images: right-down-forward."""

LONGEST_TEXT = 10_000
SANE_S = 1e6
"""Stamps further than this from the start of the recording are wrong; they must not overflow the file's times."""

_OPTICAL = Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5)
_LEVELS = {
    logging.DEBUG: LogLevel.Debug,
    logging.INFO: LogLevel.Info,
    logging.WARNING: LogLevel.Warning,
    logging.ERROR: LogLevel.Error,
    logging.CRITICAL: LogLevel.Fatal,
}


def _schema(title: str, **properties: str | list[str]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": {name: {"type": kind} for name, kind in properties.items()}}


_NUMBER: list[str] = ["number", "null"]
COMMANDED = ("speed_mps", "climb_mps", "yaw_rate_radps", "lateral_mps")
MEASURED = ("h_m", "roof_m", "d_m", "d_bearing_rad", "d_front_m", "d_dot_mps", "ground_slope")
TICK_SCHEMA = _schema(
    "companion.Tick",
    number="integer",
    t_s="number",
    mode="string",
    stepped="boolean",
    sent="boolean",
    order="string",
    **dict.fromkeys((*COMMANDED, "wanted_height_m", *MEASURED), _NUMBER),
    ahead_m=["number", "string"],
    **dict.fromkeys(("depth_age_s", "ranges_age_s", "pose_age_s"), _NUMBER),
    missing="array",
    duration_s="number",
)
OBSERVATION_SCHEMA = _schema(
    "companion.Observation",
    t_s="number",
    pose="object",
    ranges="array",
    frame=["object", "null"],
    planar=["object", "null"],
)
PROCESS_SCHEMA = _schema(
    "companion.Process",
    **dict.fromkeys(("cpu_share", "children_cpu_share", "memory_mb", "children_memory_mb"), _NUMBER),
    wall_clock_steps_s="number",
    ticks_dropped="integer",
    frames_dropped="integer",
    file_bytes="integer",
)


class Channels:
    """Encodes what was recorded and hands it to the writer of ``context``.

    Args:
        context: what the MCAP writer listens to.
        wall_ns: wall clock at the start, in ns since 1970.
        start_s: the application's clock at the same moment. Every time in the file is `wall_ns` plus what this clock
            has gone since: whoever sets the wall clock during a flight disorders nothing.
    """

    def __init__(self, context: Context, wall_ns: int, start_s: float) -> None:
        self._wall_ns = wall_ns
        self._start_s = start_s
        self._tick = Channel(Topic.TICK, schema=TICK_SCHEMA, context=context)
        self._observation = Channel(Topic.OBSERVATION, schema=OBSERVATION_SCHEMA, context=context)
        self._process = Channel(Topic.PROCESS, schema=PROCESS_SCHEMA, context=context)
        self._pose = PoseInFrameChannel(Topic.POSE, context=context)
        self._transforms = FrameTransformsChannel(Topic.TRANSFORMS, context=context)
        self._scan = LaserScanChannel(Topic.SCAN, context=context)
        self._depth = RawImageChannel(Topic.DEPTH, context=context)
        self._calibration = CameraCalibrationChannel(Topic.CALIBRATION, context=context)
        self._log = LogChannel(Topic.LOG, context=context)

    def tick(self, tick: Tick, count: int, with_frame: bool) -> None:
        """One sampling period, the ``count``-th; its depth image comes first, so that no cut parts the two."""
        (observation, measurement), setpoint = tick.known(), tick.setpoint
        t_ns = self._ns(observation.t_s, self._wall_ns)
        if observation.frame is not None and with_frame:
            self._log_frame(observation.frame, t_ns)
        self._observation.log(encode(observation, with_frame), log_time=t_ns)
        self._tick.log(
            {
                "number": count,
                "t_s": number(observation.t_s),
                "mode": tick.mode.value,
                "stepped": tick.stepped,
                "sent": tick.sent,
                "order": tick.order.value,
                **{name: None if setpoint is None else number(getattr(setpoint, name)) for name in COMMANDED},
                "wanted_height_m": number(tick.height_m),
                **{name: finite(getattr(measurement, name)) for name in MEASURED},
                # As text when it is no number: free ("inf") and not known ("nan") are two things.
                "ahead_m": number(measurement.ahead_m),
                "missing": list(measurement.missing),
                # When the tick was done, which is when its setpoint went out.
                "depth_age_s": finite(measurement.scan_age_s + tick.duration_s),
                "ranges_age_s": finite(measurement.ranges_age_s + tick.duration_s),
                "pose_age_s": finite(observation.t_s + tick.duration_s - observation.pose.t_s),
                "duration_s": finite(tick.duration_s),
            },
            log_time=t_ns,
        )
        self._log_pose(observation.pose, t_ns)

    def scan(self, scan: Scan, t_s: float) -> None:
        """N(t). Seen free is infinitely far, as scanners say it; what nobody looked at is NaN."""
        ranges = np.where(scan.state == HIT, scan.ranges_m, np.where(scan.state == CLEAR, np.inf, np.nan))
        t_ns = self._ns(t_s, self._wall_ns)
        message = LaserScan(
            timestamp=_stamp(t_ns),
            frame_id=LEVEL,
            pose=PoseMessage(position=Vector3(), orientation=Quaternion(w=1.0)),
            start_angle=float(scan.bearings_rad[0]),
            end_angle=float(scan.bearings_rad[-1]),
            ranges=ranges.tolist(),
            intensities=scan.fresh.astype(np.float64).tolist(),
        )
        self._scan.log(message, log_time=t_ns)

    def event(self, name: str, text: str, level: int, t_s: float) -> None:
        """A line of the log."""
        t_ns = self._ns(t_s, self._wall_ns)
        message = Log(
            timestamp=_stamp(t_ns), level=_LEVELS.get(level, LogLevel.Unknown), message=text[:LONGEST_TEXT], name=name
        )
        self._log.log(message, log_time=t_ns)

    def process(self, values: dict[str, float], t_s: float) -> None:
        """Load of the processor and the recorder's own counts."""
        self._process.log({"t_s": t_s, **values}, log_time=self._ns(t_s, self._wall_ns))

    def close(self) -> None:
        """Take the channels off the writer's list."""
        for channel in (self._tick, self._observation, self._process):
            channel.close()
        for typed in (self._pose, self._transforms, self._scan, self._depth, self._calibration, self._log):
            typed.close()

    def _log_pose(self, pose: Pose, t_ns: int) -> None:
        stamp = _stamp(self._ns(pose.t_s, t_ns))
        position = Vector3(x=pose.x_m, y=pose.y_m, z=pose.z_m)
        whole = _quaternion(pose.yaw_rad, pose.pitch_rad, pose.roll_rad)
        heading = _quaternion(pose.yaw_rad, 0.0, 0.0)
        tilt = _quaternion(0.0, pose.pitch_rad, pose.roll_rad)
        at = PoseMessage(position=position, orientation=whole)
        self._pose.log(PoseInFrame(timestamp=stamp, frame_id=WORLD, pose=at), log_time=t_ns)
        moved = _transform(stamp, WORLD, LEVEL, position, heading), _transform(stamp, LEVEL, BODY, Vector3(), tilt)
        self._transforms.log(FrameTransforms(transforms=list(moved)), log_time=t_ns)

    def _log_frame(self, frame: DepthFrame, t_ns: int) -> None:
        """The depth as 32-bit floats: only so NaN, infinity and every last bit come back, and the replay is exact."""
        camera = frame.camera
        stamp = _stamp(self._ns(frame.t_s, t_ns))
        height, width = frame.depth_m.shape
        data = np.ascontiguousarray(frame.depth_m, np.dtype("<f4")).tobytes()
        image = RawImage(
            timestamp=stamp, frame_id=CAMERA, width=width, height=height, encoding="32FC1", step=4 * width, data=data
        )
        self._depth.log(image, log_time=t_ns)
        self._calibration.log(_calibration(camera, stamp), log_time=t_ns)
        mounted = _transform(
            stamp,
            BODY,
            MOUNT,
            Vector3(x=camera.mount_x_m, y=camera.mount_y_m, z=camera.mount_z_m),
            _quaternion(camera.mount_yaw_rad, camera.mount_pitch_rad, 0.0),
        )
        optical = _transform(stamp, MOUNT, CAMERA, Vector3(), _OPTICAL)
        self._transforms.log(FrameTransforms(transforms=[mounted, optical]), log_time=t_ns)

    def _ns(self, t_s: float, otherwise_ns: int) -> int:
        """A time of the application's clock as the file has it."""
        since_s = t_s - self._start_s
        return self._wall_ns + round(since_s * 1e9) if abs(since_s) < SANE_S else otherwise_ns


def _stamp(t_ns: int) -> Timestamp:
    return Timestamp(t_ns // 1_000_000_000, t_ns % 1_000_000_000)


def _transform(stamp: Timestamp, parent: str, child: str, at: Vector3, rotation: Quaternion) -> FrameTransform:
    return FrameTransform(
        timestamp=stamp, parent_frame_id=parent, child_frame_id=child, translation=at, rotation=rotation
    )


def _calibration(camera: Camera, stamp: Timestamp) -> CameraCalibration:
    fx, fy, cx, cy = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    return CameraCalibration(
        timestamp=stamp,
        frame_id=CAMERA,
        width=camera.width_px,
        height=camera.height_px,
        K=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def _quaternion(yaw_rad: float, pitch_rad: float, roll_rad: float) -> Quaternion:
    """Of Rz(yaw)·Ry(pitch)·Rx(roll); NaN for angles that are no angles."""
    if not all(math.isfinite(angle) for angle in (yaw_rad, pitch_rad, roll_rad)):
        return Quaternion(x=math.nan, y=math.nan, z=math.nan, w=math.nan)
    w, x, y, z = quaternion(yaw_rad, pitch_rad, roll_rad)
    return Quaternion(x=x, y=y, z=z, w=w)
