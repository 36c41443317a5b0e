"""Groups of vehicles and their height layers, paper eq. (11)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.fleet import MOST_VEHICLES, PARTS, Fleet, Report, connected, layer_height_m, near_pairs

D_R, D_M, STALE_S = 4.0, 3.0, 1.0
ALONE_M = 1.5

ids = st.integers(1, 50)
groups = st.frozensets(ids, min_size=1, max_size=20)
across, up = st.floats(-6.0, 6.0), st.floats(0.0, 3.0)
fleets = st.dictionaries(ids, st.builds(Report, st.just(0.0), across, across, up), min_size=2, max_size=10)
"""Vehicles in a space a few times as wide as d_r: alone, in pairs and in chains."""


def lone(own_id: int) -> Fleet:
    """What a vehicle knows of the others before it has heard any."""
    return Fleet(own_id, group_range_m=D_R, tunnel_height_m=D_M, stale_after_s=STALE_S)


def along(x_m: float, t_s: float = 0.0) -> Report:
    """A report from a place on the x axis."""
    return Report(t_s, x_m, 0.0, 1.5)


def fleet_of(own_id: int, places_m: dict[int, float], t_s: float = 0.0) -> Fleet:
    """What a vehicle knows that has heard all of them, itself included."""
    fleet = lone(own_id)
    for vehicle_id, x_m in places_m.items():
        fleet.on_report(vehicle_id, along(x_m, t_s))
    return fleet


# (11).


def test_layers_by_hand() -> None:
    """Three vehicles in 3 m: 0.75 m apart, the smallest number flies highest, the largest not on the ground."""
    heights = [layer_height_m(own_id, frozenset({1, 2, 3}), 3.0) for own_id in (1, 2, 3)]
    assert heights == [2.25, 1.5, 0.75]


@given(group=groups, d_m_m=st.floats(1.0, 50.0))
def test_layers_are_even_and_clear_of_ground_and_roof(group: frozenset[int], d_m_m: float) -> None:
    """(11) with m in 1..n: d_M/(n + 1) apart, as far from the ground as from the roof, never 0."""
    step_m = d_m_m / (len(group) + 1)
    heights = sorted(layer_height_m(own_id, group, d_m_m) for own_id in group)
    # Multiples of a third or a seventh round by 2^-53 of 50 m.
    assert heights[0] == pytest.approx(step_m, abs=1e-13)
    assert heights[-1] == pytest.approx(d_m_m - step_m, abs=1e-13)
    assert all(above - below == pytest.approx(step_m, abs=1e-13) for below, above in pairwise(heights))


@given(group=groups)
def test_all_members_agree_on_who_flies_above_whom(group: frozenset[int]) -> None:
    """Every vehicle computes its own layer only; that they differ follows from the order of the numbers."""
    heights = [layer_height_m(own_id, group, D_M) for own_id in sorted(group)]
    assert all(first > second for first, second in pairwise(heights))


def test_a_vehicle_alone_keeps_its_height() -> None:
    """No layer without a reason: H of the settings while nobody is near, also before anything was heard."""
    assert lone(1).height_m(0.0, ALONE_M) == ALONE_M
    assert fleet_of(1, {1: 0.0, 2: D_R}).height_m(0.0, ALONE_M) == ALONE_M


def test_a_vehicle_in_a_group_takes_its_layer() -> None:
    """Two vehicles in 3 m of height: one at 1 m, one at 2 m, and both know which."""
    places_m = {1: 0.0, 2: 3.0}
    assert fleet_of(1, places_m).height_m(0.0, ALONE_M) == 2.0
    assert fleet_of(2, places_m).height_m(0.0, ALONE_M) == 1.0


# Groups.


def test_a_group_is_joined_by_chains() -> None:
    """1 and 3 are 6 m apart, beyond d_r = 4 m, but 2 is near to both; 4 is near to nobody."""
    places_m = {1: 0.0, 2: 3.0, 3: 6.0, 4: 20.0}
    for own_id in (1, 2, 3):
        assert fleet_of(own_id, places_m).group(0.0) == {1, 2, 3}
    assert fleet_of(4, places_m).group(0.0) == {4}


@pytest.mark.parametrize(("apart_m", "group"), [(3.999, {1, 2}), (4.0, {1}), (4.001, {1})])
def test_near_is_below_the_group_range(apart_m: float, group: set[int]) -> None:
    """The paper: a group is where the distance is smaller than d_r."""
    assert fleet_of(1, {1: 0.0, 2: apart_m}).group(0.0) == group


def test_a_group_is_left_further_away_than_it_is_joined() -> None:
    """Who flies along at d_r would change its layer with every metre: it parts only a quarter further off."""
    fleet = fleet_of(1, {1: 0.0, 2: 0.9 * D_R})
    assert fleet.group(0.0) == {1, 2}
    fleet.on_report(2, along(0.99 * PARTS * D_R, 0.1))
    assert fleet.group(0.1) == {1, 2}
    fleet.on_report(2, along(1.01 * PARTS * D_R, 0.2))
    assert fleet.group(0.2) == {1}
    fleet.on_report(2, along(0.99 * PARTS * D_R, 0.3))
    assert fleet.group(0.3) == {1}


def test_who_has_landed_is_in_no_group() -> None:
    """It needs no layer; when it takes off again it does."""
    fleet = fleet_of(1, {1: 0.0, 2: 3.0})
    fleet.on_report(2, Report(1.0, 3.0, 0.0, 0.1, flies=False))
    assert fleet.group(9.0) == {1}
    fleet.on_report(2, Report(9.0, 3.0, 0.0, 0.5))
    assert fleet.group(9.0) == {1, 2}


def test_no_more_reports_are_kept_than_anybody_flies() -> None:
    """Whatever comes over a network must not fill the memory; those that are known are still heard."""
    fleet = lone(1)
    for vehicle_id in range(2, 3 * MOST_VEHICLES):
        fleet.on_report(vehicle_id, along(0.0))
    fleet.on_report(1, along(0.0))
    assert fleet.group(0.0) == set(range(1, MOST_VEHICLES + 2))
    fleet.on_report(2, along(50.0, 1.0))
    assert 2 not in fleet.group(1.0)


def test_distance_counts_height_too() -> None:
    """Two vehicles on two levels of the mine, one above the other, are no group."""
    reports = {1: Report(0.0, 0.0, 0.0, 1.5), 2: Report(0.0, 0.0, 0.0, 9.5)}
    assert connected(near_pairs(reports, D_R), 1) == {1}


def components(reports: dict[int, Report]) -> list[set[int]]:
    """Connected components by merging, an independent way to the same answer."""
    found: list[set[int]] = []
    for vehicle_id, here in reports.items():
        near = {
            other_id
            for other_id, there in reports.items()
            if math.dist((here.x_m, here.y_m, here.z_m), (there.x_m, there.y_m, there.z_m)) < D_R
        } | {vehicle_id}
        touching = [component for component in found if component & near]
        found = [component for component in found if not component & near] + [near.union(*touching)]
    return found


def in_one(found: Iterable[set[int]], vehicle_id: int) -> set[int]:
    """The component that holds a vehicle."""
    return next(component for component in found if vehicle_id in component)


@given(reports=fleets)
def test_groups_are_the_connected_components(reports: dict[int, Report]) -> None:
    """Any set of places: each vehicle's group is its component, so that all its members have the same one."""
    found = components(reports)
    for own_id in reports:
        fleet = lone(own_id)
        for vehicle_id, report in reports.items():
            fleet.on_report(vehicle_id, report)
        assert fleet.group(0.0) == in_one(found, own_id)


