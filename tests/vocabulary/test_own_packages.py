"""Packages of others on PYTHONPATH: left out when they have a name of ours, and said."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from companion.own_packages import leave_out_foreign


def package(folder: Path, name: str) -> Path:
    """A package that cannot be imported."""
    (folder / name).mkdir(parents=True)
    (folder / name / "__init__.py").write_text("raise ImportError('somebody else')\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("name", ["numpy", "typer", "pydantic"])
def test_the_command_works_and_names_what_is_foreign(tmp_path: Path, name: str) -> None:
    """Protects whoever has sourced ROS or another project: before, a traceback from inside of a library."""
    path = os.pathsep.join((str(package(tmp_path / "foreign", name)), str(tmp_path)))
    ended = subprocess.run(
        [sys.executable, "-m", "companion", "safety", "budget"],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Straight at a wall" in ended.stdout
    assert ended.stderr.startswith(
        f"companion: PYTHONPATH: {tmp_path / 'foreign'} is left out: it holds another {name} "
    )
    assert ended.stderr.count("\n") == 1


def test_what_is_nobodys_package_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects a driver that is found by PYTHONPATH, and who names the folder of our own packages."""
    (tmp_path / "numpy").mkdir()  # without an __init__ it is not what `import numpy` finds
    own = package(package(tmp_path / "mine", "my_driver"), "tests")
    before = os.pathsep.join((str(tmp_path), str(own), str(tmp_path / "gone"), sysconfig.get_path("purelib")))
    monkeypatch.setenv("PYTHONPATH", before)
    assert leave_out_foreign() == []
    assert os.environ["PYTHONPATH"] == before


def test_children_do_not_have_it_either(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the gate, the application and the map, which are processes of their own."""
    foreign = package(package(tmp_path / "foreign", "numba"), "numpy")
    (tmp_path / "mine").mkdir()
    (foreign / "yaml.py").touch()
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(foreign), str(tmp_path / "mine"))))
    before = list(sys.path)
    monkeypatch.setattr(sys, "path", [str(foreign), str(tmp_path / "mine"), *before])
    (said,) = leave_out_foreign()
    assert "another numba and 2 more than" in said
    assert os.environ["PYTHONPATH"] == str(tmp_path / "mine")
    assert sys.path == [str(tmp_path / "mine"), *before]
