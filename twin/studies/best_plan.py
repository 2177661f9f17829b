"""Plan of a finished study under the policy that coordinates best, of its quickest layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planning.errors import OutputError
from planning.files import read_object
from twin.runs.policies import named_policies, plan_folder, preferred_policy
from twin.studies.folder import PLANS, SUMMARY, read_request
from twin.studies.plans import plan_key
from twin.studies.summary import cell_label
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, read_plan


def best_plan(folder: Path) -> tuple[PlanResult, str]:
    """Return the plan of the cell of a study that its report shows first, and its policy and variant in words.

    Raises:
        OutputError: the folder is not one of a study that has ended, or is damaged.
    """
    request, path = read_request(folder), folder / SUMMARY
    ranking = read_object(path, "summary of a study").get("ranking")
    policies = request.experiment.policies
    policy = preferred_policy(policies)
    try:
        ranked = [row["cell"] for row in ranking or () if row["policy"] == policy]
        cell = ranked[0] if ranked else policies.index(policy)
        policy, variant = request.experiment.cells[cell]
    except (LookupError, TypeError) as error:
        raise OutputError(f"{path}: no summary of this study: {error!r}") from error
    plan, release = named_policies()[policy]
    case = LoadedScenario(request.scenario, request.base)
    case = case.varied({**variant, "policy": release})
    found = read_plan(folder / PLANS / plan_folder(plan_key(variant, plan)), case)
    return replace(found, name=plan), cell_label(policy, variant)
