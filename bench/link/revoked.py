"""How soon somebody who is revoked in flight hears nothing any more, and how long the others hear nothing for it.

python -m bench.link.revoked
"""

from __future__ import annotations

import socket
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from bench.common import say
from companion.config.link import LinkSettings
from companion.link.authority import Authority
from companion.link.certificates import REVOKED
from companion.link.ground.station import LinkStation
from companion.link.vehicle.pipe import Kind, pair, receive, send
from companion.link.vehicle.process import LinkProcess
from companion.link.wire import encoded
from companion.link.words import Telemetry
from sitl.launch.processes import free_tcp_port

TIMES, FOR_S, PERIOD_S = 8, 8.0, 0.05


def main() -> None:
    """Print it."""
    cut_s, gaps_s = list[float](), list[float]()
    for _ in range(TIMES):
        with tempfile.TemporaryDirectory() as folder:
            heard_until_s, gap_s = _once(Path(folder))
        cut_s.append(heard_until_s)
        gaps_s.append(gap_s)
    say(
        f"revoked {TIMES} times: heard for {np.median(cut_s):.2f} s more (most: {max(cut_s):.2f} s); "
        f"the other one heard nothing for {np.median(gaps_s):.2f} s (most: {max(gaps_s):.2f} s)"
    )


def _once(folder: Path) -> tuple[float, float]:
    """How long who is revoked went on hearing, and the longest time in which the other one heard nothing."""
    authority = Authority.make(folder / "authority")
    authority.issue("drone1", "vehicle", folder / "drone1")
    for name in ("anna", "bob"):
        authority.issue(name, "watch", folder / name)
    endpoint = f"tls/127.0.0.1:{free_tcp_port()}"
    settings = LinkSettings.model_validate(
        {"enabled": True, "name": "drone1", "listen": [endpoint], "certificates": str(folder / "drone1")}
    )
    end, theirs = pair()
    process = LinkProcess(theirs, settings, folder / "flight" / "map.journal")
    over = threading.Event()
    threads = [threading.Thread(target=process.run), threading.Thread(target=_tell, args=(end, over))]
    for thread in threads:
        thread.start()
    try:
        with (
            LinkStation(folder / "a", connect=[endpoint], certificates=folder / "anna") as anna,
            LinkStation(folder / "b", connect=[endpoint], certificates=folder / "bob") as bob,
        ):
            while not all(one.vehicles() and one.vehicles()[0].age_s < 1.0 for one in (anna, bob)):
                time.sleep(PERIOD_S)
            authority.revoke("bob")
            (folder / "drone1" / REVOKED).write_bytes((folder / "authority" / REVOKED).read_bytes())
            began_s, gap_s = time.monotonic(), 0.0
            while time.monotonic() - began_s < FOR_S:
                time.sleep(PERIOD_S)
                gap_s = max(gap_s, anna.vehicles()[0].age_s)
            return max(0.0, time.monotonic() - bob.vehicles()[0].age_s - began_s), gap_s
    finally:
        over.set()
        threads[1].join()
        end.close()
        threads[0].join()
        process.close()


def _tell(end: socket.socket, over: threading.Event) -> None:
    number = 0
    while not over.wait(0.2):
        number += 1
        send(end, Kind.TELEMETRY, encoded(Telemetry("drone1", "flight", number, 0.2 * number, "exploring")))
        while receive(end) is not None:
            pass


if __name__ == "__main__":
    main()
