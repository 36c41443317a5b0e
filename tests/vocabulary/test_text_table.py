"""Texts from the wire: nothing in them steers the terminal of whoever reads them."""

from __future__ import annotations

import pytest

from companion.text_table import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Arming denied", "Arming denied"),
        ("\x1b[2J gone", "[2J gone"),
        ("two\nlines\ttab", "two lines tab"),
        ("\u202eright to left", "right to left"),
        ("", ""),
    ],
)
def test_only_what_can_be_printed_is_left_of_a_text(text: str, shown: str) -> None:
    assert printable(text) == shown
