"""Samplers of the library optuna that choose the designs to evaluate; a resumed search makes the same choices."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from twin.explorations.dimensions import (
    Dimension,
    Values,
    all_designs,
    base_values,
    key_of,
)
from twin.explorations.journal import TriedDesign
from twin.explorations.section import SamplerName
from twin.host.extras import extra_module

_PENALTY = 1e9
"""Objective of refused designs for samplers without constraints, larger for earlier rungs."""

_CONSTRAINED_SAMPLERS = "tpe", "nsga-ii"
"""Samplers that support constraints."""

_REFUSED = "refused"
"""Name of the only constraint: by how much a design is refused."""

optuna_module = partial(
    extra_module, package="optuna", extra="explore", needs="exploring designs"
)


class Search:
    """A sampler that chooses designs and learns from their evaluations.

    Each design is chosen with a seed of its own, made from its number. So the choice depends on the earlier
    evaluations, and not on whether the program was stopped in between.

    Args:
        dimensions: the varied keys.
        sampler: how designs are chosen.
        goals: number of goals; all are minimized.
        seed: of all choices.
        expected: total number of designs, from which the sampler's start-up and population size follow.

    Raises:
        RequestError: optuna is not installed.
    """

    def __init__(
        self,
        dimensions: Sequence[Dimension],
        sampler: SamplerName,
        goals: int,
        seed: int,
        expected: int,
    ) -> None:
        self._optuna = optuna_module("optuna")
        if sampler == "cma-es":
            optuna_module("cmaes", package="cmaes")
        self._optuna.logging.set_verbosity(self._optuna.logging.ERROR)
        self._dimensions, self._name = tuple(dimensions), sampler
        self._goals, self._seed, self._expected = goals, seed, expected
        self._space = _space(self._optuna, dimensions)
        self._study = self._optuna.create_study(directions=["minimize"] * goals)
        self._asked: dict[int, Any] = {}
        self._left = {key_of(own): own for own in all_designs(dimensions)}
        self._left.pop(key_of(base_values(dimensions)), None)
        self.evaluated = 0

    def ask(self, number: int) -> Values:
        """Return the values of a design; number 1 is the first, 0 is the base design.

        In a finite space, no design is chosen twice before every design was chosen.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._study.sampler = self._sampler(number)
            trial = self._study.ask(fixed_distributions=self._space)
        self._asked[number] = trial
        values = _values(self._dimensions, trial.params)
        if self._left and key_of(values) not in self._left:
            words = np.random.SeedSequence([self._seed, number, 1])
            among = list(self._left.values())
            values = among[int(np.random.default_rng(words).integers(len(among)))]
        self._left.pop(key_of(values), None)
        return values

    def tell(self, row: TriedDesign) -> None:
        """Learn the evaluation of a design, also of one that it has not chosen, if that is within the space."""
        trial = self._asked.pop(row.design, None)
        found = row.evaluation
        values = found.goals or (_PENALTY * (1.0 + found.violation),) * self._goals
        if trial is not None and _values(self._dimensions, trial.params) == row.values:
            if self._name in _CONSTRAINED_SAMPLERS:
                trial.set_constraint(_REFUSED, found.violation)
            self._study.tell(trial, list(values))
        else:
            if trial is not None:
                state = self._optuna.trial.TrialState.FAIL
                self._study.tell(trial, state=state)
            if (parameters := _parameters(self._dimensions, row.values)) is not None:
                made = self._optuna.trial.create_trial(
                    params=parameters, distributions=self._space, values=list(values)
                )
                if self._name in _CONSTRAINED_SAMPLERS:
                    made.set_constraint(_REFUSED, found.violation)
                self._study.add_trial(made)
        self.evaluated += 1

    def replay(self, rows: Sequence[TriedDesign]) -> Mapping[int, Values]:
        """Repeat earlier ask and tell calls.

        Args:
            rows: of the search, in the order of the sampler's updates.

        Returns:
            Designs that were chosen but never evaluated.
        """
        lost: dict[int, Values] = {}
        there = {row.design for row in rows}
        following = 1
        for evaluated, row in enumerate(rows):
            asked = [
                r.design for r in rows if r.asked_after <= evaluated and r.design > 0
            ]
            while following <= max(asked, default=0):
                values = self.ask(following)
                if following not in there:
                    lost[following] = values
                following += 1
            self.tell(row)
        return lost

    def _sampler(self, number: int) -> Any:
        samplers = self._optuna.samplers
        words = np.random.SeedSequence([self._seed, number]).generate_state(1)
        seed = int(words[0])
        if self._name == "random":
            return samplers.RandomSampler(seed=seed)
        if self._name == "cma-es":
            base = {one.key: one.base for one in self._dimensions}
            start = _parameters(self._dimensions, base)
            return samplers.CmaEsSampler(x0=start, seed=seed)
        first = int(np.clip(self._expected // 5, 5, 20))
        if self._name == "nsga-ii":
            size = int(np.clip(self._expected // 5, 8, 50))
            return samplers.NSGAIISampler(population_size=size, seed=seed)
        return samplers.TPESampler(
            n_startup_trials=first, multivariate=True, constant_liar=True, seed=seed
        )


def _space(optuna: Any, dimensions: Sequence[Dimension]) -> dict[str, Any]:
    """Return optuna's distributions for all dimensions: for an order, one sort key per entry (random keys)."""
    kinds, found = optuna.distributions, {}
    for one in dimensions:
        if one.choices:
            places = tuple(range(len(one.choices)))
            found[one.key] = kinds.CategoricalDistribution(places)
        elif one.low is None:
            for k in range(len(one.base)):
                found[f"{one.key}#{k}"] = kinds.FloatDistribution(0.0, 1.0)
        elif one.whole:
            found[one.key] = kinds.IntDistribution(one.low, one.high)
        else:
            found[one.key] = kinds.FloatDistribution(one.low, one.high)
    return found


def _values(dimensions: Sequence[Dimension], parameters: Mapping[str, Any]) -> Values:
    """Return the values of a design from optuna's parameters."""
    found: dict[str, Any] = {}
    for one in dimensions:
        if one.choices:
            found[one.key] = one.choices[parameters[one.key]]
        elif one.ordered:
            rank = [parameters[f"{one.key}#{k}"] for k in range(len(one.base))]
            order = sorted(range(len(rank)), key=lambda k: rank[k])
            found[one.key] = [one.base[k] for k in order]
        else:
            found[one.key] = parameters[one.key]
    return found


def _parameters(
    dimensions: Sequence[Dimension], values: Values
) -> dict[str, Any] | None:
    """Return optuna's parameters of a design's values; None where a value is not within its dimension."""
    found: dict[str, Any] = {}
    for one in dimensions:
        value = values[one.key]
        if not one.holds(value):
            return None
        if one.choices:
            found[one.key] = one.choices.index(value)
        elif one.ordered:
            left = list(range(len(one.base)))
            for place, entry in enumerate(value):
                k = next(k for k in left if one.base[k] == entry)
                left.remove(k)
                found[f"{one.key}#{k}"] = (place + 0.5) / len(value)
        else:
            found[one.key] = value if one.whole else float(value)
    return found
