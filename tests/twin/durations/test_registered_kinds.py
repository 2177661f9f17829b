"""Duration models of one's own: read from a scenario, drawn by both engines, refused where they are none."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from planning.errors import RequestError
from planning.transforms import Array
from tests.twin.scenarios.cells import ONE_BRICK
from tests.twin.simulated import assert_same_ends
from tests.twin.twin_toys import random_tpg
from tests.twin.written import loaded, refusal
from twin.durations.composed import AnyDuration, Retries
from twin.durations.model import DurationModel, Seconds
from twin.engine.execution_model import ExecutionModel
from twin.registry import DURATIONS
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.scenario import resolve_scenario
from twin.scenario.variations import apply_variation
from twin.uncertainty.skill_durations import SkillDurations

TEXT = ONE_BRICK + "execution:\n  skills:\n    pick: {PICK}\n"


class TwoSpeeds(DurationModel):
    """Either of two durations, equally often.

    Attributes:
        quick_s, slow_s: of both [s].
    """

    kind: Literal["two-speeds"] = "two-speeds"
    quick_s: Seconds
    slow_s: Seconds
    then: tuple[AnyDuration, ...] = ()

    def _ppf(self, u: Array) -> Array:
        return np.where(np.asarray(u) < 0.5, self.quick_s, self.slow_s)

    def _mean(self) -> float:
        return 0.5 * (self.quick_s + self.slow_s)


class OneAtATime(DurationModel):
    """A model that draws single durations only."""

    kind: Literal["one"] = "one"

    def _ppf(self, u: Array) -> Array:
        return np.array(1.0)

    def _mean(self) -> float:
        return 1.0


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind, model in {"two-speeds": TwoSpeeds, "one": OneAtATime}.items():
        monkeypatch.setitem(DURATIONS._added, kind, model)


def test_a_scenario_names_it(tmp_path: Path) -> None:
    own = "{kind: two-speeds, quick_s: 2, slow_s: 5, scale: 2, then: [{kind: fixed, value_s: 1}]}"
    scenario = loaded(tmp_path, TEXT, ("{PICK}", own))
    model = scenario.execution.skills["pick"]
    assert isinstance(model, TwoSpeeds)
    assert model.ppf(np.array([0.1, 0.9])).tolist() == [4.0, 10.0]
    content = resolve_scenario(scenario)
    assert content["execution"]["skills"]["pick"]["slow_s"] == 5
    slower = apply_variation(scenario, {"skills.pick.slow_s": 9}).execution.skills
    assert slower["pick"] == model.changed(slow_s=9.0)
    other = {"skills.pick.kind": "fixed", "skills.pick.value_s": 1}
    assert "two" not in repr(apply_variation(scenario, other).execution.skills)
    nested = f"{{kind: retries, probability: 0.1, attempt: {own}}}"
    retries = loaded(tmp_path, TEXT, ("{PICK}", nested)).execution.skills["pick"]
    assert isinstance(retries, Retries)
    assert retries.attempt == model
    loaded(tmp_path, TEXT, ("{PICK}", "{kind: reference}"))


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("{kind: two-speed, quick_s: 2}", "did you mean 'two-speeds'"),
        ("{kind: two-speeds, quick_s: 2, slow: 5}", "unknown key 'slow'"),
        ("{kind: two-speeds, quick_s: 2, slow_s: -1}", "must be at least 0, not -1"),
        ("{kind: two-speeds, quick_s: 2, slow_s: 1}", "never fall"),
        ("{kind: one}", r"shape \(5,\) has shape \(\)"),
    ],
)
def test_wrong_values_are_told_with_the_valid_ones(
    tmp_path: Path, section: str, said: str
) -> None:
    found = refusal(tmp_path, TEXT, ("{PICK}", section))
    with pytest.raises(type(found), match=said):
        raise found


def test_editors_know_it() -> None:
    skill = scenario_schema()["$defs"]["ExecutionSection"]["properties"]["skills"]
    union = next(iter(skill["patternProperties"].values()))
    assert union["discriminator"]["mapping"]["two-speeds"] == "#/$defs/TwoSpeeds"
    own = scenario_schema()["$defs"]["TwoSpeeds"]
    assert own["required"] == ["kind", "quick_s", "slow_s"]


@pytest.mark.parametrize("entry", [Retries, dict])
def test_an_entry_that_is_no_such_model_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, entry: object
) -> None:
    monkeypatch.setitem(DURATIONS._added, "other", entry)
    with pytest.raises(RequestError, match="other"):
        loaded(tmp_path, TEXT, ("{PICK}", "{kind: fixed, value_s: 1}"))


def test_both_engines_draw_from_it() -> None:
    model = TwoSpeeds(quick_s=1.0, slow_s=4.0)
    durations = SkillDurations({"pick": model, "place-down": model})
    found = assert_same_ends(random_tpg(2), ExecutionModel(durations), 3, range(6))
    assert np.any(np.ptp(found.chain_end_ns, axis=1) > 0)
