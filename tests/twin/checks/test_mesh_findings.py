"""Findings about meshes: pieces that were cut from a simplified copy."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from trimesh.creation import box

from planning.cell.shape import Mesh
from twin.checks.meshes import check_meshes


@pytest.mark.parametrize("error", [0.0, 0.0015])
def test_the_error_of_a_simplified_copy_is_stated(error: float) -> None:
    solid = box((0.1, 0.1, 0.1))
    corners = np.array(solid.vertices)
    mesh = Mesh(
        *(corners, np.array(solid.faces), (corners,), 1e-3, np.zeros(3)),
        simplified=error,
    )
    shape = SimpleNamespace(elements=[SimpleNamespace(form=mesh)])
    cell = SimpleNamespace(
        fixtures=[SimpleNamespace(name="hood", shape=shape)], objects=[]
    )
    subject: Any = SimpleNamespace(cell=cell, thing_at=lambda name, key: (name, key))
    found = list(check_meshes(subject))
    assert [f.code for f in found] == ["simplified"] * (error > 0.0)
    for finding in found:
        assert finding.parts == ("hood",)
        assert "hood has 12 triangles" in finding.message
        assert "1.5 mm off" in finding.message
