"""From a description to missions: every combination once, and everything that is wrong is told before the first."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from companion.errors import InputError
from sitl.campaign import ranges
from sitl.campaign.description import KEYS, read
from sitl.campaign.given import Given, value
from sitl.campaign.mission import Campaign
from sitl.campaign.plan import plan
from sitl.campaign.worst import again


def planned(folder: Path, text: str, **options: object) -> Campaign:
    file = folder / "campaign.yaml"
    file.write_text(text, encoding="utf-8")
    return plan(read(file, {key: Given(value, f"--{key}") for key, value in options.items()}))


def refused(folder: Path, text: str, **options: object) -> list[str]:
    with pytest.raises(InputError) as error:
        planned(folder, text, **options)
    return str(error.value).splitlines()


@pytest.mark.parametrize(
    ("given", "seeds"),
    [
        (3, (1, 2, 3)),
        ("3", (1, 2, 3)),
        ("5..7", (5, 6, 7)),
        ("9,2..3", (9, 2, 3)),
        ([4], (4,)),
        ([0, "7..8"], (0, 7, 8)),
    ],
)
def test_seeds_are_read_as_people_list_them(given: object, seeds: tuple[int, ...]) -> None:
    assert ranges.seeds(given, "seeds") == seeds
    assert tuple(ranges.seeds([ranges.listed(seeds)], "seeds")) == seeds


@pytest.mark.parametrize("given", [0, -1, 1.5, True, "", "7..5", "x", "1,,2", "1..2..3", [], [1, "1"], {"a": 1}, None])
def test_what_names_no_seeds_is_refused(given: object) -> None:
    with pytest.raises(InputError, match=r"^here: "):
        ranges.seeds(given, "here")


@pytest.mark.parametrize(("text", "meant"), [("1", 1), ("1.0", 1.0), ("true", True), ("coin", "coin"), ("1:2", "1:2")])
def test_a_value_of_an_option_is_what_it_is_in_a_file(text: str, meant: object) -> None:
    found = value(text, "--set x")
    assert (found, type(found)) == (meant, type(meant))


def test_every_combination_is_there_once(tmp_path: Path) -> None:
    """Protects completeness: worlds, seeds, presets, cases and settings multiply; the first seed of all comes first."""
    campaign = planned(
        tmp_path,
        """
worlds: [room, "random:1..2"]
seeds: 5..6
preset: [flight, table_i]
settings:
  control: {choice: [coin, informed]}
  sim.noise.frame_loss_share: 0.05
cases: {clean: {}, drift: {sim.noise.pose_drift_share: 0.02}}
""",
    )
    combinations = Counter(
        (m.world, m.seed, m.preset, m.case, m.settings.control.choice, m.settings.sim.noise.pose_drift_share)
        for m in campaign.missions
    )
    assert len(combinations) == len(campaign.missions) == 3 * 2 * 2 * 2 * 2
    assert {m.settings.sim.noise.frame_loss_share for m in campaign.missions} == {0.05}
    assert {(m.case, m.settings.sim.noise.pose_drift_share) for m in campaign.missions} == {
        ("clean", 0.0),
        ("drift", 0.02),
    }
    assert [m.number for m in campaign.missions] == list(range(48))
    assert {m.seed for m in campaign.missions[:24]} == {5}
    assert campaign.several == ("preset", "case", "control.choice")


def test_the_example_of_the_documents_can_be_flown(tmp_path: Path) -> None:
    """Protects whoever copies it; the mesh that it names is somebody's own."""
    page = (Path(__file__).parents[3] / "docs" / "simulation.md").read_text(encoding="utf-8")
    example = page.partition("```yaml\n")[2].partition("```")[0]
    assert set(KEYS) == {line.partition(":")[0] for line in example.splitlines() if line[0] not in " #"}
    (tmp_path / "vehicle.yaml").write_text("", encoding="utf-8")
    campaign = planned(tmp_path, example, worlds="room")
    assert len(campaign.missions) == 20 * 2 * 2 * 3


