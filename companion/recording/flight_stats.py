"""The figures of a flight, from its recording: how regular, how fresh, how near to the walls, at what cost."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.config.source import Source
from companion.errors import InputError
from companion.recording.content import ENDED, ENGAGED, Topic
from companion.recording.observation import finite
from companion.recording.read import Recording, log_line, open_recording
from companion.text_table import columns

NEAR_M = 0.15
"""Below d_s by more than this counts as too near: so far a good law may swing."""


@dataclass(frozen=True, slots=True)
class Spread:
    """How a quantity was distributed; in the unit of its name."""

    median: float
    p99: float
    largest: float


@dataclass(frozen=True, slots=True)
class Figures:
    """What a recording says of its flight. ``None``: the recording does not say.

    Attributes:
        file: the recording.
        damage: why it could not be read to its end.
        versions: of the software that flew.
        recorded_s: time from the first tick to the last.
        ticks: how many are recorded.
        ticks_dropped, frames_dropped: what the recorder had to leave out.
        engaged_s: time from taking control to its end, or to the last tick where the recording is cut.
        ended: what the recording says of the end.
        setpoints: setpoints sent in that time.
        setpoint_rate_hz: those per second.
        setpoint_interval_s: time from one to the next, the edges of the time included.
        depth_age_s, ranges_age_s, pose_age_s: ages of the inputs when their setpoint went out.
        tick_s: duration of all ticks.
        cpu_share: processor time over time with all children: 1 is one core.
        memory_mb: resident memory with all children.
        least_d_m: least measured d while in control.
        margin_m: d_s of the configuration.
        near_s: time in control with d below d_s - 0.15 m.
        mode_changes: of the navigator while in control.
        wall_clock_step_s: how far the wall clock was set during the flight.
    """

    file: str
    damage: str | None
    versions: dict[str, str]
    recorded_s: float
    ticks: int
    ticks_dropped: int
    frames_dropped: int
    engaged_s: float | None
    ended: str | None
    setpoints: int
    setpoint_rate_hz: float | None
    setpoint_interval_s: Spread | None
    depth_age_s: Spread | None
    ranges_age_s: Spread | None
    pose_age_s: Spread | None
    tick_s: Spread | None
    cpu_share: Spread | None
    memory_mb: Spread | None
    least_d_m: float | None
    margin_m: float | None
    near_s: float | None
    mode_changes: int
    wall_clock_step_s: float | None


def figures(path: Path) -> Figures:
    """The figures of a recording, also of one that is cut.

    Raises:
        InputError: the file is no recording of a flight.
    """
    recording = open_recording(path)
    seen = _Seen(recording)
    damage: str | None = None
    for entry in recording.entries():
        try:
            if entry.topic == Topic.TICK:
                seen.tick(entry.json())
            elif entry.topic == Topic.PROCESS:
                seen.process(entry.json())
            elif entry.topic == Topic.LOG:
                line = log_line(entry)
                seen.event((entry.t_ns - recording.wall_ns) / 1e9 + recording.start_s, line.name, line.text)
        except (ValueError, KeyError, TypeError, OverflowError) as error:
            damage = f"{entry.topic}: {error}"
            break
    return seen.figures(damage or recording.damage)


def show_figures(file: Path, as_json: bool) -> str:
    """What `companion figures FILE [--json]` prints.

    Raises:
        InputError: the file is no recording of a flight.
    """
    found = figures(file)
    return json.dumps(asdict(found), indent=2) if as_json else render(found)


def render(found: Figures) -> str:
    """The figures as a table for people."""
    rows = [
        ("file", found.file),
        ("read", "to its end" if found.damage is None else f"up to the cut ({found.damage})"),
        ("version", found.versions.get("mine-companion", "-")),
        ("recorded", f"{found.recorded_s:.1f} s, {found.ticks} ticks"),
        ("left out", f"{found.ticks_dropped} ticks and events, {found.frames_dropped} depth images"),
        ("in control", "never" if found.engaged_s is None else f"{found.engaged_s:.1f} s, {found.ended or 'no end'}"),
        ("setpoints", f"{found.setpoints} sent, {_text(found.setpoint_rate_hz, 'Hz', 2)}"),
        ("  interval", _spread(found.setpoint_interval_s, 1e3, "ms")),
        ("age of depth", _spread(found.depth_age_s, 1e3, "ms")),
        ("age of ranges", _spread(found.ranges_age_s, 1e3, "ms")),
        ("age of pose", _spread(found.pose_age_s, 1e3, "ms")),
        ("tick", _spread(found.tick_s, 1e3, "ms")),
        ("processor", _spread(found.cpu_share, 100.0, "% of a core")),
        ("memory", _spread(found.memory_mb, 1.0, "MB")),
        ("least d", f"{_text(found.least_d_m, 'm', 2)} (d_s {_text(found.margin_m, 'm', 2)})"),
        (f"d < d_s - {NEAR_M:g} m", f"{_text(found.near_s, 's', 1)}"),
        ("mode changes", str(found.mode_changes)),
        ("wall clock set by", _text(found.wall_clock_step_s, "s", 3)),
    ]
    return "\n".join(columns(rows, left=(0, 1)))


@dataclass
class _Seen:
    """Gathers while the recording is read once."""

    recording: Recording
    ticks: list[dict[str, Any]] = field(default_factory=list)
    spans: list[list[float]] = field(default_factory=list)
    cpu_share: list[float] = field(default_factory=list)
    memory_mb: list[float] = field(default_factory=list)
    dropped: tuple[int, int] = (0, 0)
    wall_steps_s: list[float] = field(default_factory=list)
    ended: str | None = None

    def tick(self, tick: dict[str, Any]) -> None:
        kept = {name: finite(tick[name]) for name in ("d_m", "depth_age_s", "ranges_age_s", "pose_age_s", "duration_s")}
        self.ticks.append(kept | {"t_s": float(tick["t_s"]), "sent": bool(tick["sent"]), "mode": str(tick["mode"])})

    def process(self, process: dict[str, Any]) -> None:
        self.dropped = (int(process["ticks_dropped"]), int(process["frames_dropped"]))
        self.wall_steps_s.append(float(process["wall_clock_steps_s"]))
        if "cpu_share" in process:
            self.cpu_share.append(float(process["cpu_share"]) + float(process["children_cpu_share"]))
            self.memory_mb.append(float(process["memory_mb"]) + float(process["children_memory_mb"]))

    def event(self, t_s: float, name: str, text: str) -> None:
        open_span = bool(self.spans) and math.isinf(self.spans[-1][1])
        if name == ENGAGED and not open_span:
            self.spans.append([t_s, math.inf])
        elif name == ENDED and open_span:
            self.spans[-1][1] = t_s
            self.ended = text

    def figures(self, damage: str | None) -> Figures:
        times = [tick["t_s"] for tick in self.ticks if math.isfinite(tick["t_s"])]
        last_s = max(times, default=self.recording.start_s)
        spans = [(start, min(end, max(last_s, start))) for start, end in self.spans]
        engaged_s = sum(end - start for start, end in spans) if spans else None
        within = [[tick for tick in self.ticks if start <= tick["t_s"] < end] for start, end in self.spans]
        sent = [[tick["t_s"] + (tick["duration_s"] or 0.0) for tick in ticks if tick["sent"]] for ticks in within]
        intervals = [
            gap for (start, end), moments in zip(spans, sent, strict=True) for gap in _gaps(start, moments, end)
        ]
        setpoints = sum(len(moments) for moments in sent)
        steered = [tick for ticks in within for tick in ticks if tick["sent"]]
        margin_m = _margin_m(self.recording.info.settings_yaml)
        distances = [tick["d_m"] for ticks in within for tick in ticks if tick["d_m"] is not None]
        return Figures(
            file=str(self.recording.path),
            damage=damage,
            versions=self.recording.info.versions,
            recorded_s=last_s - min(times, default=last_s),
            ticks=len(self.ticks),
            ticks_dropped=self.dropped[0],
            frames_dropped=self.dropped[1],
            engaged_s=engaged_s,
            ended=self.ended,
            setpoints=setpoints,
            setpoint_rate_hz=setpoints / engaged_s if engaged_s else None,
            setpoint_interval_s=_spread_of(intervals),
            depth_age_s=_spread_of(tick["depth_age_s"] for tick in steered),
            ranges_age_s=_spread_of(tick["ranges_age_s"] for tick in steered),
            pose_age_s=_spread_of(tick["pose_age_s"] for tick in steered),
            tick_s=_spread_of(tick["duration_s"] for tick in self.ticks),
            cpu_share=_spread_of(self.cpu_share),
            memory_mb=_spread_of(self.memory_mb),
            least_d_m=min(distances, default=None),
            margin_m=margin_m,
            near_s=None if margin_m is None or not spans else sum(_near_s(ticks, margin_m) for ticks in within),
            mode_changes=sum(a["mode"] != b["mode"] for ticks in within for a, b in itertools.pairwise(ticks)),
            wall_clock_step_s=max(self.wall_steps_s, key=abs, default=None),
        )


def _gaps(start_s: float, moments: Sequence[float], end_s: float) -> list[float]:
    """Times without a setpoint; what lies before the first and after the last counts too, unless it is shorter."""
    if not moments:
        return [end_s - start_s]
    gaps: list[float] = np.diff(moments).tolist()
    typical_s = float(np.median(gaps)) if gaps else 0.0
    return gaps + [edge for edge in (moments[0] - start_s, end_s - moments[-1]) if edge > typical_s]


def _near_s(ticks: Sequence[dict[str, Any]], margin_m: float) -> float:
    return math.fsum(
        after["t_s"] - tick["t_s"]
        for tick, after in itertools.pairwise(ticks)
        if tick["d_m"] is not None and tick["d_m"] < margin_m - NEAR_M
    )


def _spread_of(values: Iterable[float | None]) -> Spread | None:
    known = [known for value in values if (known := finite(value)) is not None]
    if not known:
        return None
    median, p99 = np.percentile(known, (50.0, 99.0))
    return Spread(float(median), float(p99), max(known))


def _margin_m(settings_yaml: str) -> float | None:
    """d_s. Read as plain YAML: settings of another version may not be valid in this one."""
    try:
        return float(Source("settings", settings_yaml).data["control"]["margin_m"])
    except (InputError, KeyError, TypeError, ValueError):
        return None


def _spread(spread: Spread | None, scale: float, unit: str) -> str:
    if spread is None:
        return "-"
    parts = (("median", spread.median), ("p99", spread.p99), ("largest", spread.largest))
    return ", ".join(f"{name} {value * scale:.1f}" for name, value in parts) + f" {unit}"


def _text(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"
