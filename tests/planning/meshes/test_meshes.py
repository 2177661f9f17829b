"""Meshes become convex pieces that contain them; what cannot be used is named with a remedy."""

import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from trimesh.creation import annulus, box, icosphere

from planning import caches
from planning.cell.shape import Mesh
from planning.errors import ShapeError
from planning.meshes import convex_pieces
from planning.meshes import mesh_loading as module
from planning.meshes.convex_pieces import _outside
from planning.meshes.mesh_loading import load_mesh
from planning.meshes.prisms import prism_pieces
from planning.meshes.simplified_surface import simplify_surface
from planning.transforms import Array, Indices, from_rpy


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(caches, "LEAST_SECONDS_TO_CACHE", 0.0)
    monkeypatch.setattr(module, "_LOADED", caches.BoundedCache(64))


def written(mesh: trimesh.parent.Geometry, path: Path) -> Path:
    mesh.export(path)
    return path


def tray() -> trimesh.Trimesh:
    """Five boxes that touch, as a CAD program writes them: two walls end at the others."""
    walls = [box((0.12, 0.08, 0.004))]
    for x in (-0.058, 0.058):
        walls.append(box((0.004, 0.08, 0.04)).apply_translation((x, 0, 0.02)))
    for y in (-0.038, 0.038):
        walls.append(box((0.12, 0.004, 0.04)).apply_translation((0, y, 0.02)))
    whole = trimesh.util.concatenate(walls)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def ring(sections: int = 24) -> trimesh.Trimesh:
    made: trimesh.Trimesh
    made = annulus(r_min=0.02, r_max=0.04, height=0.03, sections=sections)
    return made


def with_holes(mesh: trimesh.Trimesh, *gone: int) -> trimesh.Trimesh:
    keep = np.ones(len(mesh.faces), bool)
    keep[list(gone)] = False
    mesh = mesh.copy()
    mesh.update_faces(keep)
    return mesh


def beyond(form: Mesh, points: Array) -> float:
    return float(np.min([_outside(hull, points) for hull in form.hulls], axis=0).max())


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".STL"])
@pytest.mark.parametrize(
    ("mesh", "pieces"),
    [(box((0.1, 0.2, 0.3)), 1), (icosphere(2, 0.02), 1), (tray(), 5)],
    ids=["box", "ball", "tray"],
)
def test_convex_bodies_are_their_hulls(
    mesh: trimesh.Trimesh, pieces: int, suffix: str, tmp_path: Path
) -> None:
    form = load_mesh(written(mesh, tmp_path / f"part{suffix}"))
    assert len(form.hulls) == pieces
    assert len(form.faces) == len(mesh.faces)
    assert form.volume == pytest.approx(mesh.volume, rel=1e-4)
    np.testing.assert_allclose(form.centre, mesh.center_mass, atol=1e-6)
    points = trimesh.sample.sample_surface(mesh, 500, seed=1)[0]
    assert beyond(form, points) <= 1e-6


