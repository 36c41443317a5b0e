"""`companion map view` and the help, as far as they need no picture and no page."""

from __future__ import annotations

import socket
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.cli.maps import view as look
from tests.cli.maps.missions import Run


def test_the_help_waits_for_nothing() -> None:
    """Protects the help from the seconds that compiled code and a web server take to load."""
    program = (
        "import sys; from companion.cli import main as cli\n"
        "try: cli.main(['map', 'view', '--help'])\n"
        "except SystemExit:\n"
        "    print(sorted({'numba', 'viser', 'matplotlib', 'numpy'} & set(sys.modules)), file=sys.stderr)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stderr.strip() == "[]"
    assert "--picture" in ended.stdout


def test_a_missing_extra_is_named(run: Run, mission: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the user of a plain installation: what to install, and exit code 1."""
    for name in ("matplotlib", "viser"):
        monkeypatch.setitem(sys.modules, name, None)
    for module in ("page", "picture"):
        monkeypatch.delitem(sys.modules, f"companion.viewer.{module}", raising=False)
    for arguments in ((mission,), (mission, "--picture", tmp_path / "a.png")):
        code, _, errors = run("view", *arguments)
        assert code == 1
        assert f"needs pip install '{look.EXTRA}'" in errors
        assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("host", "typed"),
    [("127.0.0.1", "localhost"), ("0.0.0.0", socket.gethostname()), ("10.1.2.3", "10.1.2.3")],  # noqa: S104
)
def test_the_address_can_be_typed_into_a_browser(
    mission: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], host: str, typed: str
) -> None:
    """Protects whoever opens the map from another machine: 0.0.0.0 is listened at, but leads nowhere."""
    pytest.importorskip("viser", reason="pip install mine-companion[ground]")
    page = SimpleNamespace(port=8080, note="", wait=lambda: None)
    monkeypatch.setattr("companion.viewer.page.serve", lambda *_: nullcontext(page))
    look.show_in_browser(mission, host, 8080, 1000)
    assert capsys.readouterr().out == f"{mission}: open http://{typed}:8080; Ctrl-C ends it\n"
