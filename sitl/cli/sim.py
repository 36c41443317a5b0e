"""The command `companion sim`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.cli.options import Config, Preset
from companion.config.load import load
from companion.config.settings import Settings
from companion.control.left_out import in_words, so_many, to_explore
from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.interruption import finishing, stopping
from sitl.cli.mesh_options import DEFAULT_CLOUD_VOXEL_M, CloudVoxel, Scale, UpAxis
from sitl.mines import World, load_world
from sitl.mines.placing import Reading
from sitl.report.earlier_run import EarlierRun
from sitl.report.kept import Kept
from sitl.report.run_folder import default_folder, flown, new_folder, write_run
from sitl.scene.visibility import Say
from sitl.sim.display import Display, clock
from sitl.sim.simulation import ENDED_WELL, Progress, Simulation

PREPARING = "preparing the mine (the very first flight compiles the fast parts, about a minute)"


class UnwrittenError(CompanionError):
    """A part of the results could not be written; the rest is there."""


class MissionFailedError(CompanionError):
    """The mission did not end as it should: the map is not complete, or a wall was touched."""


def simulate(
    world: Annotated[
        str,
        typer.Option(metavar="NAME|MESH", help="complex, slope, room, random, random:K, hazard:NAME, or a mesh file."),
    ] = "complex",
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Draws start, noise and every choice.")] = 1,
    preset: Preset = None,
    config: Config = None,
    time_limit: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Simulated time; else sim.time_limit_s.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="New folder; else one under runs/.")] = None,
    vehicles: Annotated[int, typer.Option(min=1, metavar="N", help="How many fly in the mine.")] = 1,
    start: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z YAW", help="Start pose, in m (a mesh: its own unit and origin) and rad, not the world's own."
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Go on with map and known ground of an earlier mission in this mine, from where it began.",
        ),
    ] = None,
    scale: Scale = None,
    up: UpAxis = None,
    cloud_voxel: CloudVoxel = DEFAULT_CLOUD_VOXEL_M,
) -> None:
    """Fly a mission in a simulated mine and bring home its map.

    Writes the map, the trajectory, summary.json and report.html into a new folder. The exit code is 0 when the map is
    complete, or with sim.ends done the mission, 1 when it ended otherwise, 2 for wrong input, 130 after Ctrl-C.
    """
    console = Console()
    loaded = load(config, preset)
    settings = loaded.settings
    limit_s = settings.sim.time_limit_s if time_limit is None else time_limit
    if not 0.0 < limit_s < float("inf"):
        raise InputError(f"--time-limit {limit_s:g}: must be a time above 0, in s")
    if vehicles > settings.fleet.largest_group:
        raise InputError(
            f"--vehicles {vehicles}: fleet.largest_group = {settings.fleet.largest_group} is the most that the height "
            "layers have room for; allow more there, with control.vertical_margin_m small enough"
        )
    if resume is not None and vehicles > 1:
        raise InputError(f"--resume {resume}: one vehicle goes on with what one has left; leave out --vehicles")
    earlier = None if resume is None else EarlierRun.read(resume, settings.mapping)
    reading = Reading(scale, up, cloud_voxel)
    folder = None
    try:
        with new_folder(default_folder(flown(world, seed)) if out is None else out) as folder:
            with console.status(PREPARING) as status:
                mine = load_world(world, seed, start, reading)
                if earlier is not None:
                    mine = earlier.mine_of(mine, start is None)
                # First: where the start is refused, this says why the mine is not where it was thought to be.
                _say(console, f"{mine.name}: {mine.description}", *(f"  {remark}" for remark in mine.remarks))
                simulation = _prepared(
                    mine, settings, seed, vehicles, earlier, lambda text: status.update(f"{PREPARING}: {text}")
                )
            _say(console, *(f"  {remark}" for remark in simulation.remarks[len(mine.remarks) :]))
            # From here on there is something to lose, and no moment at which a signal would tear it.
            with stopping("ending the flight") as stop, Kept(folder.path, simulation) as kept:
                failure = _fly(kept, limit_s, console, stop)
                with console.status("writing map and report"), finishing("writing map and report"):
                    summary = write_run(kept, loaded.preset, config)
    except BaseException:
        if folder is not None and folder.target.is_dir() and any(folder.target.iterdir()):
            typer.echo(f"what had been written is in {folder.target}", err=True)
        raise
    target = folder.target
    _say_result(console, simulation, summary, target)
    if failure is not None:
        raise failure
    if unwritten := summary["unwritten"]:
        assert isinstance(unwritten, dict)  # noqa: S101 - the summary holds values of all types
        raise UnwrittenError(f"not written to {target}: {'; '.join(f'{n} ({why})' for n, why in unwritten.items())}")
    if simulation.ended_because == "stopped by the user":
        raise typer.Exit(EXIT_INTERRUPTED)
    if simulation.ended_because not in ENDED_WELL:
        raise MissionFailedError(
            f"the mission ended because of: {simulation.ended_because}; the map holds {simulation.completeness:.1%} of "
            f"what can be seen"
        )


def _prepared(
    mine: World, settings: Settings, seed: int, vehicles: int, earlier: EarlierRun | None, say: Say
) -> Simulation:
    """The mission, which may go on from an earlier one."""
    if earlier is None:
        return Simulation(mine, settings, seed, vehicles, say)
    try:
        return Simulation(mine, settings, seed, vehicles, say, earlier.left)
    except ValueError as error:
        raise InputError(f"--resume {earlier.folder}: its known ground cannot be gone on from: {error}") from None


def _fly(kept: Kept, limit_s: float, console: Console, stop: Callable[[], bool]) -> Exception | None:
    """Fly; a mistake of ours ends the flight, and what was flown until then is written all the same."""
    simulation = kept.simulation
    try:
        with Display(console) as display:

            def show(progress: Progress) -> None:
                display(progress)
                kept.look()

            simulation.run(limit_s, show, stop)
            simulation.come_home(show, stop)
    except Exception as error:  # noqa: BLE001 - it is raised again when the results are safe
        simulation.ended_because = f"failed: {error!r}"
        return error
    return None


def _say_result(console: Console, simulation: Simulation, summary: dict[str, object], folder: Path) -> None:
    graph, homes = summary["graph"], summary["home"]
    assert isinstance(homes, list)  # noqa: S101 - the summary holds values of all types
    assert isinstance(graph, dict)  # noqa: S101 - the summary holds values of all types
    lines = [
        f"ended: {simulation.ended_because} after {clock(simulation.t_s)} simulated, "
        f"{simulation.wall_time_s:.0f} s of waiting",
        f"map: {simulation.completeness:.2%} of what can be seen, "
        f"{summary['occupied_voxels']} voxels of {summary['voxel_m']} m",
        f"the vehicle's own word: {_own_word(simulation)}; seen and left out: {in_words(simulation.left_out)}",
        f"least distance to a wall: {_metres(summary['least_d_m'])}, contacts: {summary['contacts']}, "
        f"least clearance of the body: {_metres(summary['least_clearance_m'])}",
        f"navigation graph: {graph['vertices']} vertices, {graph['edges']} edges, {graph['exits_untaken']} of "
        f"{graph['exits']} exits not taken, {graph['exits_unvisited']} of them never come to",
        f"look at: {folder / 'report.html'}",
    ]
    if len(simulation.flights) > 1:
        met = simulation.encounters
        lines.insert(
            -1,
            f"least distance between vehicles: {_metres(summary['least_distance_between_vehicles_m'])}, "
            f"nearer than they are to be for {met.too_near_s:.1f} s, collisions: {met.collisions}",
        )
    lines[-1:-1] = [_home(home, flight.log.vehicle_id) for home, flight in zip(homes, simulation.flights, strict=False)]
    left = to_explore(simulation.left_out)
    if left and simulation.ended_because not in ENDED_WELL:
        again = f": fly again with --resume {folder}" if len(simulation.flights) == 1 else ""
        lines.append(f"{so_many(left)} left to explore{again}")
    _say(console, *lines)


def _home(home: dict[str, object], number: int) -> str:
    """How a vehicle came home."""
    battery = home.get("came_percent")
    left = "" if battery is None else f", {battery} % of the battery left of {home['promised_percent']} % promised"
    return (
        f"vehicle {number}: {home['ended_because']}, {_metres(home.get('off_m'))} from where it started, after "
        f"{_metres(home.get('flown_m'))} in {home.get('time_s')} s{left}"
    )


def _say(console: Console, *lines: str) -> None:
    for line in lines:
        console.print(line, highlight=False, soft_wrap=True, markup=False)


def _metres(value: object) -> str:
    return "not known" if value is None else f"{value} m"


def _own_word(simulation: Simulation) -> str:
    """What it would have said in flight, where nobody knows the truth."""
    estimated, done_at_s = simulation.estimated_completeness, simulation.judgement.done_at_s
    done = "not done yet" if done_at_s is None else f"done after {clock(done_at_s)}"
    return f"{done}, {'an unknown share' if estimated is None else f'{estimated:.1%}'} mapped"
