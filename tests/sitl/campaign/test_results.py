"""The table and the report of a campaign: every row, honest shares, and commands that fly a mission again."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet

from companion.config.load import load_settings
from sitl.campaign import table
from sitl.campaign.description import read
from sitl.campaign.given import Given
from sitl.campaign.groups import Group, cells, kinds
from sitl.campaign.mission import Campaign, Row, failure
from sitl.campaign.page import write_report
from sitl.campaign.plan import plan
from sitl.campaign.worst import again, worst_of
from tests.sitl.campaign.missions import once

CHOICES = ("coin", "informed")


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """Pictures of few pixels, which take a tenth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sitl.report.style.DPI", 40)
        yield


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    given = {"worlds": "room,random:1..2", "seeds": 3, "settings": {"control.choice": [*CHOICES]}, "time_limit_s": 99.5}
    return plan(read(None, {key: Given(value, key) for key, value in given.items()}))


def rows_of(campaign: Campaign) -> list[Row]:
    return [{**one.given(), **once(one), "settings": one.settings_json} for one in campaign.missions]


def test_the_table_has_a_row_a_mission_and_columns_of_their_types(tmp_path: Path, campaign: Campaign) -> None:
    """Protects whoever reads it with other tools: types, order, what is not known, and all settings."""
    rows = rows_of(campaign)
    rows[1] = {**campaign.missions[1].given(), **failure("ValueError: x", "Traceback"), "settings": "{}"}
    for row in rows:
        row["versions"] = {"numpy": "2"}
        row["nowhere_known_m"] = None
    rows[2]["completed_at_s"] = 4
    table.write(rows[::-1], tmp_path / "missions.parquet")
    read_back = parquet.read_table(tmp_path / "missions.parquet")
    assert read_back.column("mission").to_pylist() == list(range(18))
    kinds_of = {field.name: field.type for field in read_back.schema}
    assert (kinds_of["seed"], kinds_of["contacts"]) == (pa.int64(), pa.int64())
    assert (kinds_of["completed_at_s"], kinds_of["nowhere_known_m"]) == (pa.float64(), pa.float64())
    assert (kinds_of["control.choice"], kinds_of["error"], kinds_of["versions"]) == (pa.string(),) * 3
    assert read_back.column("control.choice").to_pylist() == [*CHOICES] * 9
    assert read_back.column("error").to_pylist()[:3] == [None, "ValueError: x", None]
    assert read_back.column("completed_at_s").to_pylist()[:3] == [10.0, None, 4.0]
    assert json.loads(read_back.column("versions")[0].as_py()) == {"numpy": "2"}
    settings = json.loads(read_back.column("settings")[0].as_py())
    assert settings["control"]["choice"] == "coin"


def test_times_of_missions_that_did_not_arrive_are_endless(campaign: Campaign) -> None:
    """Protects the median: a mission that never became complete is later than any that did, and a failure is none."""
    rows = rows_of(campaign)[:5]
    for row, time_s in zip(rows, (30.0, 10.0, None, 20.0, None), strict=True):
        row["completed_at_s"] = time_s
    rows[4] = {**campaign.missions[4].given(), **failure("x")}
    group = Group("", rows)
    assert group.arrived_s() == [10.0, 20.0, 30.0, math.inf]
    assert [group.time_quantile_s(share) for share in (0.5, 0.75, 0.9)] == [20.0, 30.0, math.inf]
    assert (len(group.flown), group.failed) == (4, 1)


def test_groups_are_what_is_compared(campaign: Campaign) -> None:
    """Protects comparisons: by the settings that vary, else by worlds, where drawn ones are one kind."""
    rows = rows_of(campaign)
    assert [(group.name, len(group.rows)) for group in kinds(campaign, rows)] == [
        ("choice coin", 9),
        ("choice informed", 9),
    ]
    assert len(cells(campaign, rows)) == 6
    single = Campaign(campaign.missions, campaign.identity, ())
    assert [(group.name, len(group.rows)) for group in kinds(single, rows)] == [("room", 6), ("random", 12)]


