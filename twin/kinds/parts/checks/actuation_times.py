"""Checks of skill durations against the times that tools need to open and close."""

from __future__ import annotations

from collections.abc import Iterator

from planning.tasks.task import Actuation, TaskKind
from twin.checks.finding import CheckContext, Finding, Findings
from twin.document.yaml_text import KeyPath
from twin.durations.model import DurationModel

_ACTUATIONS = {
    "pick": (Actuation.CLOSE,),
    "place-down": (Actuation.OPEN,),
    "handover": (Actuation.CLOSE, Actuation.OPEN),
    TaskKind.HOLD: (Actuation.CLOSE,),
}
"""Tool actuations in each skill of an assembly of parts."""


def check_grip_times(subject: CheckContext) -> Findings:
    """Yield skill durations that leave no time to move, or override a tool's actuation times."""
    scenario = subject.scenario
    if not scenario.actuations:
        return
    execution = scenario.execution
    given: list[tuple[KeyPath, str, str | None, object]] = [
        (("execution", "skills", skill), skill, None, duration)
        for skill, duration in execution.skills.items()
    ]
    given += [
        (("execution", "skill_overrides", k), item.skill, item.robot, item.duration)
        for k, item in enumerate(execution.skill_overrides)
    ]
    for at, skill, robot, duration in given:
        if skill not in _ACTUATIONS or not isinstance(duration, DurationModel):
            continue
        whole = duration.located(subject.folder).mean
        grips = sum(
            min(
                model.located(subject.folder).mean
                for (done, who, _), model in scenario.actuations.items()
                if done == act and robot in (None, who)
            )
            for act in _ACTUATIONS[skill]
        )
        # Nobody takes 0 s for what a tool takes: that is a bound, see check_standing_times.
        if 0.0 < whole <= grips:
            yield Finding(
                at,
                f"{skill} takes {whole:g} s, which is the time of the whole skill: motions and what the"
                f" tool takes to {' and to '.join(_ACTUATIONS[skill])}, which alone is {grips:g} s. If this is"
                f" what the tool takes, say it there ({_keys(skill)}), and leave {skill} away here",
            )
    whole_skills = [
        skill
        for skill, duration in execution.skills.items()
        if skill in ("pick", "place-down") and isinstance(duration, DurationModel)
    ]
    for at, act in _said(subject):
        hidden = [skill for skill in whole_skills if act in _ACTUATIONS[skill]]
        if hidden:
            yield Finding(
                at,
                f"counts in no {' or '.join(hidden)}: execution.skills.{hidden[0]} says how long the whole"
                " of it takes, gripping included",
            )


def _keys(skill: str) -> str:
    keys = " and ".join(f"{act}_s" for act in _ACTUATIONS[skill])
    return f"{keys} of the tool or of assembly.grips"


def _said(subject: CheckContext) -> Iterator[tuple[KeyPath, str]]:
    """Yield the paths of tool actuation times in the file."""
    scenario = subject.scenario
    places: list[tuple[KeyPath, object]] = [
        (("cell", "tools", name), tool) for name, tool in scenario.cell.tools.items()
    ]
    places.append((("assembly", "grips"), getattr(scenario.assembly, "grips", None)))
    for at, section in places:
        for act in (Actuation.CLOSE, Actuation.OPEN):
            if getattr(section, f"{act}_s", None) is not None:
                yield (*at, f"{act}_s"), act
