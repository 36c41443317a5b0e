"""Who may command from a page that others in the network can open: who has typed the code that the program printed."""

from __future__ import annotations

import hmac
import secrets
import threading
import time
from collections.abc import Callable

import viser

_PAUSE_S = 3.0
"""After a wrong code nobody's is looked at for so long: a million codes then take a month."""


def new_code() -> str:
    """Six digits that nobody can guess."""
    return f"{secrets.randbelow(10**6):06d}"


class Access:
    """Those who may command.

    Args:
        code: what they have to type once; None: everybody who has the page open may.
        now_s: monotonic time.
    """

    def __init__(self, code: str | None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._code = code
        self._now_s = now_s
        self._lock = threading.Lock()
        self._admitted: set[int] = set()
        self._not_before_s = -float("inf")

    def has(self, client: viser.ClientHandle) -> bool:
        """Whether this one may."""
        return self._code is None or client.client_id in self._admitted

    def forget(self, client: viser.ClientHandle) -> None:
        """It has closed the page."""
        with self._lock:
            self._admitted.discard(client.client_id)

    def admit(self, client_id: int, code: str) -> str:
        """Look at a code; what is wrong with it, empty when it is right."""
        with self._lock:
            now_s = self._now_s()
            if now_s < self._not_before_s:
                return f"wait {self._not_before_s - now_s:.0f} s after a wrong code"
            if self._code is None or not hmac.compare_digest(code.strip().encode(), self._code.encode()):
                self._not_before_s = now_s + _PAUSE_S
                return "this is not the code that `companion ground` printed when it began"
            self._admitted.add(client_id)
            return ""

    def ask_for_code(self, client: viser.ClientHandle) -> None:
        """Let somebody type the code. STOP needs none."""
        modal = client.gui.add_modal("Code for commands")
        with modal:
            client.gui.add_markdown(
                "Whoever commands types the code once that `companion ground` printed when it began. STOP needs none."
            )
            code = client.gui.add_text("code", "")
            wrong = client.gui.add_markdown("")
            done = client.gui.add_button("Let me command", color="blue")
            away = client.gui.add_button("Only watch", color="gray")

        @done.on_click
        def _(_: object) -> None:
            why = self.admit(client.client_id, code.value)
            if why:
                wrong.content = f"**{why}**"
            else:
                modal.close()

        @away.on_click
        def _(_: object) -> None:
            modal.close()
