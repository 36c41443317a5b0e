"""What a vehicle warns of, for an operator: the gate's faults in plain words, each once, with what to do."""

from __future__ import annotations

import re
from collections.abc import Sequence

from companion.gate.faults import Fault

MOST = 4
"""More are counted: a column of alarms hides the one that matters."""

CAUSES: dict[Fault, str] = {
    Fault.SETPOINT_LATE: "its computer is too slow",
    Fault.SETPOINT_BAD: "its computer asked for what is not allowed",
    Fault.BEAT_LATE: "its computer is too slow",
    Fault.DEPTH_STALE: "its camera is silent",
    Fault.RANGES_STALE: "its range sensor is silent",
    Fault.POSE_STALE: "its position does not come",
    Fault.POSE_JUMP: "its position has jumped",
    Fault.POSE_FROZEN: "its position is frozen",
    Fault.ESTIMATOR: "its autopilot does not know where it is",
    Fault.AIDING_LOST: "nothing tells its autopilot where it is",
    Fault.GPS_LOST: "its GPS is lost",
    Fault.ODOMETRY_SILENT: "its odometry is silent",
    Fault.NOT_OBEYED: "it does not do what it is asked",
    Fault.HEARTBEAT_LOST: "its autopilot is silent",
    Fault.LINK_LOST: "its autopilot is silent",
    Fault.DISTANCE: "it is too near to rock",
    Fault.FENCE: "it is at its fence",
    Fault.BATTERY: "its battery is low",
    Fault.GROUND_STOP: "a person ordered it",
    Fault.APPLICATION: "its program died",
    Fault.MAP: "its map does not answer",
    Fault.FLOOD: "its program sends too much",
}
"""Why the gate acts, as the end of a sentence."""

_STAGES = {
    "brake": "Its gate stops it: {}. It goes on by itself when that is over; otherwise it holds, then lands.",
    "hold": "Its gate holds it where it is: {}. This flight does not go on: land it, or take the transmitter.",
    "land": "Its gate lands it where it is: {}. Keep people away.",
}
_NOTICED = "Noticed: {}. Wait a moment; if it stays, send it home."

_PASSES = "gate: pass"
_STAGE = re.compile(r"gate: (brake|hold|land): (\w+)\b.*")
_FAULT = re.compile(r"gate: (\w+)( [-0-9.].*)?")


def in_plain_words(warnings: Sequence[str]) -> list[str]:
    """Warnings, the newest first, as people say them, the gravest first. What is not the gate's stays as it is."""
    passes = next((at for at, warning in enumerate(warnings) if warning.startswith(_PASSES)), len(warnings))
    # What the gate said before it let pass again is over.
    warnings = [warning for at, warning in enumerate(warnings) if at < passes or not warning.startswith("gate: ")]
    stage, stage_causes, noticed, others = "", [], [], []
    for warning in warnings:
        acts, sees = _STAGE.fullmatch(warning), _FAULT.fullmatch(warning)
        if acts is not None and (cause := _cause(acts[2])):
            if list(_STAGES).index(acts[1]) > (list(_STAGES).index(stage) if stage else -1):
                stage = acts[1]
            stage_causes.append(cause)
        elif sees is not None and (cause := _cause(sees[1])):
            noticed.append(cause)
        else:
            others.append(warning)
    found = []
    if stage:
        found.append(_STAGES[stage].format(_listed([*stage_causes, *noticed])))
    elif noticed:
        found.append(_NOTICED.format(_listed(noticed)))
    found += list(dict.fromkeys(others))
    more = len(found) - MOST
    return [*found[:MOST], f"And {more} more."] if more > 0 else found


def _cause(fault: str) -> str:
    return CAUSES.get(Fault(fault), "") if fault in set(Fault) else ""


def _listed(causes: Sequence[str]) -> str:
    *most, last = dict.fromkeys(causes)
    return f"{', '.join(most)} and {last}" if most else last