def test_pieces_of_a_ring_contain_it_and_leave_its_hole_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = ring()
    file = written(mesh, tmp_path / "ring.stl")
    form = load_mesh(file)
    points = trimesh.sample.sample_surface(mesh, 3000, seed=7)[0]
    assert beyond(form, points) <= form.missed + 2e-5
    assert form.missed <= 1e-5
    # Hollows are filled by a sixtieth of the longest edge at most; the hole is 20 mm wide.
    inner = trimesh.creation.cylinder(0.02 - 0.08 / 60 - 5e-4, 0.03).vertices
    assert min(_outside(hull, inner).min() for hull in form.hulls) > 0.0
    assert form.volume == pytest.approx(mesh.volume, rel=1e-4)

    # The next time they are remembered, also for a copy of the file.
    def never(*_: object) -> None:
        raise AssertionError("cut again")

    monkeypatch.setattr(module, "cut_convex", never)
    monkeypatch.setattr(module, "_LOADED", caches.BoundedCache(64))
    again = load_mesh(written(mesh, tmp_path / "copy.stl"))
    for one, other in zip(form.hulls, again.hulls, strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(AssertionError, match="cut again"):
        load_mesh(file, within=0.004)


def test_millimetres_and_holes(tmp_path: Path) -> None:
    big = with_holes(icosphere(2, 25.0), 3, 150, 300)
    form = load_mesh(written(big, tmp_path / "mm.stl"), 0.001)
    assert len(form.hulls) == 1
    np.testing.assert_allclose(np.ptp(form.vertices, axis=0), 0.05, rtol=0.02)
    whole = icosphere(2, 0.025).volume
    assert form.volume == pytest.approx(whole, rel=0.05)


def test_an_open_ring_is_closed(tmp_path: Path) -> None:
    form = load_mesh(written(with_holes(ring(), 5, 17), tmp_path / "open.stl"))
    assert len(form.hulls) < 30
    points = trimesh.sample.sample_surface(ring(), 2000, seed=2)[0]
    assert beyond(form, points) <= 1e-3


def test_a_fine_ball_has_few_corners_around_it(tmp_path: Path) -> None:
    mesh = icosphere(5, 0.02)
    form = load_mesh(written(mesh, tmp_path / "fine.stl"))
    (hull,) = form.hulls
    assert len(hull) < 200
    assert beyond(form, mesh.vertices) <= 1e-5
    assert np.linalg.norm(hull, axis=1).max() < 0.0225


def test_a_simplified_torus_stays_closed_and_near() -> None:
    mesh = trimesh.creation.torus(0.1, 0.03, major_sections=48, minor_sections=30)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    copy = simplify_surface(vertices, faces, 800)
    found = trimesh.Trimesh(copy.vertices, copy.faces, process=False)
    assert len(copy.faces) == 800
    assert found.is_watertight
    assert found.euler_number == 0
    assert found.volume == pytest.approx(mesh.volume, rel=0.02)
    assert 0.0 < copy.error < 1.5e-3
    same = simplify_surface(vertices, faces, len(faces))
    np.testing.assert_array_equal(same.faces, faces)
    assert same.error < 1e-9


def helical_gear(around: int, across: int) -> trimesh.Trimesh:
    """Return a gear of helical teeth with a bore, of long thin triangles along its flanks."""
    u = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[:, None]
    v = np.linspace(0.0, 2.0 * np.pi, across, endpoint=False)[None, :]
    a, b = (np.sign(w) * np.abs(w) ** 0.3 for w in (np.cos(v), np.sin(v)))
    z = 0.03 * b + 0.0 * u
    tooth = 0.012 / (1.0 + np.exp(-12.0 * np.cos(18.0 * (u + 4.0 * z))))
    radius = 0.06 + 0.03 * a + tooth * np.clip(a, 0.0, 1.0)
    points = np.stack([radius * np.cos(u), radius * np.sin(u), z], axis=-1)
    number = np.arange(around * across).reshape(around, across)
    right, up = np.roll(number, -1, axis=0), np.roll(number, -1, axis=1)
    both = np.roll(right, -1, axis=1)
    faces = [(number, right, both), (number, both, up)]
    made = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in faces]
    return trimesh.Trimesh(points.reshape(-1, 3), np.concatenate(made), process=False)


@pytest.mark.parametrize(
    "mesh",
    [
        pytest.param(
            trimesh.creation.torus(0.1, 0.03, major_sections=48, minor_sections=30),
            marks=pytest.mark.nightly,
            id="torus",
        ),
        pytest.param(helical_gear(90, 17), id="gear"),
    ],
)
def test_pieces_of_a_copy_contain_each_triangle(
    mesh: trimesh.Trimesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex_pieces, "_MOST_CUT", 1000)
    monkeypatch.setattr(convex_pieces, "_COPY", (400,))
    form = load_mesh(written(mesh, tmp_path / "body.stl"), within=0.012)
    assert 0.0 < form.simplified < 5e-3
    assert len(form.faces) == len(mesh.faces)
    assert form.missed <= 1e-5
    points = trimesh.sample.sample_surface(mesh, 5000, seed=2)[0]
    assert beyond(form, np.vstack([points, mesh.vertices])) <= 1.1e-5
    # The hole stays open.
    assert min(_outside(hull, np.zeros((1, 3))).min() for hull in form.hulls) > 0.0


