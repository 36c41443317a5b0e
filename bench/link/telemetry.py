"""What it costs that telemetry is sealed: its size, the bandwidth that it takes, and what sealing and opening take.

python -m bench.link.telemetry
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from bench.common import say
from companion.config.link import LinkSettings
from companion.link.authority import Authority
from companion.link.certificates import Certificates
from companion.link.ground.telemetry_guard import TelemetryGuard
from companion.link.sealing import Proofs, Seal
from companion.link.vehicle.bandwidth import OVERHEAD_BYTES
from companion.link.wire import Report, encoded
from companion.link.words import Telemetry

SESSION, GROUND = "0123456789abcdef", "fedcba9876543210"
FOR_S = 60.0


def main() -> None:
    """Print it."""
    with tempfile.TemporaryDirectory() as folder:
        authority = Authority.make(Path(folder) / "authority")
        authority.issue("drone1", "vehicle", Path(folder) / "drone1")
        authority.issue("anna", "command", Path(folder) / "anna")
        _print(None, None)
        _print(Certificates(Path(folder) / "drone1"), Certificates(Path(folder) / "anna"))


def _print(vehicle: Certificates | None, ground: Certificates | None) -> None:
    seal, guard = Seal(SESSION, vehicle), TelemetryGuard(GROUND, Proofs(ground))
    period_s = 1.0 / LinkSettings().telemetry_hz
    plain, sealed, sealing_s, opening_s = list[int](), list[int](), list[float](), list[float]()
    for number in range(round(FOR_S / period_s)):
        now_s = number * period_s
        message = encoded(Report(SESSION, 100.0 + now_s, "20261129-113000", 12, _telemetry(number, now_s)))
        began_s = time.perf_counter()
        data = seal.sealed(message, {GROUND: (GROUND, 0)}, now_s)
        sealing_s.append(time.perf_counter() - began_s)
        began_s = time.perf_counter()
        if guard.opened("drone1", data) is None:
            raise AssertionError("what was sealed is not opened")
        opening_s.append(time.perf_counter() - began_s)
        plain.append(len(message))
        sealed.append(len(data))
    say(
        f"{'not signed' if vehicle is None else 'signed'}: {np.mean(plain):.0f} bytes are {np.mean(sealed):.0f}, "
        f"{_kbps(plain):.1f} kbit/s are {_kbps(sealed):.1f}; sealing {_ms(sealing_s)}, opening {_ms(opening_s)}, "
        f"so {100.0 * np.mean(sealing_s) / period_s:.2f} % of a core on the vehicle and "
        f"{100.0 * np.mean(opening_s) / period_s:.2f} % at the ground"
    )


def _kbps(sizes: list[int]) -> float:
    return 8e-3 * (sum(sizes) + len(sizes) * OVERHEAD_BYTES) / FOR_S


def _ms(values_s: list[float]) -> str:
    return f"{1e3 * float(np.quantile(values_s, 0.5)):.2f} ms (99 %: {1e3 * float(np.quantile(values_s, 0.99)):.2f})"


def _telemetry(number: int, now_s: float) -> Telemetry:
    """As in a flight."""
    return Telemetry(
        vehicle="drone1",
        flight="20261129-113000",
        number=number,
        t_s=4321.123456789 + now_s,
        phase="exploring",
        mode="R2 along tangent",
        x_m=12.345678901234,
        y_m=-3.456789012345,
        z_m=1.5678901234567,
        yaw_rad=0.12345678901234,
        d_m=1.2345678901234,
        margin_m=1.0,
        h_m=1.5123456789012,
        height_m=1.5,
        target_m=(14.567890123456, -2.345678901234, 1.5678901234567),
        battery_percent=73.0,
        home_m=25.678901234567,
        home_s=64.197253086419,
        left_at_home_percent=55.432109876543,
        reserve_percent=25.0,
        completeness=0.41234567890123,
        frontiers=2,
    )


if __name__ == "__main__":
    main()