@given(reports=fleets)
def test_vehicles_of_a_group_never_share_a_layer(reports: dict[int, Report]) -> None:
    """What (11) is for: with the same word from everybody, members are at least d_M/(n + 1) apart in height."""
    for component in components(reports):
        if len(component) == 1:
            continue
        heights = []
        for own_id in sorted(component):
            fleet = lone(own_id)
            for vehicle_id, report in reports.items():
                fleet.on_report(vehicle_id, report)
            heights.append(fleet.height_m(0.0, ALONE_M))
        # Rounding of multiples of d_M/(n + 1).
        assert all(high - low >= D_M / (len(component) + 1) - 1e-12 for high, low in pairwise(heights))


# Silence.


def test_a_silent_vehicle_keeps_its_layer() -> None:
    """2 falls silent beside 1. However far 1 flies, 2 may be with it still, and its layer stays reserved."""
    fleet = fleet_of(1, {1: 0.0, 2: 3.0})
    assert fleet.height_m(0.0, ALONE_M) == 2.0
    for t_s in range(1, 60):
        fleet.on_report(1, along(-0.5 * t_s, t_s))
        assert fleet.height_m(float(t_s) + 0.5, ALONE_M) == 2.0


def test_a_vehicle_that_reports_from_afar_leaves_the_group() -> None:
    """It is silence that reserves a layer, not having once been near: a fresh report from 10 m away frees it."""
    fleet = fleet_of(1, {1: 0.0, 2: 3.0})
    assert fleet.group(0.0) == {1, 2}
    fleet.on_report(2, along(10.0, 30.0))
    assert fleet.group(30.0) == {1}
    # And falling silent out there does not bring it back.
    assert fleet.group(90.0) == {1}