def test_vehicles_that_collided_are_told_like_a_contact(campaign: Campaign) -> None:
    """Protects from a fleet whose maps are complete and whose vehicles lie on the floor."""
    rows = rows_of(campaign)
    rows[4] |= {"collisions": 1, "least_distance_between_vehicles_m": 0.41}
    assert sum(group.contacts for group in kinds(campaign, rows)) == 1
    worst = {one.mission.number: one for one in worst_of(campaign, rows)}
    assert worst[4].why[0] == "collision, 0.41 m from middle to middle"


def test_the_report_names_the_worst_and_how_to_fly_them_again(tmp_path: Path, campaign: Campaign) -> None:
    """Protects the way from a number to its flight: the command has the settings, in a file that is there."""
    folder = tmp_path / "a campaign"
    folder.mkdir()
    rows = rows_of(campaign)
    rows[3] |= {
        "ended_because": "contact",
        "contacts": 1,
        "completed_at_s": None,
        "least_d_m": 0.3,
        "completeness": 0.5,
    }
    rows[5] = {**campaign.missions[5].given(), **failure("ValueError: <b>bold</b>"), "settings": "{}"}
    rows[7]["software"] = "another"
    write_report(folder, campaign, rows)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert page.rstrip().endswith("</html>")
    assert "All 18 missions have ended, 16 with a complete map, 1 with a contact, 1 failed." in page
    assert "16 of 17 (71.3 % to 99.9 %)" in page
    assert "1 (in at most 25.02 %)" in page
    assert "<b>bold" not in page
    assert "software 1.2.3 abc and another" in page
    assert page.count("<img ") == 7
    worst = {one.mission.number: one for one in worst_of(campaign, rows)}
    assert list(worst)[:2] == [3, 5]
    assert worst[3].why[0] == "contact, least distance 0.3 m"
    command = again(folder, worst[3].mission)
    assert command in page.replace("&#x27;", "'")
    words = shlex.split(command)
    assert words[:6] == ["companion", "sim", "--world", worst[3].mission.world, "--seed", str(worst[3].mission.seed)]
    assert words[words.index("--time-limit") + 1] == "99.5"
    config = Path(words[words.index("--config") + 1])
    assert load_settings(config, words[words.index("--preset") + 1]) == worst[3].mission.settings
    for one in worst.values():
        assert (folder / "again" / f"{one.mission.number}.yaml").is_file()


@pytest.mark.parametrize("kept", [1, 18])
def test_a_report_of_few_rows_or_of_failures_alone(tmp_path: Path, campaign: Campaign, kept: int) -> None:
    """Protects the end of a campaign that was interrupted, or in which nothing flew: the report is there."""
    rows = [{**one.given(), **failure("x"), "settings": "{}"} for one in campaign.missions[:kept]]
    write_report(tmp_path, campaign, rows)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"{kept} failed" in page
    assert "nan" not in page


def test_a_share_is_not_rounded_to_all(tmp_path: Path, campaign: Campaign) -> None:
    """Protects the one mission of thousands: 99.99 % is not shown as 100 %."""
    first = rows_of(campaign)[0]
    write_report(
        tmp_path, campaign, [first] * 9999 + [{**first, "ended_because": "time limit", "completed_at_s": None}]
    )
    assert re.search("> 99.9 %</span>", (tmp_path / "report.html").read_text(encoding="utf-8"))


def test_a_vehicle_that_was_done_too_early_has_no_complete_map(campaign: Campaign) -> None:
    """Protects the share of complete maps where the vehicle's own word ends missions: the truth counts them."""
    early, late = rows_of(campaign)[:2]
    early |= {"ended_because": "done", "completed_at_s": None, "completeness": 0.9}
    late |= {"ended_because": "done", "completed_at_s": 10.0, "sim_time_s": 40.0}
    group = Group("all", (early, late))
    assert group.complete == 1
    assert group.arrived_s() == [10.0, math.inf]
    assert [one.row for one in worst_of(campaign, (early, late)) if any("completeness" in why for why in one.why)] == [
        early
    ]
