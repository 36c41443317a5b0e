"""Errors that a person reads. Each says what is wrong, where, and what to do."""

from __future__ import annotations

EXIT_INTERRUPTED = 130
"""After Ctrl-C: 128 + SIGINT, as shells do."""


class CompanionError(Exception):
    """Base of every error that ends a command with one message instead of a traceback."""

    exit_code = 1


class InputError(CompanionError):
    """Something the user handed in cannot be used: configuration, mesh, recording, folder, argument."""

    exit_code = 2
