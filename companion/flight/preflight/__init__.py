"""Pre-flight: everything that decides whether a flight may begin, each with what was found and what is wanted."""

from companion.flight.preflight.checks import ON_THE_GROUND, check_names, run_checks
from companion.flight.preflight.result import CheckResult, refusal, render

__all__ = ["ON_THE_GROUND", "CheckResult", "check_names", "refusal", "render", "run_checks"]
