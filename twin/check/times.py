"""Checks of skill durations: LEGO's timings in a cell that builds no LEGO."""

from __future__ import annotations

from twin.check.finding import Finding, Findings, Subject
from twin.durations import Packaged, PackagedSkill

_SKILLS: dict[str, tuple[PackagedSkill, ...]] = {
    "assembly": ("pick", "place-down"),
    "construction": ("pick", "place-down"),
}
"""Skills that every assembly of a kind uses."""


def check_skill_times(subject: Subject) -> Findings:
    """Yield skills of assemblies other than LEGO that take LEGO's packaged times."""
    execution = subject.scenario.execution
    kind = subject.scenario.assembly.kind
    packaged = [
        (skill, duration)
        for skill in _SKILLS.get(kind, ())
        if isinstance(duration := execution.skills[skill], Packaged)
    ]
    if packaged:
        means = ", ".join(f"{skill} {item.mean:.2f} s" for skill, item in packaged)
        yield Finding(
            ("execution", "skills"),
            f"these skills take the packaged times of a LEGO tool with force control ({means} in the"
            f" mean), and this is no LEGO: give execution.skills your own (twin fit makes them from"
            " measured times)",
        )
