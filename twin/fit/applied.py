"""Creation of scenario files in which fitted duration distributions replace the previous durations."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from planning.errors import OutputError, RequestError
from planning.files import replace_atomically
from twin.document.validation import InvalidScenarioError
from twin.document.yaml_text import read_yaml, scenario_text
from twin.fit.fitting import Fit, fitted_execution, write_sample
from twin.fit.samples import FitSample
from twin.reading.scenario_file import load_scenario
from twin.scenario.manifest import file_hashes
from twin.scenario.sections.scenario import Scenario

_NOTE = "Durations of skills: "
"""Beginning of the comment above an execution section that was written here."""


def require_skills(samples: Sequence[FitSample]) -> None:
    """Refuse samples without a known skill.

    Raises:
        RequestError: there is such a sample.
    """
    if not all("skill" in sample.labels for sample in samples):
        raise RequestError(
            "--apply: of which skill are these durations? Say --skill, or --by skill"
        )


def apply_fits(
    source: Path, target: Path, fits: Sequence[Fit], note: str
) -> tuple[str, ...]:
    """Write a scenario with the fitted durations of skills.

    Durations of other skills, robots and objects are kept, and comments outside the execution section.
    Samples that no distribution fits go into CSV files next to the new scenario.

    Args:
        source: the scenario.
        target: the new one; replaced when it exists, and may be the source itself.
        fits: each of a skill; see require_skills.
        note: where the durations come from, for a comment.

    Returns:
        Messages on exceptions of the source that override fitted durations.

    Raises:
        InvalidScenarioError: the source is not valid, or would not be any more.
        RequestError: paths in the source would name other files from the target's folder.
        OutputError: a file cannot be written.
    """
    scenario = load_scenario(source)
    _require_same_files(source, target, scenario)
    text = source.read_text(encoding="utf-8-sig")
    before = read_yaml(source, text).data
    old = before.get("execution") or {}
    new = fitted_execution(fits, prefix=f"{target.stem}-")
    fitted = [_key(item) for item in new.get("skill_overrides", ())]
    kept = [i for i in old.get("skill_overrides") or () if _key(i) not in fitted]
    execution = {**old}
    if "skills" in new:
        execution["skills"] = {**(old.get("skills") or {}), **new["skills"]}
    if "skill_overrides" in new:
        execution["skill_overrides"] = [*kept, *new["skill_overrides"]]
    written = _with_execution(text, {**before, "execution": execution}, note)
    files = {
        target.parent / f"{target.stem}-{fit.csv}": fit
        for fit in fits
        if fit.is_empirical
    }
    made = [path for path in files if not path.exists()]
    try:
        for path, fit in files.items():
            write_sample(path, fit)
        with replace_atomically(target) as temporary:
            temporary.write_text(written, encoding="utf-8")
            load_scenario(temporary)
    except BaseException as error:
        for path in made:
            path.unlink(missing_ok=True)
        if isinstance(error, InvalidScenarioError):
            lines = tuple(written.splitlines())
            raise InvalidScenarioError(target, error.problems, lines) from None
        raise
    skills = new.get("skills", {})
    return tuple(
        " of ".join(str(item[k]) for k in ("skill", "robot", "object") if k in item)
        for item in kept
        if item["skill"] in skills
    )


def _require_same_files(source: Path, target: Path, scenario: Scenario) -> None:
    """Refuse a target folder in which relative paths would name other files."""
    bases = source.parent, target.parent
    if bases[0].resolve() == bases[1].resolve():
        return
    try:
        same = file_hashes(scenario, bases[0]) == file_hashes(scenario, bases[1])
    except OutputError:
        same = False
    if not same:
        raise RequestError(
            f"{target}: {source.name} names files relative to its folder {bases[0]}: write the"
            " new scenario there"
        )


def _key(item: dict[str, Any]) -> tuple[str, str | None, str | None]:
    return item["skill"], item.get("robot"), item.get("object")


def _with_execution(text: str, content: dict[str, Any], note: str) -> str:
    """Return the text of a scenario with its execution section replaced.

    Where the section cannot be cut out, as in flow style, the whole file is rewritten.
    """
    note = f"{_NOTE}{note}"
    block = scenario_text({"execution": content["execution"]}, note)
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    begin = end = len(text)
    for key, value in root.value:
        if key.value == "execution":
            begin, end = key.start_mark.index, value.end_mark.index
    head = text[:begin].rstrip("\n").split("\n")
    if head[-1].startswith(f"# {_NOTE}"):
        head.pop()
    # A section of several lines ends where the next one begins: comments above that stay.
    lines = text[begin:end].splitlines(keepends=True)
    while lines and (not lines[-1].strip() or lines[-1].startswith("#")):
        end -= len(lines.pop())
    tail = text[end:]
    joined = "\n".join(head) + "\n" + block + tail.removeprefix("\n")
    again = read_yaml(Path(), joined)
    if again.data == content and not again.problems:
        return joined
    return scenario_text(content, note)
