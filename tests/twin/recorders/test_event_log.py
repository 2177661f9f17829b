import json
import signal
from decimal import Decimal
from pathlib import Path

import pytest

from planning.errors import OutputError
from tests.twin.drawn_runs import VARIED
from tests.twin.program import python
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg
from twin.recorders.observers import JsonlRecorder, MemoryRecorder
from twin.runs.events import Event, event_line
from twin.uncertainty.disturbances import Disturbances, Stalls


def log_of(path: Path, seed: int) -> bytes:
    stalls = Disturbances(stalls=Stalls(count_per_robot=1))
    simulate(
        random_tpg(8, tasks=12),
        VARIED,
        seed=seed,
        disturbances=stalls,
        recorders=[JsonlRecorder(path)],
    )
    return path.read_bytes()


def test_a_line_holds_the_exact_time_and_any_text() -> None:
    event = Event(12_345_000_000_001, 'le"ft', "waiting", 3, 4, "brick é", "a\nb")
    line = event_line(event)
    assert line.count("\n") == 1
    assert line.startswith('{"t_s": 12345.000000001, "robot": ')
    assert json.loads(line, parse_float=Decimal) == {
        "t_s": Decimal("12345.000000001"),
        "robot": 'le"ft',
        "kind": "waiting",
        "task": 3,
        "node": 4,
        "object": "brick é",
        "detail": "a\nb",
    }


def test_the_log_holds_every_event(tmp_path: Path) -> None:
    memory = MemoryRecorder()
    path = tmp_path / "events.jsonl"
    simulate(random_tpg(8), VARIED, seed=0, recorders=[JsonlRecorder(path), memory])
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(r["robot"], r["kind"], r["node"]) for r in rows] == [
        (e.robot, e.kind, e.node) for e in memory.events
    ]


def test_same_seed_same_bytes_also_where_hashes_differ(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path;"
        "from tests.twin.recorders.test_event_log import log_of; log_of(Path(sys.argv[1]), 1)"
    )
    other = tmp_path / "other"
    python(code, other, PYTHONHASHSEED="123")
    assert other.read_bytes() == log_of(tmp_path / "here", 1)
    assert other.read_bytes() != log_of(tmp_path / "another", 2)


def test_a_killed_run_leaves_a_readable_log(tmp_path: Path) -> None:
    """The process dies without a chance to close its files."""
    code = """
import os, signal, sys
from pathlib import Path
from tests.twin.twin_toys import random_tpg
from tests.twin.drawn_runs import VARIED
from tests.twin.simulated import simulate
from twin.recorders.observers import JsonlRecorder

class Kills:
    left = 10
    def record(self, event):
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
    def close(self):
        pass

log = JsonlRecorder(Path(sys.argv[1]))
simulate(random_tpg(8), VARIED, seed=0, recorders=[log, Kills()])
"""
    path = tmp_path / "events.jsonl"
    python(code, path, code=-signal.SIGKILL)
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(rows) == 10


def test_a_log_that_cannot_be_opened_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="missing"):
        JsonlRecorder(tmp_path / "missing" / "events.jsonl")
