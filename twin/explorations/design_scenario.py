"""Creation of a scenario file from a cell design that an exploration found."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from planning.errors import OutputError, RequestError, ScenarioError
from planning.files import read_object, require_own_files
from twin.beginnings.beginning import write_new_scenario
from twin.explorations.dimensions import dimensions_of, variant_of
from twin.explorations.folder import SUMMARY, read_request
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import apply_variation
from twin.trial.loaded_scenario import LoadedScenario

_DESIGN = re.compile(r"^([^#]*)(?:#(\d+))?$")


def begin_design(target: Path, source: str) -> Path:
    """Write the scenario of a design to a path, with its referenced files next to it.

    Nothing is overwritten. What the scenario leaves to its defaults stays left out; comments are lost.

    Args:
        target: a YAML file, or a folder.
        source: folder of an exploration, and the rank of the design: ``explored#3``; the best without.

    Returns:
        The file of the scenario.

    Raises:
        OutputError: the folder is not one of an exploration, or the file is there already.
        RequestError: there is no design of this rank.
    """
    design, words = design_of(source)
    text = f"# {words}\n{scenario_text(design.sections)}"
    return write_new_scenario(target, text, design.folder)


def design_of(source: str) -> tuple[LoadedScenario, str]:
    """Return the scenario of a design, and what it changes in words; see ``begin_design``."""
    match = _DESIGN.match(source)
    if match is None:
        raise RequestError(
            f"{source}: a design is called by folder and rank, such as explored#3"
        )
    folder, rank = Path(match[1]), int(match[2] or 1)
    path = folder / SUMMARY
    require_own_files(folder, (SUMMARY,))
    best = read_object(path, "summary of an exploration").get("best")
    try:
        found = {int(row["rank"]): row for row in best or ()}
    except (ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: no summary of an exploration") from error
    if rank not in found:
        there = f"1 to {len(found)}" if found else "none"
        raise RequestError(f"{folder} has no design #{rank}: there are {there}")
    row = found[rank]
    request = read_request(folder)
    document = LoadedScenario(request.scenario, request.folder).document
    dimensions = dimensions_of(request.scenario, request.section, document)
    try:
        scenario = apply_variation(
            request.scenario, variant_of(dimensions, row["values"])
        ).changed(explore=None)
    except (KeyError, ScenarioError) as error:
        raise OutputError(f"{path}: is of another exploration: {error}") from error
    changes = "; ".join(row["changes"]) or "the scenario as it is"
    words = f"Design {row['design']} of an exploration of {scenario.name}: {changes}"
    return LoadedScenario(scenario, request.folder), words


def scenario_text(scenario: Scenario) -> str:
    """Return a scenario as YAML, without default values."""
    whole = scenario.model_dump(mode="json", by_alias=True, exclude={"explore"})
    said = scenario.model_dump(
        mode="json", by_alias=True, exclude_defaults=True, exclude={"explore"}
    )
    content = _with_kinds(said, whole)
    return yaml.safe_dump(
        content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
    )


def _with_kinds(said: Any, whole: Any) -> Any:
    """Return content with the kind of every section, even the default."""
    if isinstance(said, dict):
        found = {key: _with_kinds(value, whole[key]) for key, value in said.items()}
        kind = {"kind": whole["kind"]} if "kind" in whole else {}
        return {**kind, **found}
    if isinstance(said, list):
        return [_with_kinds(*pair) for pair in zip(said, whole, strict=True)]
    return said
