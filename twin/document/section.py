"""Base class of all sections of a scenario file: strict fields, names, and key descriptions in the JSON schema."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from inspect import cleandoc
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from planning.bounds import LONGEST_NAME
from twin.document.yaml_text import KeyPath

_ATTRIBUTES = re.compile(r"^Attributes:\n((?:[ ]+.*\n?|\n)*)", re.MULTILINE)
_ENTRY = re.compile(r"^    (\w+(?:, \w+)*): ")
_OR = re.compile(r"; or(?: else)?$")
_CODE = re.compile(r"``([^`]+)``")
NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$"
Name = Annotated[str, Field(pattern=NAME, max_length=LONGEST_NAME)]
"""Names become parts of file names and of paths in a recording."""


Item = TypeVar("Item")

Several = Annotated[tuple[Item, ...], Field(min_length=1)]
"""Lists of two and of three entries, and lists that are not empty."""


def described_schema(schema: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """Return the schema of a section with descriptions of its properties.

    Args:
        schema: of the section itself, without references at its top.
        model: its class.
    """
    about = docstring_summary(model)
    meanings = docstring_attributes(model)
    names = {field.alias or name: name for name, field in model.model_fields.items()}
    properties = {}
    for key, part in schema.get("properties", {}).items():
        words = meanings.get(names.get(key, key))
        if "const" in part and isinstance(part["const"], str):
            words = f"`{part['const']}`: {about.split('. ')[0].rstrip('.')}."
        properties[key] = part if words is None else {**part, "description": words}
    return {**schema, "description": about, "properties": properties}


def docstring_summary(model: type[BaseModel]) -> str:
    """Return the docstring of a class before its attributes, in one paragraph."""
    text = _ATTRIBUTES.split(cleandoc(model.__doc__ or ""))[0]
    return _plain(text.split("\n\nRaises:")[0])


def docstring_attributes(model: type[BaseModel]) -> dict[str, str]:
    """Return the meanings of the attributes of a class and of its bases, by name."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        match = _ATTRIBUTES.search(cleandoc(base.__doc__ or "") + "\n")
        if match is None or base is BaseModel:
            continue
        names: list[str] = []
        for line in match[1].splitlines():
            entry = _ENTRY.match(line)
            if entry is not None:
                names = entry[1].split(", ")
                keys = ", ".join(f"``{name}``" for name in names)
                start = "" if len(names) == 1 else f"{keys}: "
                found |= dict.fromkeys(names, start + line[entry.end() :])
            else:
                found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return {name: _plain(words) for name, words in found.items()}


def _plain(text: str) -> str:
    """Return a docstring's text in one line, with Markdown code quotes."""
    words = " ".join(_CODE.sub(r"`\1`", text).split())
    words = _OR.sub(".", words)
    return words[:1].upper() + words[1:]


if TYPE_CHECKING:
    PairOf = tuple[Item, Item]
    TripleOf = tuple[Item, Item, Item]
else:
    PairOf = Annotated[tuple[Item, ...], Field(min_length=2, max_length=2)]
    TripleOf = Annotated[tuple[Item, ...], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """A mapping of the file: no unknown keys, no silent conversion, no change afterwards.

    Of the keys of each group in ``not_both``, its own and those of its bases, one may be given, which
    is to have another value than it has by itself.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )

    not_both: ClassVar[tuple[tuple[str, ...], ...]] = ()

    @model_validator(mode="after")
    def _check_exclusive_keys(self) -> Self:
        fields, bases = type(self).model_fields, reversed(type(self).__mro__)
        for group in (g for base in bases for g in vars(base).get("not_both", ())):
            given = [k for k in group if getattr(self, k) != fields[k].default]
            if len(given) > 1:
                raise ValueError(f"give {' or '.join(given)}, not both")
        return self

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema with what the docstring says of every key."""
        return described_schema(handler.resolve_ref_schema(handler(core)), cls)

    def changed(self, **values: object) -> Self:
        """Return the section with other values, which are not checked again."""
        return self.model_copy(update=values)


class OptionalSection(Section):
    """Optional top-level section of a scenario, which does not affect runs.

    Attributes:
        purpose: purpose of the section, shown by editors.
    """

    purpose: ClassVar[str]


def with_tuples(value: Any) -> Any:
    """Return JSON content with tuples for lists, as strict sections need."""
    if isinstance(value, dict):
        return {key: with_tuples(entry) for key, entry in value.items()}
    return tuple(map(with_tuples, value)) if isinstance(value, list) else value


def iterate_nested(value: object, at: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    """Yield all values nested in a section, list or mapping, innermost first, with their keys in the file.

    Args:
        value: where to look.
        at: its path, the prefix of nested paths.
    """
    entries: Any = ()
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        entries = ((fields[key].alias or key, part) for key, part in value)
    elif isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, tuple | list):
        entries = enumerate(value)
    for key, part in entries:
        yield from iterate_nested(part, (*at, key))
    yield at, value
