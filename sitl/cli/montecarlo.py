"""The command `companion montecarlo`."""

from __future__ import annotations

import os
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.cli.options import Config
from companion.config.source import as_yaml
from companion.errors import CompanionError, InputError
from companion.interruption import finishing
from sitl.campaign import table, tours
from sitl.campaign.description import read
from sitl.campaign.flight import fly
from sitl.campaign.folder import claimed
from sitl.campaign.given import Given, value
from sitl.campaign.ledger import Ledger
from sitl.campaign.mission import FAILED, Campaign, Mission, Row
from sitl.campaign.page import REPORT, write_report
from sitl.campaign.plan import plan
from sitl.campaign.progress import CampaignProgress
from sitl.campaign.run import run
from sitl.campaign.workers import LocalWorkers, Workers
from sitl.report.cards import number
from sitl.report.run_folder import default_folder

TABLE = "missions.parquet"

REFRESH_S = 600.0
"""Table and report are written anew this often while missions are flown."""


class CampaignFailedError(CompanionError):
    """Not every mission ended with a complete map and without a contact."""


def montecarlo(
    file: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="YAML file that describes the campaign.")
    ] = None,
    worlds: Annotated[
        str | None, typer.Option(metavar="LIST", help="As for `sim`, with commas: complex,random:1..20,mine.ply.")
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(metavar="N|LIST", help="N: 1 to N in each world; or 5..24; or 1,5,7..9. [20]")
    ] = None,
    preset: Annotated[str | None, typer.Option(metavar="LIST", help="Presets, with commas: each is flown.")] = None,
    config: Config = None,
    vehicles: Annotated[int | None, typer.Option(metavar="N", help="How many fly in a mission. [1]")] = None,
    time_limit: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Simulated time of a mission; else sim.time_limit_s.")
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE,...", help="A setting; of several values each is flown. Repeatable."),
    ] = None,
    draw: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=LOW..HIGH", help="A setting that is drawn for each world and seed. Repeatable."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder: a new one, or one to go on with; else a new one under runs/."),
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, metavar="N", help="Missions at a time; else one a core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Fly on the workers of this Dask scheduler: tcp://HOST:8786.")
    ] = None,
    with_tours: Annotated[
        bool,
        typer.Option("--tours", help="Plan a good inspection tour of each world too, and compare. Up to minutes each."),
    ] = False,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Fly missions again that raised an error or lost their process.")
    ] = False,
) -> None:
    """Fly thousands of missions over worlds, seeds, settings and faults, and show how they are distributed.

    The same command on the same folder goes on where it was ended, even by SIGKILL. Writes missions.parquet, one row a
    mission, and report.html. The exit code is 0 when every map is complete, 1 when a mission ended otherwise, 2 for
    wrong input, 130 after Ctrl-C.
    """
    if jobs is not None and scheduler is not None:
        raise InputError("--jobs with --scheduler: the cluster's own workers fly; leave one of the two")
    options = _options(worlds, seeds, preset, config, vehicles, time_limit, setting or [], draw or [])
    described = read(file, options)
    if with_tours and described.vehicles > 1:
        raise InputError(
            f"--tours: a tour is one vehicle's, and {described.place('vehicles')} {described.vehicles} fly here; "
            "leave it"
        )
    console = Console()
    with console.status("preparing the missions"):
        campaign = plan(described)
    folder = default_folder(f"campaign-{len(campaign.missions)}") if out is None else out
    with claimed(folder, campaign) as ledger:
        if with_tours:
            _plan_tours(campaign, _workers(jobs, scheduler), folder, console, retry_failed)
        _fly(campaign, ledger, _workers(jobs, scheduler), folder, console, retry_failed)
        rows = list(ledger.rows.values())
    console.print(f"look at: {folder / REPORT}", highlight=False, soft_wrap=True)
    _judge(campaign, rows)


def _options(
    worlds: str | None,
    seeds: str | None,
    preset: str | None,
    config: Path | None,
    vehicles: int | None,
    time_limit: float | None,
    settings: list[str],
    draws: list[str],
) -> dict[str, Given]:
    """The campaign that the options describe, by the keys of its file."""
    given = {
        "worlds": Given(worlds, "--worlds"),
        "seeds": Given(seeds, "--seeds"),
        "preset": Given(preset, "--preset"),
        "config": Given(None if config is None else str(config), "--config"),
        "vehicles": Given(vehicles, "--vehicles"),
        "time_limit_s": Given(time_limit, "--time-limit"),
    }
    given["settings"] = Given(_assigned(settings, "--set", ",") or None, "--set")
    given["draws"] = Given(_assigned(draws, "--draw", "..") or None, "--draw")
    return {key: one for key, one in given.items() if one.value is not None}


