"""The documents name only what exists: links, files, modules, and commands with their options."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import entry_points
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from companion.cli import main

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    [*(ROOT / "docs").glob("*.md"), ROOT / "docker" / "README.md"]
    + [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")]
)
FOLDERS = "companion|sitl|docs|docker|tests|validation|bench|scripts"

document = pytest.mark.parametrize("page", DOCUMENTS, ids=lambda page: str(page.relative_to(ROOT)))


@cache
def files() -> tuple[str, ...]:
    """Every file of the project, and every folder with a slash at its end."""
    asked = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    folders = {f"{parent}/" for file in listed for parent in Path(file).parents if str(parent) != "."}
    return (*listed, *sorted(folders))


def exists(path: str) -> bool:
    """Whether a path is there, from the root or as the end of one: `gate/gate.py`, `laws.py`, `docker/simulated.*`."""
    pattern = re.escape(path.removesuffix("/")).replace(r"\*", "[^/]*")
    return any(re.search(rf"(^|/){pattern}/?$", file) for file in files())


def shell(text: str) -> str:
    """The blocks that show what people type: those without a language."""
    return "\n".join(re.findall(r"^```\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))


def spans(text: str) -> list[str]:
    """What stands between backticks in running text."""
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose)


def paths(text: str) -> Iterator[str]:
    for word in spans(text):
        if re.fullmatch(rf"({FOLDERS}|\.ci|\.github)/[\w./*-]*[a-z*]/?|[\w./-]+\.py", word):
            yield word
    yield from re.findall(rf"(?<![\w/.-])(?:{FOLDERS})/[\w./*-]*\w", shell(text))


@document
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if not re.match(r"https?:", target):
            assert (page.parent / target.partition("#")[0]).exists(), target


def test_the_index_leads_to_every_page() -> None:
    index = (ROOT / "docs" / "index.md").read_text("utf-8")
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"index.md"}
    assert pages <= set(re.findall(r"\]\(([^)\s]+)\)", index))


def test_the_diagram_of_the_rooms_is_the_import_contract() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    drawn: dict[str, list[set[str]]] = {"companion": [], "sitl": []}
    for line in re.findall(r"^│ .*$", page.partition("## Rooms")[2].partition("```\n\n")[0], re.MULTILINE):
        for package, boxes in zip(drawn, re.split(r"│ {7}│", line), strict=False):
            if rooms := {room.strip() for room in boxes.split("│")} - {""}:
                drawn[package].append(rooms)
    wanted = {contract["containers"][0]: contract["layers"] for contract in contracts if contract["type"] == "layers"}
    assert drawn == {
        package: [{room.strip() for room in layer.split("|")} for layer in layers] for package, layers in wanted.items()
    }


@document
def test_files_are_there(page: Path) -> None:
    missing = [path for path in paths(page.read_text("utf-8")) if not exists(path)]
    assert not missing


@document
def test_modules_can_be_run_and_imported(page: Path) -> None:
    text = page.read_text("utf-8")
    for name in re.findall(r"python -m ([\w.]*\w)", text):
        found = importlib.util.find_spec(name)
        assert found is not None, f"python -m {name}"
        assert not found.submodule_search_locations or importlib.util.find_spec(f"{name}.__main__"), f"python -m {name}"
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]
    for name in spans(text):
        # Schemas of recordings are named companion.Tick and so on.
        if re.fullmatch(r"(companion|sitl|bench|validation)(\.[a-z_]\w*)+", name) and not (
            name in groups or exists(name)
        ):
            assert importlib.util.find_spec(name), name


def commands(text: str) -> Iterator[str]:
    """Command lines of ours: `companion map info|export` is two of them."""
    lines = [line for line in shell(text).splitlines() if not line.lstrip().startswith("#")] + spans(text)
    for line in lines:
        found = re.match(
            r"(?:.*(?<![\w-])(?:\$|exec|pilot@vehicle|\.venv/bin/)\s*)?(?:\S*/)?companion ([a-z].*)", line.strip()
        )
        if found:
            typed = found[1].partition("  #")[0].replace("\\|", "|")
            yield from map(" ".join, product(*(word.split("|") for word in typed.split())))


def test_what_is_looked_for_is_found() -> None:
    """A pattern that matches nothing would let everything pass."""
    text = "`gate/gate.py`, `companion map a|b --c`\n```\n$ .venv/bin/companion run  # docs/x\ncat docker/y.z\n```\n"
    assert list(paths(text)) == ["gate/gate.py", "docs/x", "docker/y.z"]
    assert list(commands(text)) == ["run", "map a --c", "map b --c"]
    assert exists("gate/gate.py")
    assert not exists("gate/gat.py")


@cache
def application(called: str) -> Any:
    """The whole command line, as click has it; of the commands from elsewhere only this one is imported."""
    found = {entry.name: entry for entry in entry_points(group=main.COMMANDS_GROUP)}
    return typer.main.get_command(main._app(found, called))


@document
def test_commands_exist_with_their_options(page: Path) -> None:
    for line in commands(page.read_text("utf-8")):
        words = line.split()
        command = application(words[0])
        while hasattr(command, "commands") and words and not words[0].startswith("-"):
            assert words[0] in command.commands, f"companion {line}"
            command = command.commands[words.pop(0)]
        known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        asked = {word.partition("=")[0].strip(".,;:") for word in words if re.match(r"--[a-z]", word)}
        assert asked <= known | {"--help"}, f"companion {line}"


def test_make_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    for page in DOCUMENTS:
        text = page.read_text("utf-8")
        named = [*spans(text), *shell(text).splitlines()]
        assert {found[1] for line in named if (found := re.match(r"make ([a-z-]+)", line))} <= targets, page.name


def test_the_workflow_runs_what_people_run_and_may_change_nothing() -> None:
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "check.yml").read_text("utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["timeout-minutes"] <= 120
        assert [step["run"] for step in job["steps"] if "run" in step] == [".ci/run"]
        (python,) = (step["with"] for step in job["steps"] if "setup-python" in step.get("uses", ""))
        assert python == {"python-version": "3.12"}


def test_the_citation_is_of_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert (citation["title"], citation["version"], citation["license"]) == (
        project["name"],
        project["version"],
        project["license"],
    )
