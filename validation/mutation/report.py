"""What is left when all tests have run."""

from __future__ import annotations

import re
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from validation.mutation.changes import Mutant

DOCUMENT = "docs/safety-mutants.md"


@dataclass(frozen=True)
class Found:
    """One change and what became of it.

    Attributes:
        module: that was changed.
        name: as in the document; without the number of the line, which changes with every edit.
        line: its number.
        verdict: killed, timed out or survived.
    """

    module: str
    name: str
    line: int
    verdict: str

    @classmethod
    def of(cls, module: str, mutant: Mutant, verdict: str) -> Found:
        """Without the program, of which a thousand copies would fill the memory."""
        place = mutant.function or mutant.constant
        return cls(module, f"{module}.{place}: {_short(mutant.before)} → {_short(mutant.after)}", mutant.line, verdict)


def report(found: list[Found], folder: Path) -> int:
    """Print the table and every survivor; 1 when the document does not argue for one of them."""
    counted = Counter((one.module, one.verdict) for one in found)
    lines = ["", "| module | changes | killed | timed out | survived |", "|---|---|---|---|---|"]
    modules = dict.fromkeys(one.module for one in found)
    for module in modules:
        verdicts = [counted[module, verdict] for verdict in ("killed", "timed out", "survived")]
        lines.append("| " + " | ".join([f"`{module}`", *map(str, [sum(verdicts), *verdicts])]) + " |")
    total = [sum(counted[module, verdict] for module in modules) for verdict in ("killed", "timed out", "survived")]
    lines.append("| " + " | ".join(["all", *map(str, [sum(total), *total])]) + " |")
    known = argued(folder)
    survivors = [one for one in found if one.verdict == "survived"]
    new = [one for one in survivors if one.name not in known]
    lines += ["", f"{len(survivors) - len(new)} survivors are argued for in {DOCUMENT}, {len(new)} are not:"]
    lines += [f"  {one.name}  (line {one.line})" for one in new]
    gone = sorted(name for name in known - {one.name for one in survivors} if name.split(".")[0] in modules)
    lines += [f"argued for without need: {name}" for name in gone]
    sys.stdout.write("\n".join(lines) + "\n")
    return int(bool(new))


def argued(folder: Path) -> frozenset[str]:
    """The survivors that the document names, each in backquotes at the beginning of a point of a list."""
    path = folder / DOCUMENT
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return frozenset(re.findall(r"^- ``(.+?)``", text, re.MULTILINE))


def _short(text: str) -> str:
    return text if len(text) <= 110 else text[:107] + "..."
