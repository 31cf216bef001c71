"""Cuts by error, by budget and by view, and simplify() in the place of fast-simplification."""

import fast_simplification
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import camera, distance, subjects, topology
from oracles.dag import Dag


@pytest.fixture(scope="module")
def sphere():
    return subjects.built("sphere")


def test_targets_are_kept_and_approached(sphere) -> None:
    total = len(sphere.cut(error=0.0).faces)
    for target in (total, total - 1, total // 2, total // 10, 3000, 1000, 500):
        cut = sphere.cut(target_faces=target, exact=False)
        assert target - largest_step(sphere, cut) < len(cut.faces) <= target
        assert_met(len(sphere.cut(target_faces=target).faces), target)
    for reduction in (0.0, 0.25, 0.9, 0.99):
        by_reduction = sphere.cut(target_reduction=reduction)
        by_faces = sphere.cut(target_faces=int(np.floor(total * (1 - reduction) + 1e-9)))
        np.testing.assert_array_equal(by_reduction.faces, by_faces.faces)
        np.testing.assert_array_equal(by_reduction.vertices, by_faces.vertices)


def assert_met(faces: int, target: int) -> None:
    """The count is the target, or up to 0.5 % or two fewer."""
    assert target - max(0.005 * target, 2) <= faces <= target


def largest_step(mesh: nrs.NaniteMesh, cut: nrs.Cut) -> int:
    """Triangles that undoing one group of a cut adds, at most; one if the cut has all triangles of the source.

    The next finer cut of whole groups undoes one whose clusters the cut draws.
    """
    d = Dag.of(mesh)
    simplified = d.origin >= 0
    made = np.bincount(d.origin[simplified], d.triangles[simplified], len(d.group_error))
    saved = np.bincount(d.group, d.triangles, len(d.group_error)) - made
    drawn = np.unique(d.origin[simplified & np.isin(d.ids, cut.cluster_ids)])
    return int(saved[drawn].max(initial=1))


def test_budget_below_the_coarsest_gives_the_coarsest(sphere) -> None:
    coarsest = sphere.cut(error=1e9)
    assert np.array_equal(sphere.cut(error=np.inf).faces, coarsest.faces)
    assert len(sphere.cut(target_faces=1).faces) == len(coarsest.faces)
    assert len(coarsest.faces) < 300


def test_errors_rise_and_faces_fall(sphere) -> None:
    errors = np.geomspace(1e-6, 1, 25)
    cuts = [sphere.cut(error=e) for e in errors]
    for error, cut in zip(errors, cuts, strict=True):
        assert cut.error <= error
    sizes = [len(c.faces) for c in cuts]
    assert sizes == sorted(sizes, reverse=True)
    stated = [c.error for c in cuts]
    assert stated == sorted(stated)


def test_cut_for_an_error_states_no_more(sphere) -> None:
    """The rule also weighs what normals show, so that the shape of a cut may be nearer than was asked for."""
    for target in (20_000, 5_000, 900):
        cut = sphere.cut(target_faces=target)
        again = sphere.cut(error=cut.error)
        assert again.error <= cut.error


def test_views_coarsen_with_distance_and_tolerance(sphere) -> None:
    lens = nrs.PerspectiveCamera(yfov=0.8, znear=0.01)
    sizes = []
    for distance_ in (2, 4, 8, 16, 32, 64, 128):
        pose = camera.look_at(np.array([0, 0, float(distance_)]), np.zeros(3))
        sizes.append(len(sphere.cut(camera=lens, pose=pose, viewport=(1280, 720), pixel_error=1.0).faces))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 10 * sizes[-1]
    pose = camera.look_at(np.array([0, 0, 3.0]), np.zeros(3))
    sizes = [
        len(sphere.cut(camera=lens, pose=pose, viewport=(1280, 720), pixel_error=e).faces)
        for e in (0, 0.25, 0.5, 1, 2, 4, 16)
    ]
    assert sizes == sorted(sizes, reverse=True)


def test_a_near_view_of_a_large_terrain_refines_what_is_near() -> None:
    vertices, faces = nrs.shapes.terrain(faces=400_000, seed=2)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    corner = vertices[np.argmax(vertices[:, 0] + vertices[:, 2])]
    pose = camera.look_at(corner + np.array([0.05, 0.1, 0.05]), np.zeros(3))
    lens = nrs.PerspectiveCamera(yfov=0.8, znear=0.001)
    cut = mesh.cut(camera=lens, pose=pose, viewport=(1280, 720), pixel_error=16.0)
    away = np.linalg.norm(cut.vertices[cut.faces].mean(axis=1) - pose[:3, 3], axis=1)
    levels = [cut.face_levels[(low < away) & (away <= 2 * low)].mean() for low in (0.1, 0.2, 0.4, 0.8, 1.6)]
    assert levels == sorted(levels)
    assert levels[-1] > levels[0] + 1.5
    assert len(cut.faces) < 0.5 * len(faces)


def test_to_trimesh_is_watertight(sphere) -> None:
    cut = sphere.cut(target_reduction=0.9)
    tm = cut.to_trimesh()
    assert isinstance(tm, trimesh.Trimesh)
    assert tm.is_watertight
    assert tm.is_winding_consistent
    assert tm.euler_number == 2
    assert len(tm.faces) == len(cut.faces)
    np.testing.assert_allclose(tm.vertex_normals, cut.normals, atol=1e-3)


def test_arrays_are_owned_contiguous_and_writable(sphere) -> None:
    cut = sphere.cut(target_faces=1000)
    for array in (cut.vertices, cut.faces, cut.normals, cut.cluster_ids):
        assert array.flags.c_contiguous
        assert array.flags.writeable
        assert array.flags.owndata or array.base is not None
    before = sphere.cut(target_faces=1000).vertices.copy()
    cut.vertices[:] = 0
    np.testing.assert_array_equal(sphere.cut(target_faces=1000).vertices, before)


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"error": 0.1, "target_faces": 10},
        {"error": -1.0},
        {"error": np.nan},
        {"error": np.inf, "target_reduction": 0.5},
        {"target_faces": -5},
        {"target_reduction": 1.5},
        {"target_reduction": -0.1},
        {"target_reduction": np.nan},
        {"pixel_error": 1.0},
        {"error": "much"},
    ],
    ids=repr,
)
def test_wrong_cut_arguments_are_named(sphere, arguments) -> None:
    with pytest.raises(nrs.NaniteError) as caught:
        sphere.cut(**arguments)
    names = list(arguments) or ["error"]
    assert any(name in str(caught.value) for name in [*names, "camera"]), str(caught.value)


