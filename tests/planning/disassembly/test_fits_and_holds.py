"""Fits, press fits and holds of assemblies with round parts; what is refused; the picture."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from matplotlib.image import imread
from trimesh.transformations import rotation_matrix

from planning.disassembly.assembly_plan import AssemblyPlan, plan_assembly
from planning.disassembly.body import AssemblyBody
from planning.disassembly.group_picture import draw_bodies
from planning.errors import ShapeError, TwinError

LEAN = rotation_matrix(0.7, (1.0, 2.0, 3.0))


def plate(radius: float, sections: int) -> AssemblyBody:
    """Return a round plate with a bore, 20 mm high."""
    mesh = trimesh.creation.annulus(radius, 0.03, 0.02, sections=sections)
    return AssemblyBody("plate", mesh, 7850.0)


def pin(radius: float, sections: int) -> AssemblyBody:
    """Return a pin that stands out of a plate by 10 mm above."""
    mesh = trimesh.creation.cylinder(radius, 0.03, sections=sections)
    mesh.apply_translation((0.0, 0.0, 0.005))
    return AssemblyBody("pin", mesh, 7850.0)


def in_plate(play: float, sections: tuple[int, int], lean: bool) -> AssemblyPlan:
    bodies = [plate(0.005, sections[0]), pin(0.005 - play, sections[1])]
    for body in bodies:
        body.mesh.apply_transform(LEAN if lean else np.eye(4))
    up = LEAN[:3, 2] if lean else (0.0, 0.0, 1.0)
    return plan_assembly(bodies, "plate", up=up)


@pytest.mark.parametrize("lean", [False, True])
@pytest.mark.parametrize("play", [5e-5, 0.0, -2e-4])
@pytest.mark.parametrize("sections", [(64, 17), (12, 64)])
def test_a_pin_fits_however_coarse_it_is(
    play: float, sections: tuple[int, int], lean: bool
) -> None:
    """The vertices of both are on their circles, and the facets of the bore in the way of the pin."""
    plan = in_plate(play, sections, lean)
    (fit,), (step,) = plan.fits, plan.steps
    assert (fit.kind, fit.bodies) == ("pin in bore", ("pin", "plate"))
    assert fit.clearance_m == pytest.approx(play, abs=1e-7)
    up = LEAN[:3, 2] if lean else np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(step.direction, -up, atol=1e-7)
    assert step.distance_m == pytest.approx(0.021, abs=1e-6)


def test_fits_are_said_in_millimetres() -> None:
    assert in_plate(5e-5, (32, 32), False).fits[0].words == "pin in bore: 0.05 mm"
    pressed = in_plate(-2e-4, (32, 32), False).fits[0].words
    assert pressed == "pin in bore: 0.20 mm pressed"


def test_what_is_too_deep_in_each_other_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"plate and pin are in each other"):
        in_plate(-2e-3, (32, 32), False)


def box(
    name: str, size: tuple[float, ...], at: tuple[float, ...], density: float = 1000.0
) -> AssemblyBody:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return AssemblyBody(name, mesh, density)


def test_a_tongue_in_a_slot_is_listed_with_half_its_play() -> None:
    bodies = [
        box("floor", (0.2, 0.2, 0.02), (0.0, 0.0, -0.01)),
        box("tongue", (0.0198, 0.05, 0.03), (0.00002, 0.0, 0.015)),
    ]
    slot = box("slot", (0.02, 0.05, 0.03), (-0.02, 0.0, 0.015))
    other = box("", (0.02, 0.05, 0.03), (0.02, 0.0, 0.015)).mesh
    both = np.vstack([slot.mesh.faces, other.faces + 8])
    corners = np.vstack([slot.mesh.vertices, other.vertices])
    bodies.append(AssemblyBody("slot", trimesh.Trimesh(corners, both)))
    (fit,) = plan_assembly(bodies, "floor").fits
    assert (fit.kind, fit.bodies) == ("tongue in slot", ("tongue", "slot"))
    assert fit.clearance_m == pytest.approx(1e-4, abs=1e-8)


def test_boxes_that_are_in_each_other_are_listed() -> None:
    low = box("low", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    top = box("top", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0997))
    (fit,) = plan_assembly([low, top], "low").fits
    assert (fit.kind, fit.bodies) == ("overlap", ("low", "top"))
    assert abs(fit.clearance_m + 3e-4) <= fit.tolerance_m


@pytest.mark.parametrize("heavy", [True, False])
def test_an_overhanging_beam_is_held_until_its_weight_is_there(heavy: bool) -> None:
    """Its middle is 2 cm beyond the edge; its own weight tips it, the other one's keeps it."""
    bodies = [
        box("table", (0.2, 0.2, 0.1), (0.0, 0.0, -0.05)),
        box("beam", (0.3, 0.04, 0.02), (0.12, 0.0, 0.01)),
        box("weight", (0.06, 0.04, 0.1), (0.0, 0.0, 0.07), 8000.0 if heavy else 10.0),
    ]
    plan = plan_assembly(bodies, "table")
    assert [step.bodies[0] for step in plan.steps] == ["beam", "weight"]
    (hold,) = plan.holds
    assert (hold.body, hold.since, hold.until) == ("beam", 0, 1 if heavy else None)


