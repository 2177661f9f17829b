"""Whatever bytes a command is given, it ends in a sentence: some dozens of mutated files of each kind.

``python -m benchmarks.fuzz`` tries many more of them.
"""

from pathlib import Path

import pytest

from benchmarks.fuzz.targets import TARGETS
from benchmarks.fuzz.worker import Worker

CASES = {
    "scenarios": 40,
    "plans": 6,
    "logs": 5,
    "blocks": 2,
    "urdfs": 30,
    "csvs": 20,
    "tasks": 20,
    "models": 30,
    "open plans": 20,
}


@pytest.mark.parametrize("name", CASES)
def test_mutated_files_end_in_a_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(Path(__file__).parents[2])
    target, _ = TARGETS[name]
    worker = Worker(target(tmp_path, 1))
    endings = [worker.run(case) for case in range(CASES[name])]
    worker.stop()
    bad = {
        ending.case: f"{ending.bad}: {ending.said[-500:]}"
        for ending in endings
        if ending.bad
    }
    assert not bad
    # The mutations are neither all harmless nor all fatal.
    codes = {ending.code for ending in endings}
    assert len(codes) > 1 or name == "blocks"
