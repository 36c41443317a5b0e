"""Plain text for terminals, logs and documents: aligned columns, wrapped lines, and what came over a wire.

Not rich: its tables follow the width of the terminal, and docs/ shows these byte for byte.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Sequence

WIDTH = 110


def columns(rows: Sequence[Sequence[str]], left: Collection[int] = (0,)) -> list[str]:
    """One line a row, its cells two spaces apart; flush right but for the columns in ``left``."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def wrapped(text: str, indent: str = "") -> list[str]:
    """Lines of at most `WIDTH` columns, those after the first with an indent."""
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent)


def printable(text: str) -> str:
    """A text from the wire as it may be shown: nothing in it steers a terminal, or is no character at all."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()
