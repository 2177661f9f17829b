"""Scenario section of a design exploration: design variables, goals and constraints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from planning.bounds import LONGEST_S
from twin.document.section import OptionalSection, Section
from twin.explorations.expressions import Expression, Inequality

RESULTS = (
    "makespan_s",
    "mean_s",
    "p50_s",
    "p90_s",
    "late",
    "failed",
    "throughput_per_h",
    "floor_area_m2",
    "robots",
    "price",
)
"""Results of a design that goals and constraints may use."""

REPLICATED = frozenset(
    {"mean_s", "p50_s", "p90_s", "late", "failed", "throughput_per_h"}
)
"""Results that are computed from replications."""

EFFORTS: Mapping[str, float] = {
    "order": 1.0,
    "home": 1.0,
    "grip": 1.0,
    "feeder": 2.0,
    "base": 5.0,
    "tool": 8.0,
}
"""Default efforts of single changes by their kind; synthetic values, in any unit."""

Kind = Literal["order", "home", "grip", "feeder", "base", "tool"]
Key = Annotated[str, Field(min_length=1, max_length=300)]
Number = int | float
SamplerName = Literal["tpe", "cma-es", "nsga-ii", "random"]


Condition = Annotated[
    str, AfterValidator(lambda text: Inequality(text, RESULTS).check().text)
]


class VarySection(Section):
    """A key that may have other values.

    Attributes:
        key: any that ``twin study --vary`` takes, such as ``cell.robots.left.base.xyz_m.0``.
        low, high: it is between these, in the unit of the key; a whole number where both of these and
            that of the scenario are.
        values: it is one of these; or
        order: with true, it is a list, and its entries may be in any order.
        moves: keys of numbers that change by as much, such as those of parts that lie in a tray.
        mirrors: keys of numbers that change by as much the other way.
    """

    key: Key
    low: Number | None = None
    high: Number | None = None
    values: Annotated[tuple[Any, ...], Field(max_length=1000)] | None = None
    order: bool = False
    moves: Annotated[tuple[Key, ...], Field(max_length=200)] = ()
    mirrors: Annotated[tuple[Key, ...], Field(max_length=200)] = ()

    @model_validator(mode="after")
    def _one_way(self) -> VarySection:
        if (self.low is None) != (self.high is None):
            raise ValueError("give both of low and high")
        variants = (self.low is not None, self.values is not None, self.order)
        if sum(variants) != 1:
            raise ValueError("give low and high, or values, or order: true")
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError(f"low {self.low:g} is not below high {self.high:g}")
        if self.values is not None and len(self.values) < 2:
            raise ValueError("values are two or more")
        if (self.moves or self.mirrors) and self.low is None:
            raise ValueError("moves and mirrors go with low and high")
        return self


class GoalSection(Section):
    """Something that is to be as small or as great as can be: a result, or arithmetic over results.

    Attributes:
        minimise: what is to be small; or
        maximise: what is to be great.
    """

    minimise: str | None = None
    maximise: str | None = None

    @model_validator(mode="after")
    def _one_expression(self) -> GoalSection:
        if (self.minimise is None) == (self.maximise is None):
            raise ValueError("give 'minimise' or 'maximise', one of them")
        self.expression.check()
        return self

    @property
    def expression(self) -> Expression:
        """The minimised or maximised expression."""
        return Expression(self.minimise or self.maximise or "", RESULTS)

    @property
    def sign(self) -> float:
        """Factor that turns the goal into a minimisation."""
        return -1.0 if self.minimise is None else 1.0

    @property
    def words(self) -> str:
        """Description of the goal."""
        return f"{'minimise' if self.minimise else 'maximise'} {self.expression.text}"


class ExploreSection(OptionalSection):
    """What ``twin explore`` varies, and what it looks for.

    Attributes:
        vary: what may be different.
        goals: the first one alone, or several, of which the best compromises are looked for.
        constraints: comparisons that must hold, such as ``late <= 0.05``.
        prices: of models of robots and of tools, by name, for the result ``price``.
        deadline_s: ``late`` is the share of runs that take longer [s].
        sampler: how designs are chosen: ``tpe`` and ``cma-es`` learn from those that were tried,
            ``nsga-ii`` is for several goals, ``random`` learns nothing. Default: ``tpe`` for one
            goal, ``nsga-ii`` for several.
        designs: how many are tried, the scenario as it is among them.
        seconds: for how long more are tried, at most; what is found depends on the machine [s].
        replications: of each design that is planned, all with the same draws.
        finalists: how many of the best are told apart in the end.
        most_replications: of each finalist, where it takes so many to tell them apart.
        plans: how often the best design and the scenario as it is are planned, each time with another seed of
            the planner, so that what the design is worth is told apart from the luck of its plan.
        confidence: of all intervals.
        efforts: of single changes by their kind, in any unit: of another order of steps, HOME, grip, place of
            a feeder or of a base, and of a quicker tool.
        design_limit_s: a design that takes longer is given up [s].
    """

    purpose = (
        "What may be different, and what is looked for, where designs of the cell are explored; nothing else"
        " depends on it."
    )

    vary: Annotated[tuple[VarySection, ...], Field(max_length=1000)] = ()
    goals: Annotated[tuple[GoalSection, ...], Field(min_length=1, max_length=4)] = (
        GoalSection(minimise="mean_s"),
    )
    constraints: Annotated[tuple[Condition, ...], Field(max_length=50)] = ()
    prices: dict[str, Annotated[float, Field(ge=0, le=1e12)]] = Field(
        default_factory=dict
    )
    deadline_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    sampler: SamplerName | None = None
    designs: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    seconds: Annotated[float, Field(gt=0, le=1e9)] | None = None
    replications: Annotated[int, Field(ge=2, le=10_000)] = 50
    finalists: Annotated[int, Field(ge=1, le=20)] = 3
    most_replications: Annotated[int, Field(ge=2, le=100_000)] = 2000
    plans: Annotated[int, Field(ge=1, le=100)] = 5
    confidence: Annotated[float, Field(ge=0.5, le=0.9999)] = 0.95
    efforts: dict[Kind, Annotated[float, Field(gt=0, le=1e9)]] = Field(
        default_factory=dict
    )
    design_limit_s: Annotated[float, Field(ge=1, le=LONGEST_S)] = 900.0

    @model_validator(mode="after")
    def _consistent(self) -> ExploreSection:
        used = frozenset[str]().union(*(e.used for e in self.expressions))
        if "late" in used and self.deadline_s is None:
            raise ValueError("'late' is the share of runs after deadline_s: give it")
        if "price" in used and not self.prices:
            raise ValueError(
                "'price' is the sum of the prices of models and tools: give prices"
            )
        if self.sampler == "cma-es" and len(self.goals) > 1:
            raise ValueError(
                "sampler 'cma-es' is for one goal (valid for several: tpe, nsga-ii, random)"
            )
        if self.most_replications < self.replications:
            raise ValueError(
                f"most_replications {self.most_replications} is below replications"
                f" {self.replications}"
            )
        return self

    @property
    def inequalities(self) -> tuple[Inequality, ...]:
        """The constraints."""
        return tuple(Inequality(text, RESULTS) for text in self.constraints)

    @property
    def expressions(self) -> tuple[Expression | Inequality, ...]:
        """All expressions over results: goals and constraints."""
        return (*(goal.expression for goal in self.goals), *self.inequalities)

    @property
    def chosen_sampler(self) -> SamplerName:
        """The sampler that is used."""
        return self.sampler or ("tpe" if len(self.goals) == 1 else "nsga-ii")

    @property
    def replicates(self) -> bool:
        """Whether a goal or a constraint needs replications."""
        return any(one.used & REPLICATED for one in self.expressions)


def explore_section(scenario: Section) -> ExploreSection | None:
    """Return the explore section of a scenario, None if it has none."""
    found: ExploreSection | None = getattr(scenario, "explore", None)
    return found
