"""Outcomes in a file: whole after every flight, so that an hour of flights can be broken off and gone on with."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from companion.mapping.files.whole import whole_file
from validation.fault_matrix.injection import Final
from validation.fault_matrix.outcome import Outcome

_MAY_BE_NONE = ("brake_s", "problem", "standing_s")


def write(file: Path | None, outcomes: Iterable[Outcome]) -> None:
    """Every outcome, into a file that was asked for."""
    write_whole(file, [_plain(one) for one in outcomes])


def write_whole(file: Path | None, results: list[dict[str, Any]]) -> None:
    """Whole or not at all, whenever it is broken off."""
    if file is None:
        return
    with whole_file(file) as new:
        new.write((json.dumps(results, indent=2) + "\n").encode())


def read(file: Path) -> dict[tuple[str, str], Outcome]:
    """The outcomes in a file by fault and personality; none when there is no file."""
    found: dict[tuple[str, str], Outcome] = {}
    for one in json.loads(file.read_text(encoding="utf-8")) if file.exists() else []:
        del one["ok"]
        unknown = {name: math.nan for name, value in one.items() if value is None and name not in _MAY_BE_NONE}
        lists = {name: tuple(one[name]) for name in ("gate", "texts")}
        outcome = Outcome(**(one | unknown | lists | {"final": Final(one["final"])}))
        found[outcome.name, outcome.personality] = outcome
    return found


def _plain(outcome: Outcome) -> dict[str, Any]:
    """JSON has no NaN."""
    values = dataclasses.asdict(outcome)
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in values.items()} | {
        "ok": outcome.ok
    }
