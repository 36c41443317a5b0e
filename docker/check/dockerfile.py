"""Reads a Dockerfile as far as ours go: stages, and their instructions with continued lines joined."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

KNOWN = frozenset(
    ("ADD", "ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "FROM", "HEALTHCHECK", "LABEL", "RUN", "STOPSIGNAL", "USER")
) | {"WORKDIR"}


class DockerfileError(Exception):
    """The file holds something that is wrong, or that this reader does not know."""


@dataclass(frozen=True)
class Instruction:
    """One instruction of a stage.

    Attributes:
        line: where it begins, from 1.
        name: in capitals.
        text: what follows, continued lines joined by a blank, without its flags.
        flags: `--name=value`, in order.
    """

    line: int
    name: str
    text: str
    flags: tuple[tuple[str, str], ...] = ()

    def words(self) -> list[str]:
        """The text as an exec form, or cut at blanks."""
        return [str(word) for word in json.loads(self.text)] if self.text.startswith("[") else self.text.split()


@dataclass(frozen=True)
class Stage:
    """From one FROM to the next.

    Attributes:
        base: another stage, or an image, with arguments filled in.
    """

    name: str
    base: str
    instructions: list[Instruction] = field(default_factory=list)


@dataclass(frozen=True)
class Dockerfile:
    """The whole file: arguments before the first stage, and the stages by name, in order."""

    arguments: dict[str, str]
    stages: dict[str, Stage]

    def lineage(self, stage: str) -> list[Stage]:
        """The stages that a stage is made of, the outermost base first."""
        chain: list[Stage] = []
        name = stage
        while name in self.stages:
            chain.insert(0, self.stages[name])
            name = self.stages[name].base
        return chain


def read(file: Path) -> Dockerfile:
    """The stages of a Dockerfile.

    Raises:
        DockerfileError: what is wrong, with the line.
    """
    arguments: dict[str, str] = {}
    stages: dict[str, Stage] = {}
    stage: Stage | None = None
    for instruction in _instructions(file.read_text(encoding="utf-8")):
        if instruction.name == "FROM":
            match = re.fullmatch(r"(\S+)(?: AS (\S+))?", instruction.text)
            if match is None or match[2] is None or match[2] in stages:
                raise DockerfileError(f"{file}:{instruction.line}: FROM needs a base and a name of its own")
            stage = Stage(match[2], fill(match[1], arguments))
            stages[stage.name] = stage
        elif stage is not None:
            stage.instructions.append(instruction)
        elif instruction.name == "ARG":
            name, _, value = instruction.text.partition("=")
            arguments[name] = value.strip('"')
        else:
            raise DockerfileError(f"{file}:{instruction.line}: {instruction.name} before the first FROM")
    return Dockerfile(arguments, stages)


def fill(text: str, values: dict[str, str]) -> str:
    """``${NAME}`` replaced by its value; one that is unknown is an error."""

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise DockerfileError(f"${{{match[1]}}} has no value")
        return values[match[1]]

    return re.sub(r"\$\{(\w+)\}", value, text)


def assignments(text: str) -> dict[str, str]:
    """What ENV sets. No value of ours holds a blank."""
    return dict(word.split("=", 1) for word in text.split())


def _instructions(text: str) -> list[Instruction]:
    found: list[Instruction] = []
    parts: list[str] = []
    began = 0
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        began = began if parts else number
        parts.append(line.strip().removesuffix("\\").rstrip())
        if not line.endswith("\\"):
            found.append(_instruction(began, " ".join(parts)))
            parts = []
    if parts:
        raise DockerfileError(f"line {began}: the last instruction is not finished")
    return found


def _instruction(line: int, text: str) -> Instruction:
    name, _, rest = text.partition(" ")
    if name not in KNOWN:
        raise DockerfileError(f"line {line}: {name} is not an instruction that this reader knows")
    flags: list[tuple[str, str]] = []
    rest = rest.strip()
    while match := re.match(r"--([a-z-]+)=(\S+)\s+", rest):
        flags.append((match[1], match[2]))
        rest = rest[match.end() :]
    return Instruction(line, name, rest, tuple(flags))
