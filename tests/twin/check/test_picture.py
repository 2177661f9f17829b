"""The picture of a cell: where things are and happen, tiny things again and larger, names apart."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from twin.check.finding import Subject
from twin.check.picture import cell_figure
from twin.check.views import MOST, close_ups
from twin.scenario.manifest import load_scenario
from twin.scenario.shipped import scenario_path

ROW = (15.0, 3.3)


def _boxes(*centres: tuple[float, float], size: float = 0.02) -> np.ndarray:
    middle = np.array(centres)
    return np.stack([middle - 0.5 * size, middle + 0.5 * size], axis=1)


def test_tiny_things_near_each_other_are_drawn_larger() -> None:
    boxes = _boxes((0, 0), (0.05, 0), (0.03, 0.04), (1.9, 1.9), (1.0, 0.1))
    (found,) = close_ups(boxes, np.array([2.0, 2.0]), 0.004, ROW)
    assert [found.holds(box) for box in boxes] == [True, True, True, False, False]
    assert close_ups(10 * boxes, np.array([2.0, 2.0]), 0.004, ROW) == []
    assert close_ups(boxes[:0], np.array([2.0, 2.0]), 0.004, ROW) == []
    many = [(x, y) for x in np.arange(8) / 4 for y in (0.0, 0.03, 1.0, 1.03)]
    assert len(close_ups(_boxes(*many), np.array([2.0, 2.0]), 0.004, ROW)) <= MOST


def test_names_in_the_picture_are_not_on_each_other() -> None:
    path = scenario_path(Path("cliff"))
    figure = cell_figure(Subject(load_scenario(path), path.parent))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    above, _, *larger = figure.axes
    assert len(larger) == 3
    # The two reach 1.47 m from side to side, what happens there less than 1 m.
    assert np.ptp(above.get_xlim()) < 1.4
    for area in figure.axes:
        boxes = [
            text.get_window_extent(canvas.get_renderer()).expanded(0.9, 0.8)
            for text in area.texts
        ]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    named = {text.get_text() for area in larger for text in area.texts}
    assert {"left_2x4_a", "right_2x6", "step 10"} <= named
