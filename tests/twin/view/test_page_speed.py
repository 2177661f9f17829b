"""The page opens quickly, and moves large teams: measured in processor time, which others do not take."""

import time
from contextlib import closing
from typing import Any

import pytest

from tests.shipped_runs import ShippedRuns
from twin.scenario.shipped import shipped_scenarios
from twin.view.api import cell_page
from twin.view.cell_page import CellPage

pytestmark = pytest.mark.nightly

LEAST_RATE = 15.0
"""Least number of updates a second of the pavilion with 12 robots."""

MOST_S = 5.0
"""Most processor time in which a shipped scenario opens [s]."""


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_open_quickly(name: str) -> None:
    before = time.process_time()
    with closing(cell_page(name, port=8320)):
        assert time.process_time() - before < MOST_S


@pytest.mark.parametrize("motion", ["nothing", "this bar"])
def test_twelve_robots_of_the_pavilion_move(shipped: ShippedRuns, motion: str) -> None:
    own = shipped("construction/pavilion", 12)
    with closing(CellPage(own.planned.scenario, own.trial, None, 8320)) as page:
        player = page._player
        assert player is not None
        player._over.set()  # the frames are counted here
        player._thread.join()
        look: Any = page._look
        look._motion.value, look._distance.value = motion, True
        player.show()
        frames, before = 60, time.process_time()
        for k in range(frames):
            player.seek(0.5 * player.run.end_s + k / LEAST_RATE)
            player.show()
        assert frames / (time.process_time() - before) > LEAST_RATE
