"""Program that expands a xacro file within bounds: one JSON object from standard input, one to standard output.

The package xacro does the work, with other functions for all that it evaluates or opens. What is written into an
expression is not run, as ``planning.vendor_files.xacro_expressions`` says; files are opened in the given folders only, and the
environment is not read. The process itself is limited in time and memory and can write no file.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from planning.vendor_files.xacro_expressions import FUNCTIONS, evaluate

CPU_S = 10
"""Most seconds of processor time that an expansion may take."""

_MEMORY = 2 << 30
"""Most bytes of memory that an expansion may take."""

_LARGEST = 16 << 20
"""Most bytes of a file that is included, and of the result."""

_NAME = re.compile(r"<name>\s*([\w-]+)\s*</name>")


def _limit() -> None:
    with suppress(ImportError):
        import resource

        for kind, most in (
            (resource.RLIMIT_CPU, CPU_S),
            (resource.RLIMIT_AS, _MEMORY),
            (resource.RLIMIT_FSIZE, 0),
            (resource.RLIMIT_CORE, 0),
        ):
            with suppress(ValueError, OSError):
                resource.setrlimit(kind, (most, most))


def _refusal(words: str) -> Callable[..., Any]:
    """Return a function that refuses what it is given."""

    def refuse(what: str, *_: object, **__: object) -> None:
        raise LookupError(f"{words} {str(what)[-60:]!r}")

    return refuse


class _Files:
    """Access to files below some folders."""

    def __init__(self, folders: list[str]) -> None:
        self._folders = [Path(folder).resolve() for folder in folders]

    def open(self, name: str, mode: str = "r") -> io.StringIO:
        """Return the content of a regular file below one of the folders."""
        path = Path(name).resolve()
        top = next((f for f in self._folders if path.is_relative_to(f)), None)
        parts = (".",) if top is None else path.relative_to(top).parts
        if any(part.startswith(".") for part in parts):
            raise PermissionError(13, f"not below {self._folders[0]}", str(path))
        if not path.is_file():
            raise FileNotFoundError(2, "no such file", str(path))
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise PermissionError(27, "larger than 16 MiB", str(path))
        return io.StringIO(content.decode(errors="replace"))

    def find(self, package: str) -> str:
        """Return the folder of a package: one of its name, or one whose package.xml names it."""
        if not re.fullmatch(r"[\w-]+", package):
            raise LookupError(f"no package {package[:60]!r}")
        named = [folder / package for folder in self._folders]
        for folder in (*named, *(f for f in self._folders if f.name == package)):
            if folder.is_dir():
                return str(folder)
        for top in self._folders:
            for manifest in (top / "package.xml", *sorted(top.glob("*/package.xml"))):
                with suppress(OSError):
                    found = _NAME.search(self.open(str(manifest)).read())
                    if found and found[1] == package:
                        return str(manifest.parent)
        raise LookupError(f"no package {package!r} is beside the file")


def expand(path: str, arguments: Mapping[str, str], folders: list[str]) -> str:
    """Return a xacro file as plain XML, given its arguments and the folders below which files may be opened.

    Raises:
        Exception: whatever xacro and the readers of XML and YAML raise.
    """
    import xacro
    from xacro import substitution_args

    files = _Files(folders)

    def fatal(*words: object) -> None:
        raise ValueError(" ".join(map(str, words))[:500])

    quiet = ("message", "warning", "error", "print_location")
    own: dict[str, Callable[..., Any]] = {
        "load_yaml": xacro.load_yaml,
        "dotify": xacro.YamlDictWrapper,
        "abs_filename": xacro.abs_filename_spec,
        "tokenize": lambda text: xacro.tokenize(text),
        "fatal": fatal,
        "arg": lambda name: xacro.substitution_args_context["arg"][name],
        **dict.fromkeys(quiet, lambda *_: ""),
    }
    functions = dict(FUNCTIONS) | {f"xacro.{name}": item for name, item in own.items()}
    functions |= {"load_yaml": xacro.load_yaml}

    def safe_eval(text: str, symbols: Any, _: object = None) -> Any:
        return evaluate(text, {} if symbols is None else symbols, functions)

    def evaluate_argument(text: str, context: Mapping[str, Any]) -> str:
        known = context.get("arg", {})
        convert = substitution_args.convert_value
        kinds = {name: convert(value, "auto") for name, value in known.items()}
        more = {"arg": kinds.__getitem__, "find": files.find}
        return str(evaluate(text, kinds, functions | more))

    refuse = _refusal("nothing is evaluated by Python")
    # A pattern of names would look at any folder.
    by_name = _refusal("files are included by name, not by")
    replacements = (
        (xacro, "safe_eval", safe_eval),
        (xacro, "glob", SimpleNamespace(glob=by_name)),
        (substitution_args, "_eval", evaluate_argument),
        (substitution_args, "_eval_find", files.find),
        (substitution_args, "_eval_env", _refusal("the environment is not read:")),
        (substitution_args, "_eval_optenv", lambda name, default="": default),
    )
    for module, name, own_function in replacements:
        if not hasattr(module, name):
            raise ImportError(f"this version of xacro has no {name}")
        setattr(module, name, own_function)
    # Names of a module hide those that Python brings along.
    xacro.open = files.open
    for module in (xacro, substitution_args):
        for name in ("eval", "exec", "compile", "__import__"):
            setattr(module, name, refuse)
    return str(xacro.process_file(path, mappings=dict(arguments), verbosity=0).toxml())


def main() -> None:
    """Expand the file that standard input names."""
    given, out = json.load(sys.stdin), sys.stdout
    sys.stdout = sys.stderr = io.StringIO()  # xacro prints warnings
    _limit()
    try:
        text = expand(given["path"], given["arguments"], given["folders"])
        if len(text) > _LARGEST:
            raise ValueError("the result is larger than 16 MiB")
        answer = {"text": text}
    except RecursionError:
        answer = {"error": "macros call each other without an end"}
    except MemoryError:
        answer = {"error": "it takes too much memory"}
    except Exception as error:
        answer = {"error": f"{error or type(error).__name__}"[:2000]}
        with suppress(ImportError):
            import xacro
            from xacro import substitution_args

            stack = [name for name in getattr(xacro, "filestack", ()) if name]
            answer["file"] = Path(stack[-1]).name if stack else ""
            cause: object = error
            while cause is not None:
                if isinstance(cause, substitution_args.ArgException):
                    answer["argument"] = str(cause)
                cause = getattr(cause, "exc", None)
    out.write(json.dumps(answer))
    out.flush()
    os._exit(0)
