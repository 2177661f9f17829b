"""Base class of all sections of a scenario file: strict fields and names."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from twin.scenario.document.descriptions import described

NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$"
Name = Annotated[str, Field(pattern=NAME, max_length=64)]
"""Names become parts of file names and of paths in a recording."""


Item = TypeVar("Item")
Two = Annotated[tuple[Item, ...], Field(min_length=2, max_length=2)]
Three = Annotated[tuple[Item, ...], Field(min_length=3, max_length=3)]
Several = Annotated[tuple[Item, ...], Field(min_length=1)]
"""Lists of two and of three entries, and lists that are not empty."""


class Section(BaseModel):
    """A mapping of the file: no unknown keys, no silent conversion, no change afterwards."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema with what the docstring says of every key."""
        return described(handler.resolve_ref_schema(handler(core)), cls)


def plain_values(section: Section, *, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the values of a section by names without units, angles in radians.

    ``size_m`` becomes ``size``, ``yaw_deg`` becomes ``yaw``: what classes of planning call them.

    Args:
        section: the section.
        without: keys to leave out.
    """
    out: dict[str, Any] = {}
    for key, value in section:
        name, _, unit = key.rpartition("_")
        if key in without:
            continue
        if unit == "deg" and value is not None:
            angles = np.deg2rad(value).tolist()
            value = tuple(angles) if isinstance(angles, list) else angles
        out[name if unit in ("m", "rad", "deg") else key] = value
    return out


def with_tuples(value: Any) -> Any:
    """Return what was read from JSON with tuples for lists, which strict sections ask for."""
    if isinstance(value, dict):
        return {key: with_tuples(entry) for key, entry in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value