@pytest.mark.nightly
def test_a_mesh_of_35000_triangles_is_cut_in_seconds(tmp_path: Path) -> None:
    mesh = helical_gear(360, 49)
    file = written(mesh, tmp_path / "gear.stl")
    measure = (
        "import sys, time; from pathlib import Path\n"
        "from tests.peak_memory import peak_kb\n"
        "from planning.meshes.mesh_loading import load_mesh\n"
        "begin = time.process_time(); form = load_mesh(Path(sys.argv[1]))\n"
        "used = time.process_time() - begin\n"
        "print(len(form.faces), len(form.hulls), used, peak_kb())"
    )
    for most in (20.0, 2.0):  # the second time, the pieces are read
        ran = subprocess.run(
            [sys.executable, "-c", measure, str(file)],
            capture_output=True,
            text=True,
            check=True,
        )
        triangles, pieces, seconds, peak = map(float, ran.stdout.split())
        assert triangles == 35_280
        assert 18 <= pieces <= 256
        assert seconds < most
        assert peak < 1 << 20  # kB
    form = load_mesh(file)
    points = trimesh.sample.sample_surface(mesh, 50_000, seed=2)[0]
    assert beyond(form, np.vstack([points, mesh.vertices])) <= 1.1e-5


def stl(*triangles: npt.ArrayLike) -> bytes:
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *np.ravel(t).tolist(), 0) for t in triangles
    )
    return bytes(80) + struct.pack("<I", len(triangles)) + body


FLAT = stl([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 0, 0), (0, 1, 0), (-1, 0, 0)])
LINE = stl([(0, 0, 0), (1, 0, 0), (2, 0, 0)])


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gone.stl", None, r"gone\.stl is not there: relative paths start at"),
        ("a.step", b"", r"a\.step is of an unknown kind.*valid: \.stl, \.obj"),
        ("a.stl", b"", r"a\.stl (cannot be read as STL|has no triangles)"),
        (
            "a.stl",
            b"hello there, this is no mesh" * 9,
            r"a\.stl (cannot be read|has no triangles).*export",
        ),
        (
            "a.stl",
            stl([(0, 0, 0)] * 3)[:-30],
            r"a\.stl (cannot be read|has no triangles).*export",
        ),
        (
            "a.stl",
            stl(*[[(0.1, 0.7, -0.3), (0.9, 0.3, 0.1), (0.2, 0.1, 0.8)]] * 9)[:-30],
            r"a\.stl (is cut off|cannot be read|has no triangles).*export",
        ),
        (
            "a.stl",
            bytes(range(256)) * 3,
            r"a\.stl (is cut off|cannot be read|has no triangles).*export",
        ),
        ("a.obj", b"v 0 0 0\nv 1 0 0\n", r"a\.obj .*export"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", r"a\.obj .*export"),
        ("a.stl", LINE, r"a\.stl has only triangles without an area"),
        ("a.stl", FLAT, r"a\.stl is flat, .*give the sheet a thickness"),
    ],
)
def test_useless_files_are_named_with_a_remedy(
    name: str, content: bytes | None, words: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ShapeError, match=words):
        load_mesh(file)


