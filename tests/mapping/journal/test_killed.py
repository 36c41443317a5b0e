"""A process that is killed while it writes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from companion.mapping.journal import Journal
from tests.mapping.journal.journals import held, surface

CHUNKS = 12

CHILD = """
import sys
from pathlib import Path
from companion.mapping.journal import Journal
from tests.mapping.journal.journals import HEADER, piece, surface

step, compacts = int(sys.argv[2]), sys.argv[3] == "True"
journal = Journal.open(Path(sys.argv[1]), HEADER, segment_bytes=30_000)
while True:
    step += 1
    journal.append(piece({(n, step % 3, 0): surface(1000 * step + n) for n in range(12)}))
    if compacts:
        journal.compact_step(0.005)
    journal.commit()
    print(step, flush=True)
"""


@pytest.mark.timeout(400)
@pytest.mark.parametrize("compacts", [pytest.param(False, marks=pytest.mark.long), True])
def test_what_was_reported_as_committed_is_there(tmp_path: Path, compacts: bool) -> None:
    """Protects the last second before a crash: a real process is killed in the middle of it, again and again."""
    chance = np.random.default_rng(7)
    folder = tmp_path / "map.journal"
    last = 0
    for _ in range(3):
        arguments = [sys.executable, "-c", CHILD, str(folder), str(last), str(compacts)]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            reported = [int(child.stdout.readline()) for _ in range(5)]
            for _ in range(5):
                # A reader while the other process writes and removes files: it sees one whole map.
                with Journal.read_only(folder) as reader:
                    assert len(held(reader)) == 3 * CHUNKS
            time.sleep(chance.uniform(0.0, 0.3))
            child.send_signal(signal.SIGKILL)
            reported += [int(line) for line in child.stdout if line.endswith("\n")]
        committed = reported[-1]
        with Journal.open(folder) as journal:
            assert all(loss.torn for loss in journal.losses)
            found = journal.read(np.array([(n, third, 0) for n in range(CHUNKS) for third in range(3)], np.int32))
            assert len(found.chunks) == 3 * CHUNKS
            for (n, third, _), values in zip(found.chunks.tolist(), found.values, strict=True):
                # What was on its way when the process died may be there too, chunk by chunk.
                steps = [step for step in range(committed - 2, committed + 2) if step % 3 == third]
                assert any(np.array_equal(values, surface(1000 * step + n)) for step in steps)
        last = committed + 1
