"""Time within time: a block counts for its own name alone."""

import time

import pytest

from planning.construction.stopwatch import Stopwatch


def _work(seconds: float) -> None:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def _timed_failure(watch: Stopwatch) -> None:
    with watch.time("keyframes"):
        _work(0.01)
        raise ValueError("stop")


def test_a_block_within_another_one_counts_for_its_own_name_alone() -> None:
    watch = Stopwatch()
    start = time.process_time()
    with watch.time("path"):
        _work(0.02)
        for _ in range(2):
            with watch.time("postprocessing"):
                _work(0.03)
                with pytest.raises(ValueError, match="stop"):
                    _timed_failure(watch)
    spent = time.process_time() - start
    assert watch.cpu["path"] == pytest.approx(0.02, abs=0.01)
    assert watch.cpu["postprocessing"] == pytest.approx(0.06, abs=0.01)
    assert watch.cpu["keyframes"] == pytest.approx(0.02, abs=0.01)
    assert sum(watch.cpu.values()) == pytest.approx(spent, abs=0.005)
