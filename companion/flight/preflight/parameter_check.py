"""What parameters of an autopilot must be, and the check whether they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from companion.autopilot.interface import Link, LinkError
from companion.flight.preflight.result import CheckResult

Value = float | int
SAME = 1e-6
"""Parameters are 32-bit floats on the wire."""


@dataclass(frozen=True, slots=True)
class Demand:
    """What one parameter must be: one of ``values``, or from ``low`` to ``high``, or with all bits of ``mask`` set.

    What it is to be set to is None where only the owner of the vehicle can know.
    """

    name: str
    wanted: str
    set_to: Value | None
    values: tuple[Value, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    mask: int | None = None

    def met_by(self, value: Value) -> bool:
        """Whether a value will do."""
        if not math.isfinite(value):
            return False
        if self.mask is not None:
            return int(value) & self.mask == self.mask
        if self.values:
            return any(math.isclose(value, one, rel_tol=SAME, abs_tol=SAME) for one in self.values)
        slack = SAME * max(1.0, abs(value))
        return self.low - slack <= value <= self.high + slack

    def fixed(self, value: Value) -> Value | None:
        """What to set it to when it is ``value``; None: nobody here knows."""
        return int(value) | self.mask if self.mask is not None else self.set_to


@dataclass(frozen=True, slots=True)
class Rule:
    """One check of parameters.

    Attributes:
        either: the rule holds when all demands of one of these groups are met; the first is what --fix sets.
        reason: why, in one sentence with the measured fact.
        required: whether the check fails when the autopilot has no such parameter.
        reboot: whether the autopilot obeys a new value only after a reboot.
        advice: what to do where --fix cannot know the value.
    """

    either: tuple[tuple[Demand, ...], ...]
    reason: str
    required: bool = False
    reboot: bool = False
    advice: str = ""

    @property
    def name(self) -> str:
        """Of the check: that of its first parameter."""
        return self.either[0][0].name

    @property
    def wanted(self) -> str:
        """In words."""
        return ", or ".join(" and ".join(f"{one.name} {one.wanted}" for one in group) for group in self.either)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of all that are looked at."""
        return tuple(dict.fromkeys(one.name for group in self.either for one in group))


def exactly(name: str, value: Value) -> Demand:
    """This value and no other."""
    return Demand(name, f"{value:g}", value, values=(value,))


def one_of(name: str, values: tuple[Value, ...], meaning: str) -> Demand:
    """One of these values; --fix sets the first.

    Args:
        name: of the parameter.
        values: that will do.
        meaning: of the values, in words.
    """
    return Demand(name, f"{' or '.join(f'{value:g}' for value in values)} ({meaning})", values[0], values=values)


def at_least(name: str, low: float) -> Demand:
    """This or more."""
    return Demand(name, f"at least {low:g}", low, low=low)


def between(name: str, low: float, high: float, set_to: float) -> Demand:
    """From one bound to the other."""
    return Demand(name, f"{low:g} to {high:g}", set_to, low=low, high=high)


def bits(name: str, mask: int, meaning: str) -> Demand:
    """With all bits of a mask set; --fix leaves the others as they are."""
    return Demand(name, f"with the bits of {mask} ({meaning})", mask, mask=mask)


async def check_rule(link: Link, rule: Rule, fix: bool) -> CheckResult:
    """Whether the autopilot's parameters are as a rule wants them; with ``fix`` they are made so. Never raises."""
    try:
        values = {name: await link.get_param(name) for name in rule.parameters}
    except LinkError as error:
        return CheckResult(rule.name, False, str(error), rule.wanted, rule.reason, "ask again on a better link")
    if all(value is None for value in values.values()):
        found = "the autopilot has no such parameter"
        return CheckResult(rule.name, not rule.required, found, rule.wanted, rule.reason)
    found = ", ".join(f"{name} {_value(value)}" for name, value in values.items())
    if _holds(rule, values):
        return CheckResult(rule.name, True, found, rule.wanted, rule.reason)
    group = next((group for group in rule.either if all(values[one.name] is not None for one in group)), ())
    fixed = {one.name: one.fixed(value) for one in group if (value := values[one.name]) is not None}
    changes = {name: value for name, value in fixed.items() if value is not None}
    if len(changes) < len(fixed):
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, rule.advice)
    commands = " and ".join(f"param set {name} {_value(value)}" for name, value in changes.items())
    after = ", then reboot the autopilot" if rule.reboot else ""
    if not fix or not changes:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"{commands}{after}, or --fix")
    try:
        for name, value in changes.items():
            await link.set_param(name, value)
    except LinkError as error:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"--fix failed: {error}")
    done = f"set by --fix: {commands}"
    if rule.reboot:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"{done}; reboot the autopilot to apply")
    return CheckResult(rule.name, True, f"was {found}", rule.wanted, rule.reason, done)


def _holds(rule: Rule, values: Mapping[str, Value | None]) -> bool:
    return any(
        all((value := values[one.name]) is not None and one.met_by(value) for one in group) for group in rule.either
    )


def _value(value: Value | None) -> str:
    return "(none)" if value is None else f"{value:.7g}"