def test_draws_are_the_same_for_all_that_is_compared(tmp_path: Path) -> None:
    """Protects comparisons: each world and seed has its own draw, within bounds, and all variants share it."""
    text = "{worlds: [room, complex], seeds: 8, settings: {control.choice: [coin, informed]}, draws: {%s}}"
    missions = planned(
        tmp_path, text % "sim.noise.pose_drift_share: [0.01, 0.02], sensors.camera.width_px: [64, 66]"
    ).missions
    drawn = {(m.world, m.seed): dict(m.values) | {"control.choice": ""} for m in missions}
    assert all(dict(m.values) | {"control.choice": ""} == drawn[m.world, m.seed] for m in missions)
    drifts = {m.settings.sim.noise.pose_drift_share for m in missions}
    assert len(drifts) == 16
    assert all(0.01 <= drift <= 0.02 for drift in drifts)
    assert {m.settings.sensors.camera.width_px for m in missions} == {64, 65, 66}


def test_options_are_above_the_file(tmp_path: Path) -> None:
    """Protects quick trials: an option replaces what the file says; settings are added to its settings."""
    (tmp_path / "vehicle.yaml").write_text("preset: table_i\ncontrol: {height_m: 1.3}\n", encoding="utf-8")
    settings = "control.choice: coin, control.least_probability: 0.1"
    text = f"{{worlds: complex, seeds: 20, config: vehicle.yaml, settings: {{{settings}}}}}"
    campaign = planned(
        tmp_path, text, worlds="room", seeds="2", time_limit_s=7.0, settings={"control.choice": ["informed"]}
    )
    first = campaign.missions[0]
    assert [(m.world, m.seed) for m in campaign.missions] == [("room", 1), ("room", 2)]
    assert (first.preset, first.time_limit_s, first.settings.control.height_m) == ("table_i", 7.0, 1.3)
    assert dict(first.values) == {"control.choice": "informed", "control.least_probability": 0.1}


