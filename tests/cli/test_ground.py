"""`companion ground` as it is typed: what is refused, what is printed, how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from sitl.launch.processes import free_tcp_port

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

from companion.cli import main as cli


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--connect", "nonsense"], "nonsense: is no endpoint"),
        (["--connect", "tcp/10.0.0.5:7447"], "only loopback"),
        (["--name", "a/b"], "--name 'a/b': an operator is called by"),
        (["--folder", __file__], "is no folder"),
        (["--certificates", "/nowhere"], "companion keys"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Protects the operator's first minute: one line that says what to change, and the code of wrong input."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        cli.main(["ground", "--port", str(free_tcp_port()), *arguments])
    assert ended.value.code in (1, 2)
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("host", "asks"),
    [("0.0.0.0", True), pytest.param("127.0.0.1", False, marks=pytest.mark.long)],  # noqa: S104 - what is tested
)
def test_it_serves_says_where_and_ends_by_ctrl_c(host: str, asks: bool, tmp_path: Path) -> None:
    """Protects the terminal, and the vehicle from visitors: where others can open the page there is a code."""
    port = free_tcp_port()
    listen = f"tcp/127.0.0.1:{free_tcp_port()}"
    with subprocess.Popen(
        [sys.executable, "-m", "companion", "ground", "--listen", listen, "--host", host, "--port", str(port)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2]), "PYTHONUNBUFFERED": "1"},
    ) as process:
        try:
            assert process.stdout is not None
            said = process.stdout.readline()
            assert f":{port}; Ctrl-C ends it, and the vehicles fly on" in said
            if asks:
                assert process.stdout.readline().startswith("code for commands: ")
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/") as answer:
                assert answer.status == 200
            process.send_signal(signal.SIGINT)
            printed, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert printed == ""
