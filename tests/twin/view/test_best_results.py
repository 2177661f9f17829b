"""Of a study and of an exploration, the page shows the best."""

import json
from contextlib import closing
from pathlib import Path

import pytest

import twin
from planning.errors import TwinError
from tests.twin.explorations.sliders import LEFT, slider_file
from twin.runs.policies import ASYNCHRONOUS_SHORTCUTS
from twin.view.api import cell_page

pytestmark = pytest.mark.nightly


def left_base(page: object) -> float:
    return float(page._scene.robots["left"].base[0, 3])  # type: ignore[attr-defined]


def test_the_best_design_of_an_exploration(tmp_path: Path) -> None:
    file, out = slider_file(tmp_path / "cell"), tmp_path / "out"
    twin.explore(file, designs=4, workers=1, out=out)
    best = json.loads((out / "summary.json").read_text())["best"][0]
    with closing(cell_page(out, port=8340)) as page:
        assert left_base(page) == best["values"][LEFT]
        assert page._answer_chart({}) == {}
        assert f"Design {best['design']} of an exploration" in page._about.content
    (out / "summary.json").write_text("{}")
    with pytest.raises(TwinError, match="has no design #1"):
        cell_page(out, port=8340)


def test_the_best_layout_of_a_study(tmp_path: Path) -> None:
    file, out = slider_file(tmp_path / "cell", ""), tmp_path / "out"
    # The right slider takes 0.8 s; the left one 1.4 s from -0.6, and 0.6 s from -0.2.
    twin.study(
        file, vary={LEFT: [-0.6, -0.2, -0.45]}, replications=2, workers=1, out=out
    )
    with closing(cell_page(out, port=8340)) as page:
        assert left_base(page) == -0.2
        assert page._answer_chart({})["end_s"] == pytest.approx(0.8)
        assert f"{LEFT} = -0.2" in page._about.content
    row = {"policy": ASYNCHRONOUS_SHORTCUTS}
    for ranking in ([row], 3, [{**row, "cell": "0"}], [{"cell": 0}]):
        (out / "summary.json").write_text(json.dumps({"ranking": ranking}))
        with pytest.raises(TwinError, match=r"summary\.json: no summary of this study"):
            cell_page(out, port=8340)