def test_everything_that_is_wrong_is_told_at_once_with_its_line(tmp_path: Path) -> None:
    """Protects from learning of the next mistake after an hour: file, line, key, value and bound of each."""
    said = refused(
        tmp_path,
        """
worlds: [room]
settings:
  control.margin_m: [0.1, 1.2]
  control.chice: coin
cases:
  drift: {sim.noise.pose_drift_share: 2}
  none: {}
""",
    )
    place = f"{tmp_path}/campaign.yaml"
    assert any(
        line.startswith(f"{place}:4: settings.control.margin_m: out of range: value 0.1, bound >= 0.3") for line in said
    )
    assert any(line.startswith(f"{place}:5: settings.control.chice: unknown key") for line in said)
    assert any(
        line.startswith(f"{place}:7: cases.drift.sim.noise.pose_drift_share: out of range: value 2") for line in said
    )
    assert len(said) == 3


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("wrlds: room", ":1: wrlds: unknown key"),
        ("worlds: [room, rom]", ":1: worlds.1: world rom: there is none of that name"),
        ("worlds: room,room", ":1: worlds: room is there twice"),
        ("worlds: mine.ply", "mine.ply: there is no such file"),
        ("worlds: [{world: room, start: [1, 2]}]", ":1: worlds.0: "),
        ("worlds: [{world: room, start: [-5, 0, 1.5, 0]}]", ":1: worlds.0: "),
        ("worlds: [{world: room, start: [3, 0.4, 1, 0]}]", ":1: worlds.0: start (3.00, 0.40, 1.00) in world room: a "),
        ("worlds: [{world: mine.ply, scale: 0}]", ":1: worlds.0: --scale 0: must be a number above 0"),
        ("worlds: [{world: mine.ply, up: x}]", ":1: worlds.0: "),
        ("worlds: [{world: mine.ply, cloud_voxel: 5}]", ":1: worlds.0: --cloud-voxel 5: must be from 0.01 to 2 m"),
        ("worlds: [{world: mine.ply, unit: mm}]", ":1: worlds.0: "),
        ("worlds: [{world: room, scale: 2}]", ":1: worlds.0: world room: --scale, --up and --cloud-voxel are for mesh"),
        ("seeds: 0", ":1: seeds: 0 seeds"),
        ("seeds: [1, 2, 1]", ":1: seeds: 1 is there twice"),
        ("preset: fligt", ':1: preset: no preset is called "fligt"'),
        ("config: none.yaml", "none.yaml: no such file"),
        ("vehicles: 9", ":1: vehicles 9: fleet.largest_group = 3"),
        ("vehicles: 1.5", ":1: vehicles: 1.5"),
        ("time_limit_s: 0", ":1: time_limit_s: 0: must be a time above 0"),
        ("time_limit_s: .inf", ":1: time_limit_s: Infinity: must be a time above 0"),
        ("settings: 3", ":1: settings: 3 cannot be used"),
        ("settings: {control.margin_m: []}", ":1: settings.control.margin_m: an empty list"),
        ("settings: {control.choice: [coin, coin]}", ':1: settings.control.choice: "coin" is there twice'),
        ("draws: {control.margin_m: [1.2, 0.9]}", ":1: draws.control.margin_m: [1.2, 0.9] cannot be drawn from"),
        ("draws: {control.margin_m: [0.1, 1.2]}", ":1: draws.control.margin_m: out of range: value 0.1, bound >= 0.3"),
        ("draws: {control.choice: [0, 1]}", ":1: draws.control.choice: not usable"),
        ("{settings: {control.margin_m: 1}, draws: {control.margin_m: [1, 2]}}", "is under draws and under settings"),
        ("{worlds: 'random:1..1000', seeds: 1000}", "1000000 missions are more than 100000"),
    ],
)
def test_what_cannot_be_flown_is_refused(tmp_path: Path, text: str, line: str) -> None:
    """Protects from campaigns that fail in the night: one line, with the place where it was given."""
    said = refused(tmp_path, text)
    assert len(said) == 1, said
    assert line in said[0]


def test_what_makes_a_campaign_another_one(tmp_path: Path) -> None:
    """Protects folders: the identity follows the missions, the mesh and the vehicle, and nothing else."""
    mesh = "OFF\n8 12 0\n" + "\n".join(f"{x} {y} {z}" for x in (0, 9) for y in (0, 9) for z in (0, 3))
    faces = ("013", "032", "457", "476", "015", "054", "237", "276", "026", "064", "137", "175")
    mesh += "\n" + "\n".join(f"3 {' '.join(face)}" for face in faces) + "\n"
    (tmp_path / "hall.off").write_text(mesh, encoding="utf-8")
    (tmp_path / "vehicle.yaml").write_text("control: {height_m: 1.3}\n", encoding="utf-8")
    text = "{worlds: [{world: hall.off, start: [4, 4, 1.5, 0]}], seeds: 2, config: vehicle.yaml}"
    in_feet = text.replace("}]", ", scale: 0.9}]")
    campaign = planned(tmp_path, in_feet)
    assert again(tmp_path, campaign.missions[0]).count("--start 4.0 4.0 1.5 0.0 --scale 0.9 --cloud-voxel 0.2") == 1
    assert campaign.identity != planned(tmp_path, text).identity
    before = planned(tmp_path, text).identity
    assert planned(tmp_path, f"# a comment\n{text}").identity == before
    (tmp_path / "hall.off").write_text(mesh.replace("9 9 3", "9 9 4"), encoding="utf-8")
    assert planned(tmp_path, text).identity != before
    (tmp_path / "hall.off").write_text(mesh, encoding="utf-8")
    (tmp_path / "vehicle.yaml").write_text("control: {height_m: 1.4}\n", encoding="utf-8")
    assert planned(tmp_path, text).identity != before
