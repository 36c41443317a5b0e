"""Flies past everything that mines hold and prints what became of it, as the table of docs/mines.md.

python -m validation.hazards                                           # every hazard, 3 seeds, flight and swift
python -m validation.hazards --seeds 20 --out runs/hazards             # the same folder again goes on where it was left
python -m validation.hazards --only shaft,beam --preset swift
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.errors import CompanionError
from sitl.campaign.description import read
from sitl.campaign.flight import fly
from sitl.campaign.folder import claimed
from sitl.campaign.given import Given
from sitl.campaign.mission import Campaign, Row
from sitl.campaign.plan import plan
from sitl.campaign.run import run
from sitl.campaign.workers import LocalWorkers
from sitl.mines.hazards import HAZARDS
from sitl.report.run_folder import default_folder
from validation.hazards.table import table

TIME_LIMIT_S = 600.0
"""Six times what a mine of this size takes."""


def main() -> None:
    """Fly what has not been flown, print the table; the exit code is 1 where something was touched."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default=",".join(HAZARDS), metavar="LIST", help=f"of {', '.join(HAZARDS)}")
    parser.add_argument("--preset", default="flight,swift", metavar="LIST")
    parser.add_argument("--seeds", default="3", metavar="N|LIST", help="as for companion montecarlo")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, metavar="SECONDS", help="simulated")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="flights at a time")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the rows: a new one, or one to go on with")
    given = parser.parse_args()
    try:
        campaign = _campaign(given)
        rows = _flown(campaign, default_folder("hazards") if given.out is None else given.out, given.jobs)
    except CompanionError as error:
        raise SystemExit(f"error: {error}") from None
    sys.stdout.write("\n".join(table(rows)) + "\n")
    raise SystemExit(any(row.get("contacts") for row in rows))


def _campaign(given: argparse.Namespace) -> Campaign:
    worlds = ",".join(f"hazard:{name.strip()}" for name in given.only.split(","))
    options = {
        "worlds": Given(worlds, "--only"),
        "seeds": Given(given.seeds, "--seeds"),
        "preset": Given(given.preset, "--preset"),
        "time_limit_s": Given(given.time_limit, "--time-limit"),
        # By its own word, as in flight: what cannot be seen is in no map, and no truth would ever call that complete.
        "settings": Given({"sim.ends": "done"}, "validation.hazards"),
    }
    return plan(read(None, options))


def _flown(campaign: Campaign, folder: Path, jobs: int) -> list[Row]:
    with claimed(folder, campaign) as ledger, LocalWorkers(jobs) as workers:
        missing = [mission for mission in campaign.missions if mission.number not in ledger.rows]

        def keep(row: Row) -> None:
            ledger.append(row)
            place = f"{len(ledger.rows)}/{len(campaign.missions)} {row['given_world']} {row['preset']} {row['seed']}"
            sys.stderr.write(f"{place}: {row['ended_because']}, contacts {row.get('contacts')}\n")

        run(missing, workers, fly, keep)
        return list(ledger.rows.values())


if __name__ == "__main__":
    main()
