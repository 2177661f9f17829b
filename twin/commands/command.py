"""A command of a Python function: its parameters are the options, its docstring is the help.

The function is read and not imported until the command is called, so that ``twin --help`` does not
wait for what commands need.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.host.guard import COMPLETED, guarded, print_json

_TYPES: Mapping[str, Any] = {
    "AnyScenario": Path,
    "PathOrName": Path,
    "Path": Path,
    "str": str,
    "int": int,
    "float": float,
    "bool": bool,
    "Sequence[str]": list[str],
    "Sequence[float]": list[float],
    "Sequence[Path]": list[Path],
}
"""What is given in a shell, by the annotation of a parameter; others are no options."""

_ARGUMENTS: Mapping[str, Mapping[str, Any]] = {
    "scenario": {"help": "Scenario file, or the name of one that twin scenarios lists."}
}
_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "out": {"metavar": "DIR"},
    "plan": {"metavar": "DIR"},
    "resume": {"metavar": "DIR"},
    "certificates": {"metavar": "DIR"},
    "seed": {"min": 0},
    "shortcuts": {"min": 0},
    "robots": {"min": 1, "metavar": "M"},
    "failures": {"min": 0, "max": 1, "metavar": "P"},
    "settings": {"names": ("--set",), "metavar": "KEY=VALUE"},
    "sobol": {"min": 0},
    "audited": {"min": 0},
    "workers": {"min": 0},
    "audit_engine": {"metavar": "ENGINE"},
    "as_json": {"names": ("--json",), "help": "Print JSON only."},
    "quiet": {"names": ("--quiet", "-q"), "help": "Print errors only."},
}
"""What arguments and options of these names are in every command."""

_KEYWORD, _EMPTY = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.empty


@dataclass(frozen=True)
class View:
    """How the result of a command is to be shown.

    Attributes:
        as_json: print JSON only.
        quiet: print errors only.
        compiled: returns whether kernels were compiled meanwhile.
        given: values of the options.
    """

    as_json: bool
    quiet: bool
    compiled: Callable[[], bool]
    given: Mapping[str, Any]

    @property
    def silent(self) -> bool:
        """True if nothing is said about progress."""
        return self.quiet or self.as_json

    def tell(self, content: object, show: Callable[[], object]) -> None:
        """Print what programs read, or show what people do, unless nothing is to be said."""
        if self.as_json:
            print_json(content)
        elif not self.quiet:
            show()


@dataclass(frozen=True)
class _Function:
    """What is written about a function.

    Attributes:
        arguments: positional parameters, by name: annotation and default, if there is any.
        options: those that are given by keyword.
        words: docstring, up to its sections.
        helps: what it says of each parameter.
    """

    arguments: Mapping[str, tuple[str, Any]]
    options: Mapping[str, tuple[str, Any]]
    words: str
    helps: Mapping[str, str]

    @property
    def parameters(self) -> dict[str, tuple[str, Any]]:
        """All parameters, arguments first."""
        return {**self.arguments, **self.options}

    def optional(self, name: str) -> bool:
        """Tell whether a parameter may be None."""
        return self.parameters[name][0].endswith("| None")


def command(
    home: str,
    show: Callable[[Any, View], int | None] | None = None,
    *,
    passes_to: str = "",
    columns: Callable[[], Sequence[Any]] = tuple,
    **options: Mapping[str, Any],
) -> Callable[..., None]:
    """Return the command of a function, for typer.

    Positional parameters become arguments, keywords options. A function that takes ``progress``
    tells a display how far it has come; one that takes a ``view: View`` is told how to show.

    Args:
        home: the function, as ``module:name``.
        show: prints what the function returns, and returns an exit code. Without it the
            function prints by itself and returns the code. With it there are ``--json`` and
            ``--quiet``.
        passes_to: another function; what the function does not name it takes as ``**options`` for that.
        columns: returns what stands behind the bar of a stage.
        options: by parameter what the signature does not say: ``names``, ``min``, ``max``,
            ``metavar``, ``help``, and a ``default`` that is no literal. An option with a ``type``
            is none of the function's, but for show.
    """
    found = _read(home)
    if passes_to:
        more = _read(passes_to)
        found = replace(
            found,
            options={**more.options, **found.options},
            helps={**more.helps, **found.helps},
        )
    added = {
        name: (item["type"], item.get("default"))
        for name, item in options.items()
        if "type" in item
    }
    if show is not None:
        added |= {"as_json": ("bool", False), "quiet": ("bool", False)}
    parameters = []
    for name, (kind, default) in (found.parameters | added).items():
        if kind.removesuffix(" | None") not in _TYPES:
            continue
        shared = _ARGUMENTS if name in found.arguments else _OPTIONS
        own = {"default": default, "help": found.helps.get(name)}
        own |= {**shared.get(name, {}), **options.get(name, {})}
        own.pop("type", None)
        kept = _annotated(name, kind, own, argument=name in found.arguments)
        parameters.append(kept)

    def run(**given: Any) -> int | None:
        from twin.host.progress import StageDisplay, compilation_shown

        module, _, name = home.partition(":")
        function = getattr(import_module(module), name)
        quiet, as_json = (bool(given.get(key)) for key in ("quiet", "as_json"))
        takes = {
            key: value
            for key, value in given.items()
            if key in found.parameters and (value is not None or found.optional(key))
        }
        count: Callable[[], int] = int  # none
        with ExitStack() as stack:
            if "progress" in found.options:
                silent = quiet or as_json
                display = StageDisplay(enabled=not silent, columns=columns())
                takes["progress"] = stack.enter_context(display)
                shown = compilation_shown(display, silent=silent)
                count = stack.enter_context(shown)
            view = View(as_json, quiet, lambda: count() > 0, given)
            if ("View", _EMPTY) in found.options.values():
                takes["view"] = view
            positional = [takes.pop(k) for k in found.arguments if k in takes]
            result = function(*positional, **takes)
        if show is None:
            return int(result) if isinstance(result, int) else COMPLETED
        return show(result, view)

    run.__name__ = home.partition(":")[2]
    run.__doc__ = found.words
    run.__annotations__ = {item.name: item.annotation for item in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return guarded(run)


def _annotated(
    name: str, kind: str, own: dict[str, Any], *, argument: bool
) -> inspect.Parameter:
    """Return a parameter as typer wants it."""
    plain = kind.removesuffix(" | None")
    given = _TYPES[plain]
    default, names = own.pop("default"), own.pop("names", ())
    text = own["help"] or ""
    own["help"] = text[:1].upper() + text[1:]
    if plain.startswith("Sequence") and not argument:
        default = None
    if (default is None and not argument) or kind != plain:
        given = given | None
    if argument:
        own.setdefault("metavar", name.upper())
        note: Any = typer.Argument(**own)
    else:
        if given is bool and default is False and not names:
            names = ("--" + name.replace("_", "-"),)
        note = typer.Option(*names, **own)
    return inspect.Parameter(
        name, _KEYWORD, default=default, annotation=Annotated[given, note]
    )


def _read(home: str) -> _Function:
    """Read a function in the source of its module."""
    module, _, name = home.partition(":")
    spec = find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    (node,) = (
        node
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name == name
    )
    given = node.args
    missing = [_EMPTY] * (len(given.args) - len(given.defaults))
    defaults = (*missing, *map(_literal, given.defaults))
    words, helps = _docstring(ast.get_docstring(node) or "")
    return _Function(
        {a.arg: (_kind(a), d) for a, d in zip(given.args, defaults, strict=True)},
        {
            a.arg: (_kind(a), _literal(d))
            for a, d in zip(given.kwonlyargs, given.kw_defaults, strict=True)
        },
        words,
        helps,
    )


def _kind(argument: ast.arg) -> str:
    return "" if argument.annotation is None else ast.unparse(argument.annotation)


def _literal(default: ast.expr | None) -> Any:
    """Return a default; empty where there is none, or one that is a name."""
    if default is None or isinstance(default, ast.Name):
        return _EMPTY
    return ast.literal_eval(default)


def _docstring(text: str) -> tuple[str, dict[str, str]]:
    """Return a docstring up to its sections, and what it says of each parameter."""
    words, _, rest = text.partition("\nArgs:\n")
    words = re.split(r"\n(?:Raises|Returns):\n", words)[0].strip()
    helps: dict[str, str] = {}
    entry = re.compile(r"^    (\w+): (.*)$")
    last = ""
    for line in rest.splitlines():
        if line and not line.startswith(" "):
            break
        if (start := entry.match(line)) is not None:
            last = start[1]
            helps[last] = start[2]
        elif line.strip():
            helps[last] += f" {line.strip()}"
    return words, {name: said.replace("``", "") for name, said in helps.items()}
