"""The rows of a campaign as one Parquet file, which pandas, Polars, DuckDB and R read."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet

from companion.mapping.files.whole import whole_file
from sitl.campaign.mission import Row

TEXTS = (
    "world",
    "given_world",
    "preset",
    "case",
    "ended_because",
    "home_ended_because",
    "error",
    "error_details",
    "settings",
)
"""Columns that are texts even where no row has any."""


def write(rows: Sequence[Row], path: Path) -> None:
    """Write one row a mission, by number, replacing the file only once the new one is whole.

    Whole numbers, numbers, truth values and texts are columns of their type; what has parts is JSON. A column in which
    nothing is known is one of numbers.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    ordered = sorted(rows, key=lambda row: int(str(row["mission"])))
    names = dict.fromkeys(name for row in ordered for name in row)
    # Errors and settings last: whoever prints the table wants to see the figures.
    last = [name for name in ("error", "error_details", "settings") if name in names]
    columns = {name: _column(name, [row.get(name) for row in ordered]) for name in [*names] if name not in last}
    columns |= {name: _column(name, [row.get(name) for row in ordered]) for name in last}
    with whole_file(path) as file:
        parquet.write_table(pa.table(columns), file, compression="zstd")


def _column(name: str, values: list[object]) -> pa.Array:
    known = {type(value) for value in values if value is not None}
    if known <= {int} and known:
        return pa.array(values, pa.int64())
    if known <= {bool} and known:
        return pa.array(values, pa.bool_())
    if known <= {int, float} and name not in TEXTS:
        return pa.array([None if value is None else float(str(value)) for value in values], pa.float64())
    return pa.array([None if value is None else _text(value) for value in values], pa.string())


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
