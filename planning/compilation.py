"""Faster steps of numba's compiler, with the same results.

numba resolves each operation by trying all functions that are registered for it, and most of its passes
look up the variables of each instruction by a general recursion. Both take a fifth of a compilation.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from numba.core import ir
from numba.core.types.functions import BaseFunction

_OPERATORS = frozenset(value for value in vars(operator).values() if callable(value))


def shorten_compilation() -> None:
    """Replace the steps in numba, for this process."""
    BaseFunction.get_call_type = _remember_operators(BaseFunction.get_call_type)  # type: ignore[method-assign]
    ir.Inst._rec_list_vars = _list_variables  # type: ignore[method-assign]


def _remember_operators(resolve: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method that resolves an operator once for each tuple of types of its arguments."""
    known: dict[Any, Any] = {}

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or self.typing_key not in _OPERATORS:
            return resolve(self, context, args, kws)
        key = self.typing_key, context, tuple(args)
        if key not in known:
            signature = resolve(self, context, args, kws)
            known[key] = signature, self._impl_keys[signature.args]
            return signature
        signature, self._impl_keys[signature.args] = known[key]
        return signature

    return get_call_type


def _list_variables(self: Any, value: Any) -> list[ir.Var]:
    """Return the variables in a part of an instruction."""
    if type(value) is ir.Var:
        return [value]
    if isinstance(value, ir.Inst):
        return value.list_vars()  # type: ignore[no-any-return]
    if isinstance(value, dict):
        value = value.values()
    elif not isinstance(value, (list, tuple)):
        return []
    return [
        variable
        for part in value
        if type(part) is not str
        for variable in _list_variables(self, part)
    ]