def test_a_lintel_waits_for_both_posts_and_posts_for_nothing() -> None:
    bodies = [
        box("floor", (0.6, 0.2, 0.1), (0.0, 0.0, -0.05)),
        box("left", (0.04, 0.04, 0.1), (-0.1, 0.0, 0.05)),
        box("lintel", (0.24, 0.04, 0.02), (0.0, 0.0, 0.11)),
        box("right", (0.04, 0.04, 0.1), (0.1, 0.0, 0.05)),
    ]
    plan = plan_assembly(bodies, "floor")
    after = {step.bodies[0]: sorted(step.after) for step in plan.steps}
    assert after == {"left": [], "right": [], "lintel": ["left", "right"]}
    assert plan.holds == ()


def test_meshes_and_names_that_cannot_be_used_are_refused() -> None:
    table = box("table", (0.2, 0.2, 0.1), (0.0, 0.0, -0.05))
    cut = box("cut", (0.1, 0.1, 0.1), (0.0, 0.0, 0.05))
    cut.mesh.update_faces(np.arange(12) > 0)
    with pytest.raises(ShapeError, match="the surface of cut is not closed"):
        plan_assembly([table, cut], "table")
    far = box("far", (0.1, 0.1, 0.1), (np.nan, 0.0, 0.05))
    with pytest.raises(ShapeError, match="far has coordinates that are not finite"):
        plan_assembly([table, far], "table")
    inner = box("inner", (0.01, 0.01, 0.01), (0.0, 0.0, -0.05))
    with pytest.raises(ShapeError, match="table and inner are in each other"):
        plan_assembly([table, inner], "table")
    with pytest.raises(TwinError, match="several bodies are called table"):
        plan_assembly([table, table], "table")
    with pytest.raises(TwinError, match=r"no body floor .valid: table"):
        plan_assembly([table], "floor")
    with pytest.raises(TwinError, match="there are 201 bodies, more than 200"):
        plan_assembly([box(str(k), (1.0,) * 3, (0.0,) * 3) for k in range(201)], "0")
    assert plan_assembly([table], "table").steps == ()


def test_the_picture_shows_the_named_bodies() -> None:
    bodies = [
        box(name, (0.1, 0.1, 0.1), (0.0, 0.0, 0.1 * k)) for k, name in enumerate("abc")
    ]
    picture = imread(io.BytesIO(draw_bodies(bodies, ("a", "c"))))[..., :3]
    blue, orange = picture[..., 2] - picture[..., 0], picture[..., 0] - picture[..., 2]
    assert (blue > 0.3).sum() > 1000
    assert (orange > 0.3).sum() > 1000
