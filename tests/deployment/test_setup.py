"""The set-up that everybody and continuous integration use."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = Path(sys.executable).with_name("uv")


def lines(file: str) -> list[str]:
    return (ROOT / file).read_text(encoding="utf-8").splitlines()


def make(*arguments: str) -> str:
    """What make prints; the make that runs these tests must not pass its own options on."""
    environment = {"PATH": os.environ["PATH"]}
    command = ["make", *arguments]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("script", [".ci/run", "scripts/setup", "scripts/check"])
def test_scripts_are_executable_and_parse(script: str) -> None:
    assert os.access(ROOT / script, os.X_OK)
    subprocess.run(["bash", "-n", ROOT / script], check=True)


def test_continuous_integration_runs_what_people_run() -> None:
    assert "exec make test </dev/null" in lines(".ci/run")


@pytest.mark.parametrize(
    ("target", "command"),
    [
        ("explore", ".venv/bin/companion sim --world complex"),
        ("fly", ".venv/bin/companion sitl fly"),
        ("ground", ".venv/bin/companion sitl ground"),
        ("test", "scripts/check"),
        ("format", ".venv/bin/ruff format ."),
    ],
)
def test_each_target_prepares_what_it_needs(target: str, command: str) -> None:
    planned = make("--dry-run", target).splitlines()
    assert planned[0] == "scripts/setup"
    assert planned[-1].strip() == command


def test_make_alone_lists_the_targets() -> None:
    names = re.findall(r"^make ([\w-]+)", make(), re.MULTILINE)
    flights = ["explore", "fly", "ground", "test", "test-flights", "test-safety", "test-real", "mutants"]
    assert names == ["help", "setup", *flights, "check-docker", "format"]


def test_packages_come_from_the_python_package_index_alone() -> None:
    addresses = re.findall(r'https?://[^/"]+', "\n".join(lines("uv.lock")))
    assert set(addresses) == {"https://pypi.org", "https://files.pythonhosted.org"}


@pytest.mark.skipif(not UV.exists(), reason="uv is not in this virtual environment")
def test_lock_fits_the_project() -> None:
    checked = subprocess.run(
        [UV, "lock", "--check", "--offline"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if "network" in checked.stderr.lower() or "offline" in checked.stderr.lower():
        pytest.skip("uv needs the network to tell")
    assert checked.returncode == 0, checked.stderr


def test_import_contracts_name_packages_that_exist() -> None:
    contracts = tomllib.loads("\n".join(lines("pyproject.toml")))["tool"]["importlinter"]["contracts"]
    assert contracts
    for contract in contracts:
        for module in contract.get("source_modules") or contract["containers"]:
            assert (ROOT / module.replace(".", "/") / "__init__.py").exists(), f"{contract['name']}: {module}"


class TestRefusals:
    """A system that cannot be prepared is told so before anything is installed."""

    @pytest.fixture
    def copy(self, tmp_path: Path) -> Path:
        folder = tmp_path / "a folder with spaces"
        (folder / "scripts").mkdir(parents=True)
        for file in ("scripts/setup", "pyproject.toml", "uv.lock"):
            shutil.copy(ROOT / file, folder / file)
        return folder

    @staticmethod
    def refusal(copy: Path, **fakes: str) -> str:
        """What scripts/setup says where the named programs are replaced by shell scripts."""
        for name, script in fakes.items():
            fake = copy / "bin" / name
            fake.parent.mkdir(exist_ok=True)
            fake.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
            fake.chmod(0o755)
        done = subprocess.run(
            [copy / "scripts" / "setup"],
            env={"PATH": f"{copy / 'bin'}:/usr/bin:/bin"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 1
        assert not (copy / ".venv").exists()
        return done.stderr

    def test_old_glibc(self, copy: Path) -> None:
        assert "glibc 2.35 or newer, and this system has 2.31" in self.refusal(copy, getconf="echo glibc 2.31")

    def test_no_glibc(self, copy: Path) -> None:
        assert "this system has none" in self.refusal(copy, getconf="exit 1")

    def test_other_processor(self, copy: Path) -> None:
        assert "processor type riscv64" in self.refusal(copy, uname='[ "$1" = -m ] && echo riscv64 || echo Linux')

    def test_other_system(self, copy: Path) -> None:
        assert "for Linux; on Darwin" in self.refusal(copy, uname="echo Darwin")

    def test_no_python_that_is_new_enough(self, copy: Path) -> None:
        old = dict.fromkeys(["python3", *(f"python3.{minor}" for minor in range(11, 15))], "exit 1")
        assert "Python 3.11 to 3.14 is needed" in self.refusal(copy, getconf="echo glibc 2.36", **old)
