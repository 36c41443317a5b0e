"""Where the command `companion` begins: before anything is imported that could be somebody else's."""

from __future__ import annotations

import os
import sys

from companion.own_packages import leave_out_foreign


def main() -> None:
    """Leave out foreign packages, then run the command: see `companion.cli.main.main`."""
    try:
        for line in leave_out_foreign():
            os.write(2, f"companion: {line}\n".encode(errors="replace"))
        from companion.cli.main import main as run_command
        from companion.interruption import signals_kill
    except KeyboardInterrupt:
        # 128 + SIGINT, as the command itself ends: it was not loaded yet.
        sys.exit(130)
    try:
        run_command()
    finally:
        signals_kill()
