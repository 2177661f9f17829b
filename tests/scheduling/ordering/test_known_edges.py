"""Edges from what is known of pairs of tasks are those of a search among all nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.ordering.beam_search import TaskOrderSearch, find_blocks, put_in_order
from scheduling.ordering.relations import TaskRelations, connect_in_order
from tests.shipped_runs import ShippedRuns


@pytest.mark.parametrize(
    "name",
    [
        "lego/cliff",
        "multi_arm/tray",
        pytest.param("multi_arm/assembly", marks=pytest.mark.nightly),
    ],
)
def test_edges_are_those_of_a_search_among_all_nodes(
    name: str, shipped: ShippedRuns
) -> None:
    planned = shipped(name).planned
    tpg = planned.turns or planned.tpg
    relations = TaskRelations(DerivedTpg(tpg))
    blocks = find_blocks(tpg.chains, relations)
    way = TaskOrderSearch(relations, blocks).best_way(8)
    order = [blocks[b] for b in way.order()]
    assert order != blocks
    chains = put_in_order(tpg.chains, relations, order)
    found = connect_in_order(chains, relations, order)
    searched = connect_nodes(DerivedTpg(replace(tpg, chains=chains)))
    assert np.array_equal(found.edges, searched.edges)
    makespan = float(DerivedTpg(found).rollout.makespan)
    assert makespan == pytest.approx(max(way.clocks), abs=1e-6)
