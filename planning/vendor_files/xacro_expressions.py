"""Evaluation of the expressions of xacro files: arithmetic, texts, lists and mappings, and a list of functions.

The tree of an expression is checked against ``_NODES`` and rewritten before it is evaluated: attributes of objects become
entries of mappings, methods and functions become entries of one table. No attribute of a Python object can be read, and nothing
that is not in the table can be called. Time and memory are limited by the process, see ``expand_xacro``.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

_NODES = (
    *(ast.Expression, ast.Constant, ast.Name, ast.Load, ast.List, ast.Tuple, ast.Dict, ast.Subscript, ast.Slice),
    *(ast.UnaryOp, ast.BinOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.cmpop, ast.boolop),
    *(ast.USub, ast.UAdd, ast.Not, ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod),
)  # fmt: skip
"""Nodes of a rewritten expression; functions within expressions and comprehensions are not among them."""

_MATH = (
    *("acos", "asin", "atan", "atan2", "ceil", "cos", "degrees", "exp", "fabs", "floor", "fmod", "hypot", "isclose"),
    *("isfinite", "log", "log10", "pow", "radians", "sin", "sqrt", "tan", "trunc"),
)  # fmt: skip
_PYTHON = (abs, all, any, bool, dict, float, int, len, list, max, min, round, sorted, str, sum, tuple)  # fmt: skip
_CONSTANTS = {name: getattr(math, name) for name in ("pi", "e", "tau", "inf")}
_CONSTANTS |= {"true": True, "false": False}
_METHODS: tuple[Callable[..., Any], ...] = (
    *(str.endswith, str.join, str.lower, str.replace, str.split, str.startswith, str.strip, str.upper),
    *(dict.get, dict.items, dict.keys, dict.values),
)  # fmt: skip

_PLAIN: dict[str, Callable[..., Any]] = {name: getattr(math, name) for name in _MATH}
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **_PLAIN,
    **{f"math.{name}": function for name, function in _PLAIN.items()},
    **{item.__name__: item for item in _PYTHON},
    **{f"python.{item.__name__}": item for item in _PYTHON},
    **{f".{item.__name__}": item for item in _METHODS},
}
"""Functions that expressions may call; methods begin with a dot and take their object first."""


_TABLE = "<functions>"
"""Name of the table of functions in a rewritten expression, which no expression can hold."""

_POWER = "**"
_HIGHEST_POWER = 100

_ERRORS = (ArithmeticError, AttributeError, LookupError, SyntaxError, TypeError, ValueError)  # fmt: skip


class XacroExpressionError(Exception):
    """An expression that is not allowed, or has no value."""


class _Names(dict[str, Any]):
    """Values of names; what can be called is not seen.

    Args:
        values: by name.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        super().__init__()
        self._values = values

    def __missing__(self, name: str) -> Any:
        for known in (self._values, _CONSTANTS):
            # Tables of xacro do not always say that they have what they have.
            with suppress(KeyError):
                if not callable(found := known[name]):
                    return found
        raise XacroExpressionError(f"{name!r} is not defined")


class _Rewriting(ast.NodeTransformer):
    """Removal of attributes and check of calls; ``functions`` are those that may be called."""

    def __init__(self, functions: Mapping[str, Callable[..., Any]]) -> None:
        self._functions = functions

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        """Replace an attribute by an entry of a mapping, and one of ``math`` by a constant."""
        if ast.unparse(node.value) == "math" and node.attr in _CONSTANTS:
            return ast.Constant(_CONSTANTS[node.attr])
        return ast.Subscript(
            self.visit(node.value), ast.Constant(node.attr), ast.Load()
        )

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Replace powers by calls of ``_power``."""
        left, right = self.visit(node.left), self.visit(node.right)
        if isinstance(node.op, ast.Pow):
            return ast.Call(_entry(_POWER), [left, right], [])
        return ast.BinOp(left, node.op, right)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Replace what is called by an entry of the table of functions."""
        name, items = ast.unparse(node.func), list(map(self.visit, node.args))
        if isinstance(node.func, ast.Attribute) and name not in self._functions:
            name = f".{node.func.attr}"
            items.insert(0, self.visit(node.func.value))
        if node.keywords or name not in self._functions:
            raise XacroExpressionError(
                f"{name[:60]!r} is no function that may be called"
            )
        return ast.Call(_entry(name), items, [])


def _entry(name: str) -> ast.expr:
    table = ast.Name(_TABLE, ast.Load())
    return ast.Subscript(table, ast.Constant(name), ast.Load())


def _power(base: float, exponent: float) -> float:
    """Return a power, by floating-point numbers where whole ones would be long."""
    small = abs(exponent) <= _HIGHEST_POWER
    return float(base**exponent if small else math.pow(base, exponent))


def evaluate(
    text: str, values: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
) -> Any:
    """Return the value of an expression.

    Args:
        text: the expression.
        values: of names.
        functions: that may be called, by name.

    Raises:
        XacroExpressionError: it is no expression, not allowed, or without a value.
    """
    try:
        tree = _Rewriting(functions).visit(ast.parse(text.strip(), mode="eval"))
        for node in ast.walk(tree):
            if not isinstance(node, _NODES):
                raise XacroExpressionError(f"{type(node).__name__} is not allowed")
        code = compile(ast.fix_missing_locations(tree), "<expression>", "eval")
        names = _Names(values)
        names[_TABLE] = {**functions, _POWER: _power}
        return eval(code, {"__builtins__": {}}, names)  # of a rewritten tree
    except _ERRORS as error:
        raise XacroExpressionError(f"{type(error).__name__}: {error}") from None
