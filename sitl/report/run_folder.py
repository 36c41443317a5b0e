"""The folder of a simulated flight: written beside its final name and moved there, with all that could be written."""

from __future__ import annotations

import functools
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from companion.config.show import dump_yaml
from companion.errors import CompanionError, InputError
from companion.mapping.files import GEOREFERENCED, OF_A_MISSION, Georeference
from companion.mapping.files import write as write_map_file
from companion.mapping.files.graph_file import write_graph
from companion.mapping.files.ground_file import write_known_ground
from companion.mapping.files.whole import whole_file
from companion.mapping.journal import JOURNAL_NAME
from companion.recording.folder import free_names
from sitl.report import ReportData, overview_png, plan_of, write_report
from sitl.report.kept import Kept


def default_folder(what: str) -> Path:
    """A new name under ``runs/``, with the time of day in UTC and what is flown in it."""
    wanted = Path("runs") / f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{what}"
    return next(name for name in free_names(wanted) if not name.exists())


def flown(world: str, seed: int) -> str:
    """What is flown, as a part of a name."""
    return f"{Path(world).stem.replace(':', '-')}-{seed}"


class RunFolder:
    """A folder that is being filled.

    Attributes:
        path: where to write now. Whoever is killed leaves it, and what it holds, beside the name that it was to have.
        target: where everything is in the end.
    """

    def __init__(self, path: Path, target: Path) -> None:
        self.path = path
        self.target = target

    def become(self) -> None:
        """Take the name that was wanted; one with a number behind it when somebody else has taken that meanwhile.

        Raises:
            CompanionError: it cannot; everything is in `path`.
        """
        try:
            if self.target.is_dir() and not any(self.target.iterdir()):
                # An empty folder that is there already may be a link, another disk, or where a shell stands: it is
                # filled, not replaced.
                for file in sorted(self.path.iterdir()):
                    shutil.move(file, self.target / file.name)
                self.path.rmdir()
                return
            # mkdtemp makes folders that only their owner may read.
            self.path.chmod(0o755)
            self.target = next(name for name in free_names(self.target) if not name.exists())
            self.path.replace(self.target)
        except OSError as error:
            raise CompanionError(f"{self.target}: {error.strerror or error}; the results are in {self.path}") from None


@contextmanager
def new_folder(target: Path) -> Iterator[RunFolder]:
    """A folder to write into, which becomes ``target`` at the end, however that comes; an empty one goes away.

    It is made before the flight: whoever may not write there learns it at once and not after an hour.

    Raises:
        InputError: ``target`` exists and is not an empty folder, or cannot be made.
        CompanionError: it cannot have its name in the end; the error says where the results are.
    """
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"--out {target}: exists already and is not an empty folder; give a new name")
    try:
        beside = target.resolve()
        beside.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f"{beside.name}.unfinished-", dir=beside.parent))
    except OSError as error:
        raise InputError(f"--out {target}: {error.strerror}; give a folder that you may write") from None
    folder = RunFolder(partial, target)
    try:
        yield folder
    except BaseException:
        if any(partial.iterdir()):
            folder.become()
        else:
            partial.rmdir()
        raise
    folder.become()


def write_run(kept: Kept, preset: str, config: Path | None) -> dict[str, object]:
    """Write trajectories, map, summary and report into a folder: each by itself, first what cannot be made again.

    Args:
        kept: the mission, its folder, and what is there of it already.
        preset: name of the preset below all settings.
        config: the file with settings above it.

    Returns:
        The summary; ``unwritten`` in it names what could not be written, and why.

    Raises:
        KeyboardInterrupt: it was interrupted; what had been written by then is there, and the summary names the rest.
        OSError: not even the summary could be written.
    """
    folder, simulation = kept.folder, kept.simulation
    settings = simulation.settings
    voxels = simulation.merged_map()
    summary = simulation.score()
    summary["preset"] = preset
    summary["config"] = None if config is None else str(config)
    summary["unwritten"] = unwritten = dict[str, str]()
    settings_yaml = dump_yaml(settings)

    writers: dict[str, Callable[[Path], object]] = {JOURNAL_NAME: lambda _: kept.keep_map()}
    writers.update((kept.trajectory(flight.log).name, flight.log.write_csv) for flight in simulation.flights)
    # Of these what is whole stays, though its end is missing: the journal tells by itself how far it goes.
    stays = set(writers)
    graphs = tuple(flight.navigator.graph.snapshot() for flight in simulation.flights)
    for flight, graph in zip(simulation.flights, graphs, strict=True):
        of = "" if len(graphs) == 1 else f"-{flight.log.vehicle_id}"
        writers[f"graph{of}.json"] = functools.partial(write_graph, graph, origin_m=simulation.world.origin_m)
        ground = flight.navigator.known_ground.seen()
        writers[f"known_ground{of}.npz"] = functools.partial(write_known_ground, ground)
    writers["settings.yaml"] = lambda path: path.write_text(settings_yaml, encoding="utf-8")

    def map_file(path: Path) -> None:
        lies = Georeference(simulation.world.origin_m) if path.suffix.removeprefix(".") in GEOREFERENCED else None
        write_map_file(voxels, path, georeference=lies)

    writers.update((f"map.{format_}", map_file) for format_ in OF_A_MISSION)

    @functools.cache
    def reported() -> ReportData:
        return ReportData(
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
            left_out=simulation.left_out,
            settings_yaml=settings_yaml,
            graphs=graphs,
            explored_ticks=simulation.explored.ticks,
        )

    writers["report.html"] = lambda path: write_report(path, reported())
    writers["overview.png"] = lambda path: path.write_bytes(overview_png(reported(), plan_of(reported())))
    waiting = list(writers)
    try:
        for name, write in writers.items():
            try:
                write(folder / name)
            except BaseException as error:
                # Half a file would be taken for a whole one.
                if name not in stays:
                    (folder / name).unlink(missing_ok=True)
                if not isinstance(error, OSError | MemoryError | CompanionError):
                    raise
                unwritten[name] = str(error) or type(error).__name__
            waiting.remove(name)
    except BaseException as error:
        unwritten.update(dict.fromkeys(waiting, "interrupted" if isinstance(error, KeyboardInterrupt) else repr(error)))
        raise
    finally:
        with whole_file(folder / "summary.json") as file:
            file.write((json.dumps(summary, indent=2) + "\n").encode())
    return summary
