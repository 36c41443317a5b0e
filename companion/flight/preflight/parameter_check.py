"""Asks the autopilot for its parameters and, when told to, sets them."""

from __future__ import annotations

from collections.abc import Mapping

from companion.autopilot.interface import Link, LinkError
from companion.flight.preflight.parameter_rules import Rule, Value
from companion.flight.preflight.result import CheckResult


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
    changes = {one.name: one.fixed(value) for one in group if (value := values[one.name]) is not None}
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
