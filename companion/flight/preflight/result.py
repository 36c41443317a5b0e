"""Result of a check, and its rendering for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from companion.text_table import wrapped

_INDENT = " " * 7


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One check.

    Attributes:
        name: as ``--skip`` takes it.
        ok: whether it passed.
        found: the value, in words.
        wanted: the value that passes.
        reason: why, in one sentence.
        fix: what to do; when --fix has done it, that it did. Empty when nothing is to be done.
        skipped: not looked at, because somebody said so; ``ok`` is False and stops nothing.
    """

    name: str
    ok: bool
    found: str
    wanted: str
    reason: str
    fix: str = ""
    skipped: bool = False

    @property
    def failed(self) -> bool:
        """Whether it stands in the way of a flight."""
        return not self.ok and not self.skipped


def age(age_s: float) -> str:
    """How old something is, in words."""
    return "never came" if math.isinf(age_s) else f"{age_s:.2f} s old"


def render(results: Sequence[CheckResult]) -> str:
    """The results as plain text of at most 110 columns: what was found, and why where something is to be done."""
    name_width = max((len(result.name) for result in results), default=0)
    lines: list[str] = []
    for result in results:
        mark = "skip" if result.skipped else "ok" if result.ok else "FAIL"
        line = f"{mark:<4}  {result.name:<{name_width}}  {result.found}"
        if not result.skipped:
            line += f" (wanted: {result.wanted})"
        lines += wrapped(line, " " * (name_width + 8))
        if result.failed:
            lines += wrapped(_INDENT + result.reason, _INDENT)
        if result.fix:
            lines += wrapped(f"{_INDENT}-> {result.fix}", _INDENT + "   ")
    failed = sum(result.failed for result in results)
    skipped = sum(result.skipped for result in results)
    passed = len(results) - failed - skipped
    lines.append(f"{passed} passed, {failed} failed, {skipped} skipped")
    return "\n".join(lines)


def refusal(results: Sequence[CheckResult]) -> str | None:
    """Why the vehicle must not be armed, naming every failed check; None when it may be."""
    failed = [result for result in results if result.failed]
    if not failed:
        return None
    what = "; ".join(f"{result.name}: {result.found}, wanted {result.wanted}" for result in failed)
    checks = "a pre-flight check" if len(failed) == 1 else f"{len(failed)} pre-flight checks"
    return f"not armed: {checks} failed: {what}. What to do stands above; --fix sets parameters, --skip NAME skips"
