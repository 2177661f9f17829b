"""Union type of all duration models in a scenario file, built-in and registered, selected by the key ``kind``."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Union, get_args

import numpy as np
from pydantic import (
    BaseModel,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from planning.errors import RequestError
from twin.document.section import Section, with_tuples
from twin.durations.model import DurationModel
from twin.registry import DURATIONS

_PROBABILITIES = np.array([1e-6, 0.1, 0.5, 0.9, 1 - 1e-6])
"""At which the quantiles of a registered model are checked."""

_DESCRIBED: ContextVar[bool] = ContextVar("described", default=False)
"""Whether registered models are being described: they may have durations of any kind themselves."""


@dataclass(frozen=True)
class DurationKinds:
    """Metadata of a key whose value is a duration model of any kind.

    Attributes:
        others: sections with a ``kind`` that it may have as well.
    """

    others: tuple[type[Section], ...] = ()

    def __get_pydantic_core_schema__(
        self, _source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        """Return the schema of the union, to which registered kinds are added when a value is read."""
        own = tuple(map(_model_class, DURATIONS.own))
        return core_schema.no_info_wrap_validator_function(
            self._read,
            handler.generate_schema(_union((*own, *self.others))),
            # By the class of the value: registered ones are not in the union.
            serialization=core_schema.wrap_serializer_function_ser_schema(
                lambda value, dump: dump(value), schema=core_schema.any_schema()
            ),
        )

    def __get_pydantic_json_schema__(
        self, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema of the union, with registered kinds."""
        registered = _registered()
        if _DESCRIBED.get() or not registered:
            return handler(core)
        token = _DESCRIBED.set(True)
        try:
            return handler(_adapter(registered, self.others).core_schema)
        finally:
            _DESCRIBED.reset(token)

    def _read(self, value: Any, read: core_schema.ValidatorFunctionWrapHandler) -> Any:
        registered = _registered()
        if not registered:
            return read(value)
        # Strict sections want tuples where JSON has lists.
        found = _adapter(registered, self.others).validate_python(with_tuples(value))
        if isinstance(found, DurationModel) and _kind(found) in registered:
            _require_quantiles(found)
        return found


def _registered() -> tuple[str, ...]:
    """Return the kinds that are not of this program."""
    return tuple(kind for kind in DURATIONS.names() if kind not in DURATIONS.own)


def _model_class(kind: str) -> type[DurationModel]:
    """Return the class of a kind.

    Raises:
        RequestError: the registered object is no class of such models.
    """
    found = DURATIONS.load(kind)
    if not (isinstance(found, type) and issubclass(found, DurationModel)):
        raise RequestError(
            f"the durations entry {kind!r} is {found!r}, not a subclass of DurationModel"
        )
    field = found.model_fields.get("kind")
    if field is None or get_args(field.annotation) != (kind,):
        raise RequestError(
            f"{found.__name__}, registered as duration model {kind!r}, needs the attribute"
            f' kind: Literal["{kind}"] = "{kind}"'
        )
    return found


def _kind(model: DurationModel) -> str:
    return str(getattr(model, "kind", ""))


def _union(classes: tuple[type[BaseModel], ...]) -> Any:
    return Annotated[Union[classes], Field(discriminator="kind")]  # noqa: UP007


@cache
def _adapter(
    registered: tuple[str, ...], others: tuple[type[Section], ...]
) -> TypeAdapter[Section]:
    kinds = map(_model_class, (*DURATIONS.own, *registered))
    return TypeAdapter(_union((*kinds, *others)))


def _require_quantiles(model: DurationModel) -> None:
    """Require finite durations of at least 0 that rise with the probability, else raise a ValueError.

    Engines draw many durations at a time: quantiles have the shape of the probabilities.
    """
    found = np.asarray(model.ppf(_PROBABILITIES))
    if found.shape != _PROBABILITIES.shape:
        raise ValueError(
            f"{_kind(model)}: _ppf of probabilities of shape {_PROBABILITIES.shape} has shape {found.shape}"
        )
    if not (
        np.all(np.isfinite(found)) and found[0] >= 0 and np.all(np.diff(found) >= 0)
    ):
        raise ValueError(
            f"{_kind(model)}: quantiles must be finite, at least 0 and never fall, not {found.tolist()}"
        )
