"""A mesh that its pieces do not contain is worth a word."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from planning.cell.shape import Element, shape_of
from twin.check.finding import Subject
from twin.check.lying import check_meshes
from twin.scenario.manifest import load_scenario

FILE = Path(__file__).parents[3] / "scenarios" / "assembly" / "shapes.yaml"


def test_what_is_outside_of_all_pieces_is_told() -> None:
    subject = Subject(load_scenario(FILE), FILE.parent)
    assert list(check_meshes(subject)) == []
    housing = subject.cell.object("housing")
    form = replace(housing.shape.elements[0].form, missed=0.0012)  # type: ignore[type-var]
    shape = shape_of("housing", [Element(form, np.eye(4))])
    objects = (replace(housing, shape=shape), *subject.cell.objects[1:])
    subject.__dict__["cell"] = replace(subject.cell, objects=objects)
    (found,) = check_meshes(subject)
    assert "housing is up to 1.2 mm outside" in found.message
    assert not found.error