def _assigned(texts: list[str], option: str, between: str) -> dict[str, object]:
    """What ``KEY=VALUES`` say, by their keys; a list in brackets is what it is in a file."""
    found: dict[str, object] = {}
    for text in texts:
        name, sign, values = (part.strip() for part in text.partition("="))
        if not (sign and name and values):
            raise InputError(f"{option} {as_yaml(text)}: expected KEY=VALUE, as in control.margin_m=1.0")
        place = f"{option} {name}"
        if name in found:
            raise InputError(f"{place}: given twice; give all of its values at once, with {between} between")
        parts = [values] if values.startswith("[") else values.split(between)
        read_as = [value(part, place) for part in parts]
        found[name] = read_as[0] if values.startswith("[") else read_as
    return found


def _workers(jobs: int | None, scheduler: str | None) -> Workers:
    if scheduler is None:
        return LocalWorkers(jobs or len(os.sched_getaffinity(0)))
    from sitl.campaign.cluster import Cluster  # takes a second to import

    return Cluster(scheduler)


def _plan_tours(campaign: Campaign, workers: Workers, folder: Path, console: Console, retry_failed: bool) -> None:
    """Plan the tours that are missing: before the missions, so that every report compares with them."""
    asked = {mission.number: mission for mission in tours.representatives(campaign).values()}
    with Ledger(folder, tours.NAME) as ledger:
        there, missing = _left(list(asked.values()), ledger, retry_failed)
        progress = CampaignProgress(console, len(asked), there, workers.who, time.monotonic, "tours", tours.planned)
        try:
            with workers, progress:

                def keep(row: Row) -> None:
                    ledger.append(row)
                    progress.ended(row)

                run(missing, workers, tours.plan_tour, keep, progress.look)
        except BaseException:
            typer.echo(f"the tours that were planned are in {folder}; to go on: {_again(folder)}", err=True)
            raise
        for row in ledger.rows.values():
            if row["ended_because"] == FAILED:
                typer.echo(f"no tour of {row['given_world']}: {row['error']}; its missions have no ratios", err=True)


def _left(missions: Sequence[Mission], ledger: Ledger, retry_failed: bool) -> tuple[list[Row], list[Mission]]:
    """The rows that stay, and the missions that have none yet or are to be tried again."""
    again = {number for number, row in ledger.rows.items() if retry_failed and row["ended_because"] == FAILED}
    there = [row for number, row in ledger.rows.items() if number not in again]
    return there, [one for one in missions if one.number in again or one.number not in ledger.rows]


def _fly(
    campaign: Campaign, ledger: Ledger, workers: Workers, folder: Path, console: Console, retry_failed: bool
) -> None:
    """Fly what is missing; table and report are there afterwards, however it ended."""
    there, missing = _left(campaign.missions, ledger, retry_failed)
    written_s = time.monotonic()

    try:
        asked = len(campaign.missions)
        with workers, CampaignProgress(console, asked, there, workers.who, time.monotonic) as progress:

            def keep(row: Row) -> None:
                ledger.append(row)
                progress.ended(row)

            def look() -> None:
                nonlocal written_s
                progress.look()
                if ledger.rows and time.monotonic() - written_s > REFRESH_S:
                    _write(folder, campaign, ledger)
                    written_s = time.monotonic()

            run(missing, workers, fly, keep, look)
    except BaseException:
        if ledger.rows:
            typer.echo(f"what has been flown is in {folder}; to go on: {_again(folder)}", err=True)
        raise
    finally:
        if ledger.rows:
            with console.status("writing table and report"), finishing("writing table and report"):
                _write(folder, campaign, ledger)


def _write(folder: Path, campaign: Campaign, ledger: Ledger) -> None:
    rows = tours.compared(campaign, list(ledger.rows.values()), tours.there(folder))
    try:
        table.write(rows, folder / TABLE)
        write_report(folder, campaign, rows)
    except OSError as error:
        raise CompanionError(
            f"{folder}: table and report cannot be written: {error.strerror}; make room, and start the "
            "same command again"
        ) from None


def _again(folder: Path) -> str:
    """The command that goes on: this one, with the folder in it."""
    named = any(word == "--out" or word.startswith("--out=") for word in sys.argv)
    return shlex.join(["companion", *sys.argv[1:], *(() if named else ("--out", str(folder)))])


def _judge(campaign: Campaign, rows: list[Row]) -> None:
    if bad := [str(row["ended_because"]) for row in rows if number(row, "completed_at_s") is None]:
        counted = ", ".join(f"{bad.count(end)} {end}" for end in sorted(set(bad)))
        raise CampaignFailedError(
            f"{len(bad)} of {len(campaign.missions)} missions did not end with a complete map: {counted}"
        )
