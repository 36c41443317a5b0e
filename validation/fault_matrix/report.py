"""The table of the matrix, as docs/ shows it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

from companion.mapping.files.whole import whole_file
from validation.fault_matrix.faults import BY_NAME
from validation.fault_matrix.outcome import AIM_S, Outcome

DOCS = Path(__file__).parents[2] / "docs" / "safety.md"
BEGIN, END = "<!-- matrix:begin -->", "<!-- matrix:end -->"
_HEADER = (
    "| fault | autopilot | speed, m/s | to brake, s | travelled, m | least distance, m | in the end |",
    "|---|---|---:|---:|---:|---:|---|",
)


class ReportError(Exception):
    """The table cannot be put where it belongs."""


def markdown(outcomes: Sequence[Outcome]) -> str:
    """The summary, the worst first, and one table for each group of faults."""
    parts = [_summary(outcomes)]
    for group, found in itertools.groupby(outcomes, key=lambda outcome: outcome.group):
        rows = list(found)
        parts.append("\n".join([f"### {group.capitalize()}", "", *_HEADER, *map(_row, rows)]))
        meanings = {one.name: BY_NAME[one.name].what for one in rows if one.name in BY_NAME}
        parts.append("\n".join(f"- {name}: {what}." for name, what in meanings.items()))
    return "\n\n".join(parts)


def write_into_docs(outcomes: Sequence[Outcome], file: Path = DOCS) -> None:
    """Replace what stands between the two marks.

    Raises:
        ReportError: they are not there.
    """
    text = file.read_text(encoding="utf-8") if file.exists() else ""
    before, begins, rest = text.partition(BEGIN)
    _, ends, behind = rest.partition(END)
    if not begins or not ends:
        raise ReportError(f"{file} has no place for the table: {BEGIN} ... {END}")
    with whole_file(file) as new:
        new.write(f"{before}{BEGIN}\n{markdown(outcomes)}\n{END}{behind}".encode())


def _summary(outcomes: Sequence[Outcome]) -> str:
    faults = len({outcome.name for outcome in outcomes})
    contacts = sum(outcome.contacts for outcome in outcomes)
    failed = [outcome for outcome in outcomes if not outcome.ok]
    stopped = [one for one in outcomes if _slowness_s(one) > -math.inf]
    lines = [
        f"{faults} faults, {len(outcomes)} flights, {contacts} contacts; "
        f"{len(outcomes) - len(failed)} ended as they must.",
        f"- Nearest to a wall: {_named(min(outcomes, key=lambda one: _or(one.least_m, math.inf)), 'least_m')} m.",
        f"- Furthest after the fault: "
        f"{_named(max(outcomes, key=lambda one: _or(one.travelled_m, -math.inf)), 'travelled_m')} m.",
    ]
    if stopped:
        slowest = max(stopped, key=_slowness_s)
        late = [one for one in outcomes if _slowness_s(one) > AIM_S]
        lines.append(
            f"- Slowest to brake where a stop was needed: {_named(slowest, 'brake_s')} s beyond the configured limit; "
            f"flights above the aim of {AIM_S:g} s: {len(late)}."
        )
    lines += [f"- **Failed:** {one.name} ({one.personality}): {one.problem}." for one in failed]
    return "\n".join([lines[0], "", *lines[1:]])


def _slowness_s(outcome: Outcome) -> float:
    fault = BY_NAME.get(outcome.name)
    needed = fault is not None and fault.needs_stop
    return outcome.brake_s if needed and outcome.brake_s is not None else -math.inf


def _named(outcome: Outcome, figure: str) -> str:
    return f"{getattr(outcome, figure):.2f} ({outcome.name}, {outcome.personality})"


def _or(value: float, otherwise: float) -> float:
    return otherwise if math.isnan(value) else value


def _row(outcome: Outcome) -> str:
    fault = BY_NAME.get(outcome.name)
    brake = "-" if outcome.brake_s is None else f"{outcome.brake_s:.2f}"
    if fault is not None and not fault.needs_stop:
        brake = f"({brake})" if outcome.brake_s is not None else "-"
    final = outcome.final.value if outcome.ok else f"**{outcome.problem}**"
    figures = (f"{outcome.speed_mps:.2f}", brake, f"{outcome.travelled_m:.2f}", f"{outcome.least_m:.2f}", final)
    return f"| {' | '.join((outcome.name, outcome.personality, *figures))} |"