@pytest.mark.parametrize("kind", ["stl_ascii", "obj"])
def test_names_in_any_encoding_do_no_harm(kind: str, tmp_path: Path) -> None:
    text = trimesh.exchange.export.export_mesh(
        box((0.1, 0.2, 0.3)), None, file_type=kind
    )
    named = {"stl_ascii": b"solid Geh\xe4use", "obj": b"# Geh\xe4use"}[kind]
    _, rest = text.encode().split(b"\n", 1)
    file = tmp_path / ("a.stl" if kind == "stl_ascii" else "a.obj")
    file.write_bytes(named + b"\n" + rest)
    assert load_mesh(file).volume == pytest.approx(0.006)


@pytest.mark.parametrize(
    ("edge", "scale", "words"),
    [
        (
            120.0,
            None,
            r"measures 120 x 120 x 120 m: if it is in millimetres, write scale",
        ),
        (120.0, 100.0, r"measures 1\.2e\+04 x .*write scale: 0\.001"),
        (5e-5, None, r"less than a tenth of a millimetre"),
    ],
)
def test_sizes_that_nothing_has_are_refused(
    edge: float, scale: float | None, words: str, tmp_path: Path
) -> None:
    file = written(box((edge,) * 3), tmp_path / "cube.stl")
    with pytest.raises(ShapeError, match=words):
        load_mesh(file, scale)
    if edge > 1.0:
        assert load_mesh(file, 1.0).volume == pytest.approx(edge**3)
    missing = np.array([[np.nan, 0, 0], [1, 0, 0], [0, 1, 0]])
    file.write_bytes(stl(missing))
    with pytest.raises(ShapeError, match=r"cube\.stl .*export it again"):
        load_mesh(file)


def test_too_many_pieces_ask_for_a_coarser_cut(tmp_path: Path) -> None:
    grid = [
        box((0.01, 0.01, 0.01)).apply_translation((0.03 * i, 0.03 * j, 0.03 * k))
        for i in range(7)
        for j in range(7)
        for k in range(6)
    ]
    file = written(trimesh.util.concatenate(grid), tmp_path / "grid.stl")
    with pytest.raises(
        ShapeError, match=r"grid\.stl: .*294 convex pieces, more than 256"
    ):
        load_mesh(file)


@given(st.integers(0, 2**20), st.integers(1, 5), st.integers(1, 5))
@example(66, 2, 5)  # cut along a line, a triangle without area is left
@settings(max_examples=40, deadline=None)
def test_milled_bodies_are_covered_exactly(seed: int, wide: int, deep: int) -> None:
    """A point is in a piece if and only if it is in a cell that is not milled away."""
    rng = np.random.default_rng(seed)
    solid = np.zeros((wide + 2, deep + 2, 4 + 2), dtype=bool)
    height = rng.integers(0, 4, (wide, deep))
    floor = rng.integers(0, 2, (wide, deep))
    level = np.arange(4)
    solid[1:-1, 1:-1, 1:-1] = (level < height[..., None]) & (level >= floor[..., None])
    assume(solid.any() and not _touch_in_an_edge(solid))
    sides = np.array([0.03, 0.02, 0.005])
    turn = from_rpy((0.1, -0.2, 0.3), tuple(rng.uniform(-3.0, 3.0, 3)))
    vertices, faces = _surface(solid, sides)
    vertices = vertices @ turn[:3, :3].T + turn[:3, 3]
    pieces = prism_pieces(vertices, faces, 1e-9, 1000)
    assert pieces is not None
    points = rng.uniform(0.0, 1.0, (400, 3)) * sides * solid.shape
    cell = tuple((points // sides).astype(int).T)
    away = points @ turn[:3, :3].T + turn[:3, 3]
    within = np.array([_inside(piece, away) for piece in pieces])
    assert np.array_equal(within.any(axis=0), solid[cell])
    assert within.sum(axis=0).max() <= 1
    volume = sum(ConvexHull(piece).volume for piece in pieces)
    assert volume == pytest.approx(np.count_nonzero(solid) * np.prod(sides))


@pytest.mark.parametrize("within", [1e-3, 3e-4, 1e-5])
def test_holes_stay_open_but_for_what_may_be_filled(within: float) -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=48)
    pieces = prism_pieces(vertices, faces, 64 * within, 1000)
    assert pieces is not None
    rng = np.random.default_rng(0)
    points = np.column_stack(
        [rng.uniform(-0.02, 0.02, (4000, 2)), rng.uniform(0.0, 0.004, 4000)]
    )
    radius = np.hypot(points[:, 0], points[:, 1])
    covered = np.any([_inside(piece, points) for piece in pieces], axis=0)
    chord = np.cos(np.pi / 48)
    assert covered[(radius > 0.01) & (radius < 0.02 * chord)].all()
    assert not covered[radius < 0.01 * chord - within].any()


def test_finer_pieces_are_made_where_there_may_be_more() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=24)
    counts = [
        len(prism_pieces(vertices, faces, 2e-3, most) or []) for most in (12, 20, 100)
    ]
    assert 0 < counts[0] <= 12 < counts[1] <= 20 < counts[2]
    assert prism_pieces(vertices, faces, 1e-6, 10) is None


