"""A mission in the simulated mine: repeatable, scored from the truth, and ended for the right reason."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.config.control import ControlSettings
from companion.config.load import load_settings
from companion.config.mapping import MapSettings
from companion.config.sensors import CameraSettings, SensorSettings
from companion.config.settings import Settings
from companion.config.sim import DynamicsSettings, SimSettings
from companion.control.ground_grid import level_at
from companion.control.known_ground import Place
from companion.errors import InputError
from companion.model import Pose
from sitl.mines import World, load_world
from sitl.sim import simulation as module
from sitl.sim.flight_log import COLUMNS
from sitl.sim.judgement import Judgement
from sitl.sim.simulation import CHECK_PERIOD_S, SCORED_PERIOD_S, Progress, Simulation

LIMIT_S = 30.0
QUICK: dict[str, Any] = {
    "sensors": SensorSettings(camera=CameraSettings(width_px=64, height_px=48)),
    "mapping": MapSettings(voxel_m=0.3),
}
"""A coarse camera and a coarse map: a minute of flight takes less than a second."""

SETTINGS = Settings(**QUICK)
DONE = Settings(**QUICK, sim=SimSettings(ends="done"))
PERIOD_S = SETTINGS.control.period_s
RADIUS_M = SETTINGS.vehicle.body_radius_m
RECKLESS = Settings(
    **QUICK,
    control=ControlSettings.model_validate(
        {
            "speed_mps": 3.0,
            "max_yaw_rate_radps": 0.1,
            "speed_law": "paper",
            "law": "paper",
            "allow_turning_radius_above_margin": True,
        }
    ),
    sim=SimSettings(dynamics=DynamicsSettings(command_latency_s=1.0)),
)
"""It stands while it turns once round, for 63 s, and then flies towards a wall faster than it can see it."""
CRASH_S = 90.0


@functools.cache
def room() -> World:
    return load_world("room", seed=1)


def room_from(x_m: float, y_m: float, z_m: float) -> World:
    return replace(room(), start=Pose(0.0, x_m, y_m, z_m, 0.0))


def flown(seed: int, settings: Settings = SETTINGS, limit_s: float = LIMIT_S, vehicles: int = 1) -> Simulation:
    mission = Simulation(room(), settings, seed, vehicles)
    mission.run(limit_s)
    return mission


@pytest.fixture(scope="module")
def mission() -> Simulation:
    """Seed 1, one vehicle, half a minute: through all three modes."""
    return flown(1)


@pytest.fixture(scope="module")
def pair() -> Simulation:
    """Two vehicles, four seconds."""
    return flown(1, limit_s=4.0, vehicles=2)


@pytest.fixture(scope="module")
def crash() -> Simulation:
    return flown(1, RECKLESS, limit_s=CRASH_S)


def records(mission: Simulation) -> list[list[bytes]]:
    """Every column of every log, to the last bit."""
    return [
        [flight.log.modes.tobytes(), *(flight.log.column(name).tobytes() for name in COLUMNS)]
        for flight in mission.flights
    ]


class TestRepeatability:
    """What a seed means."""

    def test_the_same_seed_flies_the_same_mission(self, mission: Simulation) -> None:
        """Protects every comparison between runs: trajectories, maps and figures are equal to the last bit."""
        again = flown(1)
        assert records(again) == records(mission)
        np.testing.assert_array_equal(again.merged_map().occupied(), mission.merged_map().occupied())
        first, second = mission.score(), again.score()
        clock = {"wall_time_s", "times_real_time"}
        assert {k: v for k, v in first.items() if k not in clock} == {k: v for k, v in second.items() if k not in clock}

    def test_to_ask_for_the_score_changes_nothing(self) -> None:
        """Protects what two flights are compared by: it is the same before and after somebody asked for figures."""
        short = flown(1, limit_s=2.0)
        before = records(short)
        first = short.score()
        assert records(short) == before
        assert short.score() == first

    def test_another_seed_flies_another_mission(self, mission: Simulation) -> None:
        """Protects against a seed that is not used: start, noise and choices differ."""
        other = flown(2)
        for name in ("x_m", "yaw_rad", "estimated_x_m"):
            assert other.flights[0].log.column(name)[0] != mission.flights[0].log.column(name)[0], name

    def test_the_length_of_a_mission_does_not_change_its_beginning(self, mission: Simulation) -> None:
        """Protects the draws from each other: scoring and looking at the completeness draw nothing."""
        shorter = flown(1, limit_s=LIMIT_S / 2.0)
        ticks = len(shorter.flights[0].log)
        np.testing.assert_array_equal(shorter.flights[0].log.positions_m, mission.flights[0].log.positions_m[:ticks])


class TestEnd:
    """Why a mission ends."""

    @pytest.mark.parametrize("limit_s", [0.01, 1.0, 3.33])
    def test_the_time_limit_is_kept(self, limit_s: float) -> None:
        """Protects --time-limit: it ends with the first tick at or after it, and says why."""
        short = flown(1, limit_s=limit_s)
        assert short.ended_because == "time limit"
        # Times are sums of periods.
        assert limit_s - 1e-6 <= short.t_s < limit_s + PERIOD_S + 1e-6
        assert len(short.flights[0].log) == round(short.t_s / PERIOD_S)
        assert short.completed_at_s is None

    def test_a_contact_ends_the_mission(self, crash: Simulation) -> None:
        """Protects the meaning of a flight: what has touched a wall does not fly on, and the score says so."""
        assert crash.ended_because == "contact"
        assert crash.score()["contacts"] == 1
        assert crash.t_s < CRASH_S

    def test_a_contact_is_noticed_in_the_tick_in_which_it_happens(self, crash: Simulation) -> None:
        """Protects the shortcut that asks for the distance only when the vehicle can have come near enough."""
        (flight,) = crash.flights
        pose = flight.vehicle.pose
        last = np.array([[pose.x_m, pose.y_m, pose.z_m]])
        assert crash.caster.distance(last)[0] <= RADIUS_M
        assert (crash.caster.distance(flight.log.positions_m) > RADIUS_M).all()

    def test_inputs_lost_for_long_end_the_mission(self) -> None:
        """As in flight. Here the ground is out of the beam's range, as over a hole: no height, no way on."""
        beams = SETTINGS.sensors.beams.model_copy(update={"max_range_m": 1.0})
        sensors = SETTINGS.sensors.model_copy(update={"beams": beams})
        blind = flown(1, SETTINGS.model_copy(update={"sensors": sensors}), limit_s=60.0)
        assert blind.ended_because == "inputs lost"
        assert blind.t_s == pytest.approx(SETTINGS.mission.input_timeout_s, abs=0.2)

    def test_a_complete_map_ends_the_mission(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects t_f: the mission ends at the first look that finds the share, and says at which time."""
        monkeypatch.setattr(module, "COMPLETE_SHARE", 0.3)
        done = flown(1, limit_s=300.0)
        assert done.ended_because == "complete"
        assert done.completed_at_s == done.t_s < 300.0
        assert done.completeness >= 0.3
        assert all(share < 0.3 for t_s, share in done.progress if t_s < done.t_s)

    def test_the_user_may_stop_it(self) -> None:
        """Protects Ctrl-C: the mission ends where it is, and can be scored and written."""
        stopped = Simulation(room(), SETTINGS, 1)
        stopped.run(60.0, stop=lambda: stopped.t_s >= 1.0 - 1e-6)
        assert stopped.ended_because == "stopped by the user"
        assert stopped.t_s == pytest.approx(1.0)
        assert stopped.score()["ended_because"] == "stopped by the user"

    def test_the_user_may_stop_it_before_it_begins(self) -> None:
        """Protects the score of a mission without a single tick: nothing is known then, and nothing is warned of."""
        stopped = Simulation(room(), SETTINGS, 1)
        stopped.run(60.0, stop=lambda: True)
        score = stopped.score()
        assert (score["sim_time_s"], score["least_d_m"], score["time_below_d_s_fraction"]) == (0.0, None, None)


class TestProgress:
    """What is shown on the way."""

    def test_every_five_seconds_someone_is_told(self) -> None:
        """Protects the display: time, share and the flights, at the start and at every look."""
        shown: list[Progress] = []
        watched = Simulation(room(), SETTINGS, 1)
        watched.run(LIMIT_S, shown.append)
        assert [progress.t_s for progress in shown] == pytest.approx(
            np.arange(0.0, LIMIT_S, CHECK_PERIOD_S), abs=PERIOD_S
        )
        assert shown[0].completeness == 0.0
        assert shown[-1].completeness > 0.0
        assert all(progress.flights == watched.flights for progress in shown)

    def test_the_curve_of_the_completeness_begins_with_nothing_and_ends_with_the_end(self, mission: Simulation) -> None:
        """Protects the report's curve."""
        times, shares = np.array(mission.progress).T
        assert (times[0], shares[0]) == (0.0, 0.0)
        assert (times[-1], shares[-1]) == (mission.t_s, mission.completeness)
        assert (np.diff(times) > 0.0).all()
        assert ((shares >= 0.0) & (shares <= 1.0)).all()


class TestScore:
    """The figures, against the truth."""

    def test_completeness_and_missed_points_are_two_sides_of_one_thing(self, mission: Simulation) -> None:
        """Protects the completeness: the share of the visible surface within one voxel of an occupied one, by area."""
        occupied, samples = mission.merged_map().occupied(), mission.truth.samples_m
        apart = np.min([np.max(np.abs(samples - centre), axis=1) for centre in occupied], axis=0)
        # Within one voxel of an occupied voxel: no further from its middle than one and a half edges on any axis. What
        # lies on that border within a thousandth of a voxel may count either way.
        voxel_m = SETTINGS.mapping.voxel_m
        found = apart <= 1.5 * voxel_m
        border = np.abs(apart - 1.5 * voxel_m) < 1e-3 * voxel_m
        areas = mission.truth.sample_areas_m2.astype(np.float64) / mission.truth.sample_areas_m2.sum(dtype=np.float64)
        assert mission.completeness == pytest.approx(areas[found].sum(), abs=areas[border].sum() + 1e-6)
        missed = mission.missed_m()
        assert abs(len(missed) - np.count_nonzero(~found)) <= np.count_nonzero(border)
        assert {tuple(point) for point in samples[~found & ~border]} <= {tuple(point) for point in missed}
        assert 0.05 < mission.completeness < 0.95

    def test_the_true_distance_is_that_to_the_walls_of_the_room(self, mission: Simulation) -> None:
        """Protects d in the score: from the mesh, ten times a second, and not what the vehicle believed.

        The room's six walls are known. The distance is the shortest of a fan of 72 rays: to a wall it is longer than
        the true one by at most the secant of 2.5°; past the edge of the inner corner a ray may go further.
        """
        score = mission.score()
        (flight,) = mission.flights
        every = round(SCORED_PERIOD_S / PERIOD_S)
        recorded = flight.log.column("true_d_m")
        assert np.isfinite(recorded[::every]).all()
        assert np.isnan(np.delete(recorded, np.s_[::every])).all()
        x, y, _ = flight.log.positions_m[::every].T
        walls = np.minimum.reduce(
            [x, 10.0 - x, y, np.where(x < 6.4, 3.6 - y, 7.0 - y), np.where(y > 3.6, x - 6.4, np.inf)]
        )
        true = np.minimum(walls, np.hypot(6.4 - x, 3.6 - y))
        # Rays are float32.
        assert (recorded[::every] >= true - 1e-5).all()
        at_wall = walls == true
        assert (recorded[::every][at_wall] <= true[at_wall] / math.cos(math.radians(2.5)) + 1e-5).all()
        assert at_wall.any()
        assert score["least_d_m"] == pytest.approx(float(np.nanmin(recorded)), abs=5e-4)

    def test_the_share_of_time_below_the_margin_is_that_of_the_log(self, crash: Simulation) -> None:
        """Protects time_below_d_s_fraction, on a flight which certainly came too near."""
        score = crash.score()
        recorded = crash.flights[0].log.column("true_d_m")
        recorded = recorded[np.isfinite(recorded)]
        margin_m = RECKLESS.control.margin_m
        assert score["time_below_d_s_fraction"] == pytest.approx(np.mean(recorded < margin_m), abs=5e-6)
        assert np.mean(recorded < margin_m) > 0.0

    def test_the_clearance_is_what_is_left_beside_the_body(self, mission: Simulation, crash: Simulation) -> None:
        """Protects what no figure showed: rock above and below counts, and a contact is where nothing is left."""
        (flight,) = mission.flights
        radius_m = SETTINGS.vehicle.body_radius_m
        least_m = float(mission.caster.distance(flight.log.positions_m).min()) - radius_m
        assert mission.score()["least_clearance_m"] == pytest.approx(least_m, abs=0.01)
        touched_m = crash.score()["least_clearance_m"]
        assert isinstance(touched_m, float)
        assert crash.score()["contacts"] == 1
        assert -0.05 <= touched_m <= 0.0

    def test_the_path_is_the_sum_of_the_steps(self, mission: Simulation) -> None:
        """Protects path_length_m, rounded to 1 cm; what is missing in the log is the way of the last tick."""
        (flight,) = mission.flights
        steps_m = np.linalg.norm(np.diff(flight.log.positions_m, axis=0), axis=1)
        length_m = mission.score()["path_length_m"]
        assert isinstance(length_m, float)
        assert -0.005 <= length_m - steps_m.sum() <= SETTINGS.control.speed_mps * PERIOD_S + 0.005

    def test_the_time_is_the_simulated_one(self, mission: Simulation) -> None:
        """Protects the pace: how much faster than a clock the simulation was."""
        score = mission.score()
        assert score["sim_time_s"] == pytest.approx(mission.t_s, abs=1e-3)
        assert score["times_real_time"] == pytest.approx(mission.t_s / mission.wall_time_s, rel=0.01)
        assert isinstance(score["versions"], dict)
        assert {"python", "mine-companion", "numpy", "numba"} <= set(score["versions"])


class TestStart:
    """Where a mission may begin."""

    def test_a_drawn_start_keeps_the_margin_and_the_height(self) -> None:
        """Protects Assumption 2.1 as far as there is room: d_s to every wall, H above the floor."""
        for seed in range(20):
            (flight,) = Simulation(room(), SETTINGS, seed).flights
            pose = flight.vehicle.pose
            assert pose.z_m == pytest.approx(SETTINGS.control.height_m, abs=1e-5)
            assert min(pose.y_m, 10.0 - pose.x_m, pose.x_m) >= SETTINGS.control.margin_m - 1e-5
            assert -math.pi <= pose.yaw_rad < math.pi

    def test_the_start_of_a_world_is_used(self) -> None:
        """Protects --start: where the user puts the vehicle, there it is."""
        world = room_from(2.0, 1.8, 1.5)
        assert Simulation(world, SETTINGS, 1).flights[0].vehicle.pose == world.start

    @pytest.mark.parametrize(
        ("start", "said"),
        [
            ((-1.0, 1.8, 1.5), "outside"),
            ((3.0, 5.0, 1.5), "outside"),
            ((2.0, 0.2, 1.5), "nearest surface"),
            ((2.0, 1.8, 2.6), "nearest surface"),
        ],
    )
    def test_a_start_in_a_wall_is_refused(self, start: tuple[float, float, float], said: str) -> None:
        """Protects from a flight that begins with a contact, or outside of the mine where nothing is."""
        with pytest.raises(InputError, match=said):
            Simulation(room_from(*start), SETTINGS, 1)

    def test_a_margin_that_fits_nowhere_is_refused(self) -> None:
        """Protects from starting without room: the message names the setting and its value."""
        wide = Settings(**QUICK, control=ControlSettings.model_validate({"margin_m": 1.9}))
        with pytest.raises(InputError, match=r"control\.margin_m = 1\.9 m"):
            Simulation(room(), wide, 1)


class TestSeveral:
    """Several vehicles in one mine."""

    @pytest.mark.parametrize("seed", range(5))
    def test_they_start_apart(self, seed: int) -> None:
        """Protects the start from being a collision: two margins between any two, each with its own number."""
        three = Simulation(room(), SETTINGS, seed, vehicles=3)
        poses = [flight.vehicle.pose for flight in three.flights]
        for i, a in enumerate(poses):
            for b in poses[i + 1 :]:
                apart_m = math.dist((a.x_m, a.y_m, a.z_m), (b.x_m, b.y_m, b.z_m))
                assert apart_m >= 2.0 * SETTINGS.control.margin_m - 1e-6
        assert [flight.log.vehicle_id for flight in three.flights] == [1, 2, 3]
        assert len({pose.yaw_rad for pose in poses}) == 3

    def test_each_flies_on_its_own(self, pair: Simulation) -> None:
        """Protects the seeds from being shared: noise and disturbance of the vehicles are not the same."""
        first, second = (flight.log for flight in pair.flights)
        assert len(first) == len(second) == round(pair.t_s / PERIOD_S)
        errors = [log.column("estimated_x_m") - log.column("x_m") for log in (first, second)]
        assert (errors[0] != errors[1]).any()

    def test_the_least_distance_between_them_is_watched(self, pair: Simulation) -> None:
        """Protects the score of a fleet, against the distances of the logs tick by tick."""
        first, second = (flight.log.positions_m for flight in pair.flights)
        apart_m = np.linalg.norm(first - second, axis=1)
        assert pair.score()["least_distance_between_vehicles_m"] == pytest.approx(apart_m.min(), abs=5e-4)

    def test_the_map_is_the_union(self, pair: Simulation) -> None:
        """Protects V (paper eq. (5)): what any of them has mapped is in it, and their own maps are left alone."""
        own = [flight.map.occupied() for flight in pair.flights]
        merged = pair.merged_map()
        for points in own:
            assert len(points) > 0
            assert merged.occupied_near(points).all()
        assert len(merged.occupied()) > max(len(points) for points in own)
        for flight, points in zip(pair.flights, own, strict=True):
            np.testing.assert_array_equal(flight.map.occupied(), points)

    def test_one_start_cannot_be_shared(self) -> None:
        """Protects from two vehicles in one place."""
        with pytest.raises(InputError, match="2 vehicles"):
            Simulation(room_from(2.0, 1.8, 1.5), SETTINGS, 1, vehicles=2)

    def test_more_than_there_is_room_for_are_refused(self) -> None:
        """Protects from a search without end: the room holds no 30 vehicles 2 m apart."""
        with pytest.raises(InputError, match="30 vehicles"):
            Simulation(room(), SETTINGS, 1, vehicles=30)


def test_alone_the_map_is_not_copied(mission: Simulation) -> None:
    """Protects memory: the one map of the one vehicle is V."""
    assert mission.merged_map() is mission.flights[0].map
    assert mission.score()["least_distance_between_vehicles_m"] is None


class TestOwnWord:
    """What the vehicle itself would say, beside the truth."""

    def test_its_word_ends_a_mission_only_where_it_is_asked_for(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Protects t_f: by default the truth ends it, and when the vehicle would have said so is noted beside."""
        monkeypatch.setattr(Judgement, "look", lambda _, t_s: t_s > 9.0)
        by_truth, by_word = flown(1, limit_s=12.0), flown(1, DONE, limit_s=12.0)
        assert (by_truth.ended_because, by_word.ended_because) == ("time limit", "done")
        assert by_word.t_s == pytest.approx(2.0 * CHECK_PERIOD_S, abs=PERIOD_S)
        assert by_truth.completeness_when_done == by_word.completeness_when_done == by_word.completeness

    @pytest.mark.long
    def test_it_ends_when_the_vehicle_is_done(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """As in flight: no truth ends it. The truth is noted beside, and was reached on the way."""
        monkeypatch.setattr(module, "COMPLETE_SHARE", 0.3)
        done = flown(1, DONE, limit_s=600.0)
        score = done.score()
        assert done.ended_because == "done"
        assert score["done_at_s"] == pytest.approx(done.t_s, abs=0.01)
        assert done.completed_at_s is not None
        assert done.completed_at_s < done.t_s
        assert done.estimated_completeness == pytest.approx(1.0, abs=0.1)
        assert score["completeness_when_done"] == pytest.approx(done.completeness, abs=0.01)
        assert done.completeness > 0.9, "half of a room is not done"

    def test_a_mission_that_was_cut_short_is_not_done(self, mission: Simulation) -> None:
        """What it had still open it names, and it does not take its map for whole."""
        score = mission.score()
        assert score["done_at_s"] is None
        assert score["completeness_when_done"] is None
        assert 0.0 < float(str(score["estimated_completeness"])) < 1.0
        assert "not reached" in {place.why.value for place in mission.left_out}
        assert score["left_out"] == [place.as_json() for place in mission.left_out]


@pytest.mark.long
def test_two_pass_above_each_other_and_go_on() -> None:
    """Protects the meeting of vehicles that see each other: the upper one takes the lower one's back for no ground.

    Taken for one it was the edge of a shaft when it had passed, and the upper one stood there until its inputs were
    lost.
    """
    two = Simulation(load_world("complex", 4, None), load_settings(None, "flight"), 4, vehicles=2)
    two.run(50.0)
    first, second = (flight.log.positions_m for flight in two.flights)
    beside_m, up_m = np.hypot(*(first - second)[:, :2].T), np.abs(first[:, 2] - second[:, 2])
    assert beside_m.min() < 0.7, "they did not pass above each other: another seed is needed"
    assert up_m[beside_m < 0.7].min() > 0.5
    assert (two.ended_because, two.encounters.collisions, two.encounters.too_near_s) == ("time limit", 0, 0.0)
    assert all(flight.blind_s == 0.0 for flight in two.flights)
    assert np.isfinite(two.flights[0].log.column("h_m")).all()
    # What each has seen the other knows too.
    for flight, other in (two.flights, two.flights[::-1]):
        there = Place.under(other.vehicle.pose, other.measurement.h_m if other.measurement else None)
        known = flight.navigator.known_ground.window(there.x_m, there.y_m)
        assert known is not None
        row, column = known.cell(there)
        assert level_at(known.grid, row, column, there.ground_dm) >= 0