def test_a_vehicle_that_fell_silent_afar_is_met_where_it_was() -> None:
    """Its last position counts on: flying there, the vehicle makes room for it."""
    fleet = fleet_of(1, {1: 0.0, 2: 50.0})
    assert fleet.group(0.0) == {1}
    fleet.on_report(1, along(48.0, 100.0))
    assert fleet.group(100.0) == {1, 2}


@pytest.mark.parametrize(("age_s", "group"), [(0.9, {1}), (1.1, {1, 2})])
def test_silence_begins_when_the_report_is_stale(age_s: float, group: set[int]) -> None:
    """Up to the set age a report says where the vehicle is; afterwards only where it was."""
    fleet = fleet_of(1, {1: 0.0, 2: 3.0})
    assert fleet.group(0.0) == {1, 2}
    fleet.on_report(1, along(-10.0, age_s))
    assert fleet.group(age_s) == group


# Reports.


def test_a_report_that_comes_late_is_ignored() -> None:
    """Radio messages overtake each other: the newest counts, in whatever order they come."""
    fleet = fleet_of(1, {1: 0.0, 2: 50.0}, t_s=10.0)
    fleet.on_report(2, along(3.0, 9.9))
    assert fleet.group(10.0) == {1}
    fleet.on_report(2, along(3.0, 10.1))
    assert fleet.group(10.1) == {1, 2}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", range(4))
def test_a_report_that_is_not_finite_is_ignored(field: int, bad: float) -> None:
    """NaN compares false and would make a vehicle invisible, an infinite time would shut out all that follow."""
    fleet = fleet_of(1, {1: 0.0, 2: 3.0})
    numbers = [1.0, 3.0, 0.0, 1.5]
    numbers[field] = bad
    t_s, x_m, y_m, z_m = numbers
    fleet.on_report(2, Report(t_s, x_m, y_m, z_m))
    assert fleet.group(0.0) == {1, 2}
    fleet.on_report(2, along(50.0, 2.0))
    assert fleet.group(2.0) == {1}


@given(
    reports=st.lists(
        st.tuples(st.integers(1, 4), st.builds(Report, st.floats(), st.floats(), st.floats(), st.floats())), max_size=30
    ),
    times_s=st.lists(st.floats(0.0, 1e6), min_size=1, max_size=5),
)
def test_the_height_is_always_one_of_a_group_that_holds_the_vehicle(
    reports: list[tuple[int, Report]], times_s: list[float]
) -> None:
    """Whatever is heard in whatever order: finite, above the ground, below the roof, and 1 is always in its group."""
    fleet = lone(1)
    for vehicle_id, report in reports:
        fleet.on_report(vehicle_id, report)
        for t_s in times_s:
            group = fleet.group(t_s)
            assert 1 in group
            expected_m = ALONE_M if len(group) == 1 else layer_height_m(1, group, D_M)
            assert fleet.height_m(t_s, ALONE_M) == expected_m
            assert 0.0 < expected_m < D_M