def test_leaning_faces_are_for_others() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=12)
    cone = vertices.copy()
    cone[vertices[:, 2] > 0.0, :2] *= 0.98
    assert prism_pieces(vertices, faces, 1e-4, 100) is not None
    assert prism_pieces(cone, faces, 1e-4, 100) is None


def test_open_bodies_are_for_others() -> None:
    vertices, faces = _ring(inner=0.01, outer=0.02, height=0.004, count=12)
    wall = np.ptp(vertices[faces][:, :, 2], axis=1) > 0.0
    assert (
        prism_pieces(vertices, np.delete(faces, np.argmax(wall), 0), 1e-4, 99) is None
    )


def _inside(piece: Array, points: Array) -> Array:
    planes = ConvexHull(piece).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1) < 0.0)


def _touch_in_an_edge(solid: npt.NDArray[np.bool_]) -> bool:
    """Tell whether two cells have an edge in common and no face: four faces meet in it."""
    for one, other in ((0, 1), (0, 2), (1, 2)):
        moved = np.moveaxis(solid, (one, other), (0, 1))
        a, b, c, d = moved[:-1, :-1], moved[1:, 1:], moved[:-1, 1:], moved[1:, :-1]
        if np.any((a & b & ~c & ~d) | (c & d & ~a & ~b)):
            return True
    return False


def _surface(solid: npt.NDArray[np.bool_], sides: Array) -> tuple[Array, Indices]:
    """Return the surface of cells, two triangles a face, whose corners are shared."""
    quads = []
    for axis in range(3):
        for side in (0, 1):
            beyond = np.roll(solid, 1 if side == 0 else -1, axis=axis)
            u, v = np.eye(3, dtype=int)[[k for k in range(3) if k != axis]]
            for cell in np.argwhere(solid & ~beyond):
                at = cell + side * np.eye(3, dtype=int)[axis]
                quads.append([at, at + u, at + u + v, at + v])
    corners = np.array(quads).reshape(-1, 3)
    vertices, number = np.unique(corners, axis=0, return_inverse=True)
    four = number.reshape(-1, 4)
    return vertices * sides, np.vstack([four[:, [0, 1, 2]], four[:, [0, 2, 3]]])


def _ring(
    inner: float, outer: float, height: float, count: int
) -> tuple[Array, Indices]:
    """Return a washer."""
    angle = 2.0 * np.pi * np.arange(count) / count
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    up = np.array([0.0, 0.0, height])
    rows = [inner * circle, outer * circle, outer * circle + up, inner * circle + up]
    k = np.arange(count)
    after = (k + 1) % count
    faces = []
    for row in range(4):
        a, b = count * row, count * ((row + 1) % 4)
        faces.append(np.column_stack([a + k, a + after, b + k]))
        faces.append(np.column_stack([a + after, b + after, b + k]))
    return np.vstack(rows), np.vstack(faces)
