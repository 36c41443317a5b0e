"""The face for authors of drivers: light, stable, and as docs/drivers.md shows it."""

from __future__ import annotations

import asyncio
import dataclasses
import importlib
import inspect
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import companion.sensors as face
from companion.sensors import DriverContext, MonotonicClock, SensorDriver, SensorSink, Settings
from companion.sensors.drivers.driver import load_drivers
from companion.sensors.drivers.stream import StreamDriver

PAGE = Path(__file__).parents[2] / "docs" / "drivers.md"

FIELDS = {
    "Camera": "width_px height_px fx_px fy_px cx_px cy_px min_range_m max_range_m "
    "mount_x_m mount_y_m mount_z_m mount_yaw_rad mount_pitch_rad",
    "DriverContext": "clock link",
    "RangeReading": "beam t_s range_m max_range_m",
    "RawDepth": "t_s depth_m camera",
    "RawPlanar": "t_s bearings_rad ranges_m max_range_m",
}
"""What an author builds or takes apart, in order: they may be given by position."""

PARAMETERS = {
    "Clock.now_s": "self",
    "MonotonicClock.now_s": "self",
    "SensorDriver.run": "self sink",
    "SensorSink.__init__": "self clock",
    "SensorSink.depth": "self frame",
    "SensorSink.drop": "self stream reason",
    "SensorSink.planar": "self scan",
    "SensorSink.ranges": "self readings",
    "SensorSink.statistics": "self now_s",
    "SensorSink.take": "self",
    "StreamServer.__init__": "self url camera clock",
    "StreamServer.publish_depth": "self t_s depth_m",
    "StreamServer.publish_planar": "self t_s bearings_rad ranges_m max_range_m",
    "StreamServer.publish_ranges": "self readings",
    "load_settings": "file preset",
}

OTHER_NAMES = {"Beam", "DEPTH", "DriverFactory", "InputError", "PLANAR", "Settings"}


def test_the_names_are_these() -> None:
    """A name that goes breaks drivers that we have never seen; one that comes is kept for good."""
    assert set(face.__all__) == OTHER_NAMES | set(FIELDS) | {name.partition(".")[0] for name in PARAMETERS}
    assert (face.DEPTH, face.PLANAR, face.Beam("up")) == ("depth", "planar", face.Beam.UP)


@pytest.mark.parametrize("name", FIELDS)
def test_the_fields_are_these(name: str) -> None:
    """A new one comes at the end and has a default."""
    assert [field.name for field in dataclasses.fields(getattr(face, name))] == FIELDS[name].split()


@pytest.mark.parametrize("name", PARAMETERS)
def test_the_parameters_are_these(name: str) -> None:
    called = face
    for part in name.split("."):
        called = getattr(called, part)
    assert list(inspect.signature(called).parameters) == PARAMETERS[name].split()  # type: ignore[arg-type]


def test_importing_the_face_loads_neither_compiler_nor_link() -> None:
    """A camera's process starts in half a second and needs no LLVM."""
    script = "import sys, companion.sensors; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not {"numba", "llvmlite", "mavsdk", "open3d", "mcap"} & set(done.stdout.split())


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The code of the page, each block in the file that its first line names, installed as pip would do it."""
    for name, code in re.findall(r"^```\w+\n# (\S+)\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(code, encoding="utf-8")
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text("utf-8"))["project"]
    installed = tmp_path / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Name: {project['name']}\nVersion: {project['version']}\n", "utf-8")
    ((group, entries),) = project["entry-points"].items()
    lines = [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (installed / "entry_points.txt").write_text("\n".join(lines), "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("package")
def test_the_driver_of_the_page_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside ours, without a line of it in this project."""
    settings = Settings.model_validate({"sensors": {"drivers": ["stream", "my_lidar"]}})
    context = DriverContext(MonotonicClock(), None)
    with pytest.raises(face.InputError, match="MY_LIDAR must be HOST:PORT"):
        load_drivers(settings, context)
    monkeypatch.setenv("MY_LIDAR", "192.168.1.40:4000")
    loaded = load_drivers(settings, context)
    assert [driver.name for driver in loaded] == ["stream", "my_lidar"]
    assert all(isinstance(driver, SensorDriver) for driver in loaded)


def test_the_test_of_the_page_passes(package: Path) -> None:
    """In a process of its own, as its author would run it."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir=.", "tests"]
    environment = {**os.environ, "PYTHONPATH": str(package)}
    done = subprocess.run(command, cwd=package, env=environment, capture_output=True, text=True, check=False)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


async def test_the_process_of_the_page_serves_frames(package: Path) -> None:
    """What it publishes arrives at the driver `stream`, placed in our time."""
    url = f"unix://{package}/camera.sock"
    (package / "vehicle.yaml").write_text(f"sensors: {{stream: {{url: '{url}'}}}}\n", "utf-8")
    serve = importlib.import_module("camera_process").serve
    sink = SensorSink(MonotonicClock())
    tasks = [
        asyncio.create_task(serve(package / "vehicle.yaml")),
        asyncio.create_task(StreamDriver(url, MonotonicClock()).run(sink)),
    ]
    try:
        async with asyncio.timeout(10.0):
            while (frame := sink.take().depth) is None:  # noqa: ASYNC110 - the sink has no event
                await asyncio.sleep(0.01)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    assert float(frame.depth_m.max()) == 2.0
