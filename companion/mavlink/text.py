"""Texts that come from the wire."""

from __future__ import annotations


def printable(text: str) -> str:
    """A text from the wire as it may be shown: nothing in it steers a terminal, or is no character at all."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()
