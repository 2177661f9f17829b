"""Write docs/reference/python.md from the docstrings of the names that ``twin`` has.

From the top of the repository: ``python docs/python_reference.py``.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import twin
import twin.registry

PAGE = Path(__file__).parent / "reference" / "python.md"

FUNCTIONS = (
    *("load", "check", "plan", "simulate", "run", "operate", "audit"),
    *("study", "compare", "explore", "replay", "read_plan", "read_run"),
    "resume_study",
)
RESULTS = (
    *("LoadedScenario", "Check", "PlanResult", "RunResult", "Audit", "Study"),
    *("Comparison", "Explored", "Precision", "RunMoment"),
)

ERRORS = (
    *(
        "TwinError",
        "ScenarioError",
        "InvalidScenarioError",
        "RequestError",
        "ArgumentError",
    ),
    *(
        "OutputError",
        "RobotModelError",
        "FittingError",
        "ShapeError",
        "InfeasibleStepError",
    ),
    *("ConstructionError", "TransitError", "UndecidedError", "PlanInvariantError"),
    *("DeadlockError", "IncompleteRunError", "ViewerError", "ClusterError"),
    *("ClusterLostError", "FrankaError", "MessageError", "EventLogError"),
    *(
        "ResumeError",
        "CircularWaitsError",
        "TooManyPiecesError",
        "InterlockedError",
        "UnknownEntryError",
    ),
)

GROUPS = (
    *("DURATIONS", "PLANNERS", "POLICIES", "RECORDERS", "EXPORTS", "DRIVERS"),
    "COMMANDS",
)
"""Groups of ``twin.registry`` that others may add to."""

PARTS = {
    "twin.durations.model": ("DurationModel", "Seconds", "PositiveSeconds", "Factor"),
    "planning.motion.transit": ("TransitPlanner", "MotionChecker"),
    "twin.engine.dispatch_policies": ("DispatchPolicy",),
    "scheduling.graph.temporal_plan_graph": ("TemporalPlanGraph", "NodeChain"),
    "twin.runs.execution_record": ("ExecutionRecord",),
    "twin.runs.events": ("Event",),
    "twin.exports.formats": ("export_run",),
    "twin.drivers.driver": (
        *("Driver", "DriverState", "ClearedNode", "ToolOrder", "Sample"),
    ),
}
"""Names by module that parts of one's own are made of, or get."""

_SECTION = re.compile(r"^(Args|Returns|Raises|Attributes):$")
_ENTRY = re.compile(r"^    (\w[\w, ]*): (.*)$")


def page() -> str:
    """Return the page."""
    parts = [
        "# Python",
        "Names of the package `twin`; how to use them is told in [From Python](../guides/python.md). This page is"
        " made of their docstrings by `docs/python_reference.py`.",
        "Public are the names on this page: those of `twin`, and those that [parts of your own](#parts-of-your-own) are"
        " made of. Everything else, in every module, may change with each release, whether it begins with an underscore or"
        " not; an underscore marks what only its own module or folder uses.",
        "## Functions",
        "`AnyScenario` is a scenario, the path of its file, or the name of one that comes with the program; `AnyPlan` is"
        " that or a plan; `PathOrName` a path; `Report` a function that is called with the name of a stage, how much of it is"
        " done, and how much there is in all.",
    ]
    for name in FUNCTIONS:
        parts += [f"### twin.{name}", *_function(getattr(twin, name))]
    parts.append("## Classes")
    for name in RESULTS:
        parts += [f"### twin.{name}", *_class(getattr(twin, name))]
    parts += ["## Errors", "`twin.TwinError` is the base class of all errors."]
    head = ["| error | of | when | attributes |", "|---|---|---|---|"]
    parts.append("\n".join([*head, *map(_error, ERRORS)]))
    parts += ["## Parts of your own", *_parts()]
    return "\n\n".join(parts) + "\n"