def test_wrong_views_are_named(sphere) -> None:
    lens = nrs.PerspectiveCamera(yfov=0.8)
    good = {"camera": lens, "pose": np.eye(4), "viewport": (640, 480), "pixel_error": 1.0}
    sphere.cut(**good)
    for name, value in (
        ("pose", np.eye(3)),
        ("pose", np.full((4, 4), np.nan)),
        ("viewport", (0, 480)),
        ("viewport", (640,)),
        ("pixel_error", -1.0),
        ("pixel_error", np.nan),
        ("camera", 3),
    ):
        with pytest.raises(nrs.NaniteError, match=name):
            sphere.cut(**{**good, name: value})


# ------------------------------------------------------------------------------- beside fast-simplification


@pytest.mark.parametrize("name", ["sphere", "bunny", "horse"])
@pytest.mark.parametrize("reduction", [0.5, 0.9])
def test_simplify_takes_the_place_of_fast_simplification(name: str, reduction: float) -> None:
    source = subjects.subject(name)
    scale = 100 / source.diagonal
    faces32 = source.faces.astype(np.int32)
    v, f = nrs.simplify(source.vertices, faces32, target_reduction=reduction)
    pv, pf = nrs.simplify(source.vertices, faces32, reduction)
    np.testing.assert_array_equal(v, pv)
    np.testing.assert_array_equal(f, pf)
    fv, ff = fast_simplification.simplify((source.vertices * scale).astype(np.float32), faces32, reduction)
    assert v.dtype == fv.dtype
    assert np.issubdtype(f.dtype, np.integer)
    assert v.shape[1] == f.shape[1] == 3
    assert_met(len(f), int(len(source.faces) * (1 - reduction) + 1e-6))
    assert len(f) >= 0.999 * len(ff)
    rms = [rms_distance(source, v, f), rms_distance(source, fv / scale, ff)]
    print(
        f"{name} −{reduction:.0%}: {len(f)} faces, rms {rms[0]:.2f};"
        f" fast-simplification {len(ff)} faces, rms {rms[1]:.2f}"
    )
    # As many triangles are nearer: 0.73 to 0.89 times its rms.
    assert rms[0] < 0.95 * rms[1]


def rms_distance(source, vertices: np.ndarray, faces: np.ndarray) -> float:
    """Two-sided, in 1e-4 of the diagonal."""
    given = source.vertices, source.faces
    there = distance.one_sided((vertices, faces), given, 20_000)
    back = distance.one_sided(given, (vertices, faces), 20_000)
    both = np.concatenate([there, back])
    return float(np.sqrt((both**2).mean())) / source.diagonal * 1e4


def test_simplify_by_count_keywords_of_fast_simplification() -> None:
    source = subjects.subject("small sphere")
    _, f = nrs.simplify(source.vertices, source.faces, target_count=1000)
    assert len(f) <= 1000
    with pytest.raises(nrs.NaniteError):
        nrs.simplify(source.vertices, source.faces)
    with pytest.raises(nrs.NaniteError):
        nrs.simplify(source.vertices, source.faces, 0.5, target_count=10)


def test_simplify_of_a_closed_mesh_is_closed() -> None:
    source = subjects.subject("knot")
    v, f = nrs.simplify(source.vertices, source.faces, target_reduction=0.8)
    assert topology.unbalanced_edges(topology.by_position(v, f)) == 0
