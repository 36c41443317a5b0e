"""When too little is left in the battery: by percent, by voltage, and by the autopilot's own word."""

from __future__ import annotations

import math

import pytest

from companion.gate.battery import SAG_S, Battery


def sys_status(percent: int = -1, millivolt: int = 65535) -> dict[str, int]:
    return {"battery_remaining": percent, "voltage_battery": millivolt}


@pytest.mark.parametrize(
    ("percent", "words"), [(-1, None), (101, None), (100, None), (15, None), (14, "14 %"), (0, "0 %")]
)
def test_a_percentage_below_the_bound_is_too_little(percent: int, words: str | None) -> None:
    """Protects the landing from beginning too late; what the autopilot does not say is no charge."""
    battery = Battery(15.0, None)
    assert battery.too_little(0.0) is None
    battery.on_sys_status(sys_status(percent), 64.0)
    assert battery.too_little(64.0) == words


def test_zero_is_a_bound_that_nothing_is_below() -> None:
    """Protects whoever switched the percentage off, because ArduPilot counts it from 100 % at each boot."""
    battery = Battery(0.0, None)
    battery.on_sys_status(sys_status(0), 64.0)
    assert battery.too_little(64.0) is None


def test_a_voltage_must_stay_low() -> None:
    """Protects from the sag of each climb, and from a count of percent that is wrong: the voltage is measured."""
    battery = Battery(15.0, 10.5)
    battery.on_sys_status(sys_status(100, 10_500), 63.0)
    assert battery.too_little(80.0) is None, "at the bound it is enough"
    battery.on_sys_status(sys_status(100, 10_490), 64.0)
    battery.on_sys_status(sys_status(100, 10_200), 66.0)
    assert battery.too_little(64.0 + SAG_S - 2.0**-10) is None
    assert battery.too_little(64.0 + SAG_S) == "10.20 V"
    battery.on_sys_status(sys_status(100, 10_600), 70.0)
    assert battery.too_little(80.0) is None, "it has recovered"


@pytest.mark.parametrize("millivolt", [0, 65535])
def test_a_voltage_that_is_not_known_is_not_judged(millivolt: int) -> None:
    """Protects from landing for an autopilot without a sensor: it says 0 or 65535."""
    battery = Battery(15.0, 10.5)
    battery.on_sys_status(sys_status(100, 10_000), 60.0)
    battery.on_sys_status(sys_status(100, millivolt), 64.0)
    assert battery.voltage_v is None
    assert battery.too_little(90.0) is None


def test_without_a_bound_no_voltage_is_too_low() -> None:
    """Protects vehicles of which nobody has said how many cells they have."""
    battery = Battery(15.0, None)
    battery.on_sys_status(sys_status(100, 1), 64.0)
    assert battery.voltage_v == pytest.approx(0.001)
    assert battery.too_little(math.inf) is None


@pytest.mark.parametrize(
    ("charge_state", "words"),
    [
        (0, None),
        (1, None),
        (2, None),
        (3, "critical, says the autopilot"),
        (4, "critical, says the autopilot"),
        (5, "critical, says the autopilot"),
        (6, "critical, says the autopilot"),
        (7, None),
    ],
)
def test_the_autopilots_word_counts(charge_state: int, words: str | None) -> None:
    """Protects from a percentage that says 100 of a battery that is empty; 7 is charging, which is not low."""
    battery = Battery(15.0, 10.5)
    battery.on_sys_status(sys_status(100, 12_000), 64.0)
    battery.on_battery_status({"id": 0, "charge_state": charge_state})
    assert battery.too_little(64.0) == words
    battery.on_battery_status({"id": 0, "charge_state": 1})
    assert battery.too_little(64.0) is None


def test_another_battery_is_not_ours() -> None:
    """Protects from landing for a lamp's empty battery."""
    battery = Battery(15.0, None)
    battery.on_battery_status({"id": 1, "charge_state": 4})
    assert battery.too_little(64.0) is None


@pytest.mark.parametrize(("status", "too_little"), [(3, False), (4, False), (5, True), (6, True), (7, False)])
def test_low_is_too_little_when_the_autopilot_is_in_a_failsafe(status: int, too_little: bool) -> None:
    """Protects ArduCopter's way to say it: "low", and CRITICAL in the heartbeat; each alone may mean something else."""
    battery = Battery(15.0, None)
    battery.on_system_status(status)
    assert battery.too_little(64.0) is None
    battery.on_battery_status({"id": 0, "charge_state": 2})
    assert battery.too_little(64.0) == ("low, says the autopilot" if too_little else None)
    battery.on_system_status(4)
    assert battery.too_little(64.0) is None