def _parts() -> Iterator[str]:
    """Yield the groups of the registry that others may add to, and the names that their entries need."""
    yield "Groups of `twin.registry`; `GROUP.add(name, entry)` adds an entry for the process."
    said = _assigned("twin.registry")
    rows = ["| group | entry points | entries are |", "|---|---|---|"]
    for name in GROUPS:
        points = f"assembly_twin.{getattr(twin.registry, name).name}"
        rows.append(f"| `{name}` | `{points}` | {said[name]} |")
    yield "\n".join(rows)
    yield "Names that they need:"
    rows = ["| name | module | |", "|---|---|---|"]
    for module, names in PARTS.items():
        found, said = import_module(module), _assigned(module)
        for name in names:
            words = said.get(name) or _first(getattr(found, name))
            rows.append(f"| `{name}` | `{module}` | {words} |")
    yield "\n".join(rows)


def _assigned(module: str) -> dict[str, str]:
    """Return the docstrings of the constants of a module, in one line of a table each."""
    body = ast.parse(inspect.getsource(import_module(module))).body
    return {
        ast.unparse(one.targets[0]): _line(ast.literal_eval(other.value))
        for one, other in pairwise(body)
        if isinstance(one, ast.Assign)
        and isinstance(other, ast.Expr)
        and isinstance(other.value, ast.Constant)
    }


def _error(name: str) -> str:
    """Return the row of a table that says what an error is, and what it carries."""
    error = getattr(twin, name)
    bases = " and ".join(f"`{base.__name__}`" for base in error.__bases__)
    *_, attributes = (inspect.getdoc(error) or "").partition("\n\nAttributes:\n")
    rows = map(_ENTRY.match, re.sub(r"\n {5,}", " ", attributes).splitlines())
    said = "; ".join(f"`{row[1]}`: {row[2].rstrip('.')}" for row in rows if row)
    return f"| `{name}` | {bases} | {_first(error)} | {said.replace('``', '`')} |"


def _function(function: Any) -> Iterator[str]:
    signature = inspect.signature(function)
    lines = []
    keywords = False
    for parameter in signature.parameters.values():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY and not keywords:
            keywords = True
            lines.append("    *,")
        # Annotations are texts already; a function has no text as default.
        words = re.sub(r"<function (\w+) at \w+>", r"\1", str(parameter))
        lines.append(f"    {words.replace(chr(39), '')},")
    call = "\n".join([f"{function.__name__}(", *lines, ")"])
    yield f"```python\n{call} -> {signature.return_annotation}\n```"
    yield from _markdown(inspect.getdoc(function) or "")


def _class(cls: type) -> Iterator[str]:
    yield from _markdown(inspect.getdoc(cls) or "")
    rows = []
    own = {field.name for field in fields(cls)} if is_dataclass(cls) else set()
    for name, member in vars(cls).items():
        if name.startswith("_") or name in own:
            continue
        if isinstance(member, property | cached_property):
            getter = member.fget if isinstance(member, property) else member.func
            kind = inspect.signature(getter).return_annotation  # type: ignore[arg-type]
            rows.append(f"| `{name}` | `{kind}` | {_first(member)} |")
        elif inspect.isfunction(member):
            names = [p for p in inspect.signature(member).parameters if p != "self"]
            kind = inspect.signature(member).return_annotation
            call = f"{name}({', '.join(names)})"
            rows.append(f"| `{call}` | `{kind}` | {_first(member)} |")
    if rows:
        yield "\n".join(["| | | |", "|---|---|---|", *rows])


def _first(member: Any) -> str:
    """Return the first paragraph of a docstring, in one line of a table."""
    return _line((inspect.getdoc(member) or "").split("\n\n")[0])


def _line(text: str) -> str:
    return " ".join(text.split()).replace("``", "`").replace("|", "\\|")


def _markdown(docstring: str) -> Iterator[str]:
    """Yield the paragraphs of a docstring of Google's style; its sections become lists."""
    for block in docstring.replace("``", "`").split("\n\n"):
        first, _, rest = block.partition("\n")
        section = _SECTION.match(first)
        if section is None:
            yield " ".join(block.split())
            continue
        yield f"*{'Arguments' if section[1] == 'Args' else section[1]}:*"
        items: list[str] = []
        for line in rest.splitlines():
            entry = _ENTRY.match(line)
            if entry is not None:
                items.append(f"- `{entry[1]}`: {entry[2]}")
            elif items:
                items[-1] += f" {line.strip()}"
            else:
                items.append(line.strip())
        yield "\n".join(items)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
