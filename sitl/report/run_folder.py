"""The folder of a simulated flight: written beside its final name and moved there when it is whole."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from companion.config.show import dump_yaml
from companion.errors import InputError
from companion.mapping.files import write_map
from companion.mapping.journal import JOURNAL_NAME, Header, Journal
from sitl.report import ReportData, overview_png, write_report
from sitl.sim.simulation import Simulation


def default_folder(world: str, seed: int) -> Path:
    """A new name under ``runs/``, with the time of day in UTC in it."""
    stem = Path(world).stem.replace(":", "-")
    return Path("runs") / f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{stem}-{seed}"


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to write into, which becomes ``target`` at the end; nothing is left of it when the flight fails.

    It is made before the flight: whoever may not write there learns it at once and not after an hour.

    Raises:
        InputError: ``target`` exists and is not an empty folder, or cannot be made.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"--out {target}: exists already and is not an empty folder; give a new name")
    try:
        beside = target.resolve()
        beside.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{beside.name}.", dir=beside.parent))
    except OSError as error:
        raise InputError(f"--out {target}: {error.strerror}; give a folder that you may write") from None
    try:
        yield partial
        if target.is_dir():
            # An empty folder that is there already may be a link, or where a shell stands: it is filled, not replaced.
            for file in sorted(partial.iterdir()):
                file.replace(target / file.name)
        else:
            # mkdtemp makes folders that only their owner may read.
            partial.chmod(0o755)
            partial.replace(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_run(folder: Path, simulation: Simulation, preset: str, config: Path | None) -> dict[str, object]:
    """Write map, trajectories, summary and report into a folder.

    Returns:
        The summary.
    """
    settings = simulation.settings
    voxels = simulation.merged_map()
    summary = simulation.score()
    summary["preset"] = preset
    summary["config"] = None if config is None else str(config)
    for flight in simulation.flights:
        name = "trajectory.csv" if len(simulation.flights) == 1 else f"trajectory-{flight.log.vehicle_id}.csv"
        flight.log.write_csv(folder / name)
    write_map(voxels, folder)
    with Journal.open(folder / JOURNAL_NAME, Header.of(settings.mapping)) as journal:
        journal.append_all(voxels)
    settings_yaml = dump_yaml(settings)
    (folder / "settings.yaml").write_text(settings_yaml, encoding="utf-8")
    (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    data = ReportData(
        title=f"{simulation.world.name}, seed {simulation.seed}, preset {preset}",
        summary=summary,
        vertices_m=simulation.world.vertices_m,
        triangles=simulation.world.triangles,
        flights=tuple(flight.log for flight in simulation.flights),
        progress=np.array(simulation.progress, dtype=np.float64).reshape(-1, 2),
        occupied_m=voxels.occupied(),
        voxel_m=voxels.voxel_m,
        missed_m=simulation.missed_m(),
        margin_m=settings.control.margin_m,
        critical_margin_m=settings.control.critical_margin_m,
        height_m=settings.control.height_m,
        settings_yaml=settings_yaml,
    )
    write_report(folder / "report.html", data)
    (folder / "overview.png").write_bytes(overview_png(data))
    return summary
