"""Every key of the schema says what it means, in the words of its docstring."""

from typing import Annotated, Any, Literal

from pydantic import Field

from twin.document.section import Section, docstring_attributes, docstring_summary
from twin.scenario.schema import scenario_schema


class Base(Section):
    """A base.

    Attributes:
        size_m: of ``it``, over
            two lines [m].
    """

    size_m: float


class Derived(Base):
    """Something derived. More of it.

    Attributes:
        low_s, high_s: bounds [s].
        named: by another name; or

    Raises:
        ValueError: never.
    """

    kind: Literal["derived"] = "derived"
    low_s: float
    high_s: float
    named: Annotated[int, Field(alias="other-name")]
    inner: Base | None = None


def test_docstrings_become_descriptions() -> None:
    schema = Derived.model_json_schema(by_alias=True)
    told = {k: v.get("description") for k, v in schema["properties"].items()}
    assert told == {
        "size_m": "Of `it`, over two lines [m].",
        "kind": "`derived`: Something derived.",
        "low_s": "`low_s`, `high_s`: bounds [s].",
        "high_s": "`low_s`, `high_s`: bounds [s].",
        "other-name": "By another name.",
        "inner": None,
    }
    assert schema["description"] == "Something derived. More of it."
    inner = schema["$defs"]["Base"]["properties"]["size_m"]
    assert inner["description"] == "Of `it`, over two lines [m]."
    assert docstring_summary(Base) == "A base."
    assert set(docstring_attributes(Derived)) == {"size_m", "low_s", "high_s", "named"}


def test_no_key_of_a_scenario_lacks_one() -> None:
    schema = scenario_schema()
    sections: dict[str, dict[str, Any]] = {"Scenario": schema, **schema["$defs"]}
    lacking = [
        f"{name}.{key}"
        for name, section in sections.items()
        for key, part in section.get("properties", {}).items()
        if not part.get("description")
    ]
    assert lacking == []
    for name, section in sections.items():
        assert "Attributes:" not in section.get("description", ""), name


def test_a_property_is_described_where_it_stands() -> None:
    properties = scenario_schema()["properties"]
    assert properties["seed"]["description"] == "Of planning and of all random draws."
    cell = scenario_schema()["$defs"]["RobotSection"]["properties"]
    assert "a name that" in cell["model"]["description"].lower()
