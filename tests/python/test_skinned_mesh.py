"""Virtual meshes under poses: never farther from the source in that pose than stated, closed, drawn where it is.

Beside linear blend skinning of the source in NumPy, distances by libigl, and `TriangleMesh`, which is told where
each vertex goes. `-s` prints how tight bounds are.
"""

from __future__ import annotations

import copy
import functools
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import nanite_rs as nrs
from conftest import SOAK
from oracles import camera, compare, memory, subjects, topology
from oracles.distance import Surface

NAMES = ("sphere", "knot", "part", *(("gyroid", "terrain", "sheets", "armadillo") if SOAK else ()))
SKINS = ("arm", "sharp", "chain", "patches")
SAMPLES = 20_000 if SOAK else 4_000
POSES = 5 if SOAK else 1


def weights_of(skin: str, vertices: np.ndarray) -> np.ndarray:
    """Weights of joints along the longest axis, or in patches all over."""
    span = np.ptp(vertices, axis=0)
    x = (vertices[:, span.argmax()] - vertices[:, span.argmax()].min()) / span.max()
    if skin == "arm":
        upper = np.clip((x - 0.3) / 0.4, 0, 1)
        upper = upper * upper * (3 - 2 * upper)
        return np.stack([1 - upper, upper], axis=1).astype(np.float32)
    if skin == "sharp":
        return np.stack([x < 0.5, x >= 0.5], axis=1).astype(np.float32)
    if skin == "chain":
        joints = 9
        hats = np.clip(1 - np.abs(x[:, None] * (joints - 1) - np.arange(joints)), 0, 1)
        return (hats / hats.sum(axis=1, keepdims=True)).astype(np.float32)
    rng = np.random.default_rng(5)
    places = vertices[rng.choice(len(vertices), 6, replace=False)]
    near = np.exp(-((np.linalg.norm(vertices[:, None] - places, axis=2) / (0.25 * span.max())) ** 2))
    return (near / near.sum(axis=1, keepdims=True)).astype(np.float32)


def pose_of(kind: str, joints: int, size: float, seed: int) -> np.ndarray:
    """A pose of joints: (J, 4, 4)."""
    rng = np.random.default_rng(seed)
    matrices = np.tile(np.eye(4), (joints, 1, 1))
    for matrix in matrices[1:]:
        if kind == "bent":
            matrix[:3, :3] = Rotation.from_rotvec(rng.normal(size=3) * 0.4).as_matrix()
            matrix[:3, 3] = rng.normal(size=3) * 0.1 * size
        elif kind == "stretched":
            matrix[:3, :3] = np.eye(3) * rng.uniform(0.5, 2.0) + rng.normal(size=(3, 3)) * 0.2
            matrix[:3, 3] = rng.normal(size=3) * 0.3 * size
        elif kind == "turned as one":
            turned = Rotation.from_rotvec([0.3, -1.2, 0.5]).as_matrix()
            matrices[:, :3, :3], matrices[:, :3, 3] = turned, size * np.array([1.0, 2.0, -0.5])
    return matrices


def skinned(vertices: np.ndarray, weights: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Linear blend skinning as it is written down."""
    weights = np.asarray(weights, float)
    blended = np.einsum("vj,jab->vab", weights / weights.sum(axis=1, keepdims=True), matrices)
    return np.einsum("vab,vb->va", blended, np.c_[vertices, np.ones(len(vertices))])[:, :3]


@functools.cache
def body(
    name: str, skin: str, quality: str = "best"
) -> tuple[nrs.SkinnedMesh, np.ndarray, np.ndarray, np.ndarray]:
    source = subjects.subject(name)
    weights = weights_of(skin, np.asarray(source.vertices, float))
    mesh = nrs.NaniteMesh.from_arrays(
        source.vertices,
        source.faces,
        channels={"weights": weights},
        options=nrs.BuildOptions(quality=quality),
    )
    return nrs.SkinnedMesh(mesh), np.asarray(source.vertices, float), np.asarray(source.faces), weights


@pytest.mark.parametrize("quality", ["best", "fast"])
@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("name", NAMES)
def test_stated_errors_hold_under_any_pose(name: str, skin: str, quality: str) -> None:
    posed, vertices, faces, weights = body(name, skin, quality)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    ratios = []
    for seed in range(POSES):
        for kind in ("bent", "stretched"):
            matrices = pose_of(kind, posed.joints, size, seed)
            posed.pose(matrices)
            source = Surface(skinned(vertices, weights, matrices), faces)
            diagonal = float(np.linalg.norm(np.ptp(posed.bounds, axis=0)))
            shown = set()
            for error in (0.003, 0.01, 0.03, 0.1, 0.3):
                cut = posed.cut(error=error * diagonal)
                assert cut.error <= error * diagonal
                if len(cut) in shown:
                    continue
                shown.add(len(cut))
                drawn = Surface(cut.vertices, cut.faces)
                out = source.nearest(drawn.samples(SAMPLES, seed))[0].max()
                back = drawn.nearest(source.samples(SAMPLES, seed))[0].max()
                worst = max(out, back)
                assert worst <= cut.error + 1e-6 * diagonal, (
                    f"{kind} {seed}: {worst} is stated as {cut.error}"
                )
                if worst > 1e-5 * diagonal:
                    ratios.append(cut.error / worst)
    if ratios:
        print(
            f"\n{name} | {skin} | {quality} | {min(ratios):.2f} | {np.median(ratios):.2f} | {max(ratios):.1f}"
        )


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("name", ["sphere", "part"])
def test_full_detail_is_the_source_under_the_pose(name: str, skin: str) -> None:
    posed, vertices, faces, weights = body(name, skin)
    matrices = pose_of("stretched", posed.joints, 2.0, 3)
    posed.pose(matrices)
    cut, expected = posed.cut(error=0.0), skinned(vertices, weights, matrices)
    span = np.ptp(expected, axis=0).max()
    assert len(cut) == len(faces)
    assert cut.error < 1e-6 * span
    assert Surface(expected, faces).nearest(cut.vertices)[0].max() < 1e-6 * span
    assert Surface(cut.vertices, cut.faces).nearest(expected)[0].max() < 1e-6 * span
    low, high = posed.bounds
    assert (low <= expected.min(axis=0) + 1e-6 * span).all()
    assert (high >= expected.max(axis=0) - 1e-6 * span).all()


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("name", ["sphere", "knot", "part"])
def test_no_pose_opens_a_cut(name: str, skin: str) -> None:
    posed, vertices, faces, _ = body(name, skin)
    if not topology.is_closed(topology.by_position(vertices, faces)):
        pytest.skip(f"{name} is open")
    for seed, kind in enumerate(("bent", "stretched", "stretched")):
        posed.pose(pose_of(kind, posed.joints, 2.0, seed))
        for error in (0.003, 0.02, 0.1, 0.5):
            cut = posed.cut(error=error)
            assert topology.is_closed(topology.by_position(cut.vertices, cut.faces))


def test_seams_stay_closed() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    weights = weights_of("patches", np.asarray(vertices, float))
    # Texture coordinates of each face for itself: seams everywhere.
    corners = faces.reshape(-1)
    uvs = np.random.default_rng(1).random((len(faces) // 50 + 1, 2))[
        np.repeat(np.arange(len(faces)) // 50, 3)
    ]
    mesh = nrs.NaniteMesh.from_arrays(
        vertices[corners],
        np.arange(len(corners)).reshape(-1, 3),
        uvs=uvs,
        channels={"weights": weights[corners]},
    )
    posed = nrs.SkinnedMesh(mesh)
    posed.pose(pose_of("stretched", posed.joints, 2.0, 1))
    for error in (0.0, 0.01, 0.05, 0.3):
        cut = posed.cut(error=error)
        assert topology.is_closed(topology.by_position(cut.vertices, cut.faces))


def test_all_joints_as_one_cost_nothing() -> None:
    posed, _, _, _ = body("sphere", "chain")
    for kind in ("rest", "turned as one"):
        posed.pose(pose_of(kind, posed.joints, 2.0, 0))
        for error in (0.005, 0.02, 0.1):
            there, at_rest = posed.cut(error=error), posed.rest.cut(error=error)
            assert abs(len(there) - len(at_rest)) <= 0.02 * len(at_rest)


def test_budgets_take_whole_groups() -> None:
    posed, _, _, _ = body("sphere", "arm")
    posed.pose(pose_of("bent", posed.joints, 2.0, 0))
    cut = posed.cut(target_faces=2_000)
    assert 1_000 < len(cut) <= 2_000
    assert cut.error > 0


def picture(shape: nrs.SkinnedMesh | nrs.TriangleMesh, **options) -> nrs.Frame:
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    scene.add(shape, material=nrs.Material(base_color=(0.8, 0.7, 0.6)))
    scene.add(nrs.DirectionalLight(intensity=2.0), pose=camera.look_at((2, 3, 3), (0, 0, 0)))
    pose = camera.look_at((0.5, 1.0, 7.0), (0.0, 0.0, 0.0))
    with nrs.Renderer(320, 240, backend="cpu") as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.9), pose, **options)


@pytest.mark.parametrize("skin", SKINS)
def test_pictures_are_those_of_every_vertex_where_it_goes(skin: str) -> None:
    posed, vertices, faces, weights = body("part", skin)
    matrices = pose_of("bent", posed.joints, 2.0, 2)
    posed.pose(matrices)
    whole = nrs.TriangleMesh(skinned(vertices, weights, matrices), faces)
    ours, theirs = picture(posed, pixel_error=0.0), picture(whole)
    both = (ours.depth > 0) & (theirs.depth > 0)
    assert ((ours.depth > 0) != (theirs.depth > 0)).sum() < 20
    assert np.percentile(np.abs(ours.depth - theirs.depth)[both], 99) < 1e-4
    assert compare.psnr(ours.color, theirs.color) > 30
    coarse = picture(posed)
    assert coarse.stats.triangles <= ours.stats.triangles
    assert compare.psnr(coarse.color, ours.color) > 30


def test_culling_changes_nothing() -> None:
    posed, _, _, _ = body("knot", "chain")
    posed.pose(pose_of("stretched", posed.joints, 1.0, 4))
    culled, all_drawn = picture(posed), picture(posed, occlusion=False)
    assert (culled.color == all_drawn.color).all()
    assert (culled.depth == all_drawn.depth).all()


def test_both_backends_draw_them(backend: str) -> None:
    posed, _, _, _ = body("sphere", "arm")
    posed.pose(pose_of("bent", posed.joints, 2.0, 1))
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(posed)
    with nrs.Renderer(96, 64, backend=backend) as renderer:
        assert (renderer.render(scene, nrs.PerspectiveCamera(yfov=0.9), camera.at(0, 0, 5)).depth > 0).any()


def test_memory_is_flat_over_poses(backend: str) -> None:
    posed = nrs.SkinnedMesh(body("sphere", "chain")[0].rest)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(posed)
    count = 10_000 if SOAK and backend == "cpu" else 150
    poses = [pose_of("bent", posed.joints, 2.0, seed) for seed in range(16)]
    held = []
    with nrs.Renderer(64, 48, backend=backend) as renderer:
        for step in range(count):
            posed.pose(poses[step % len(poses)])
            renderer.render(scene, nrs.PerspectiveCamera(yfov=0.9), camera.at(0, 0, 5))
            if (step + 1) % (count // 3) == 0:
                held.append(memory.resident())
    # What other tests left may go once; what is lost is so in each third.
    assert min(np.diff(held)) < 15_000_000, held


def test_motion_is_where_vertices_went() -> None:
    posed, _, _, _ = body("sphere", "arm")
    posed.pose(pose_of("rest", posed.joints, 2.0, 0))
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(posed)
    lens, pose = nrs.OrthographicCamera(xmag=2.0, ymag=2.0), camera.at(0, 0, 5)
    matrices = np.tile(np.eye(4), (2, 1, 1))
    matrices[:, 0, 3] = 0.25
    with nrs.Renderer(128, 128, backend="cpu") as renderer:
        renderer.render(scene, lens, pose, motion=True)
        posed.pose(matrices)
        frame = renderer.render(scene, lens, pose, motion=True)
    moved = frame.motion[frame.depth > 0]
    assert np.abs(moved - (8.0, 0.0)).max() < 0.02


def test_every_node_shows_the_pose() -> None:
    posed = nrs.SkinnedMesh(body("sphere", "arm")[0].rest)
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    first, second = scene.add(posed), scene.add(posed, pose=camera.at(5, 0, 0))
    assert first.mesh is posed
    before = scene.bounds.copy()
    matrices = np.tile(np.eye(4), (2, 1, 1))
    matrices[:, 1, 3] = 10.0
    posed.pose(matrices)
    assert np.allclose(scene.bounds - before, [[0, 10, 0]] * 2, atol=0.05)
    assert second.mesh is posed


def test_files_and_copies_keep_them(tmp_path) -> None:
    posed, _, _, _ = body("sphere", "chain")
    matrices = pose_of("bent", posed.joints, 2.0, 5)
    posed.pose(matrices)
    cut = posed.cut(error=0.02)
    for other in (copy.copy(posed), copy.deepcopy(posed), pickle.loads(pickle.dumps(posed))):
        assert (other.matrices == matrices).all()
        assert (other.cut(error=0.02).vertices == cut.vertices).all()
    posed.rest.save(tmp_path / "body.nanite")
    stored = nrs.SkinnedMesh(nrs.NaniteMesh.open(tmp_path / "body.nanite"))
    stored.pose(matrices)
    there = stored.cut(error=0.02)
    assert abs(len(there) - len(cut)) < 0.1 * len(cut)
    assert Surface(cut.vertices, cut.faces).nearest(there.vertices)[0].max() < cut.error + there.error


def test_mistakes_are_named() -> None:
    posed, _, _, _ = body("sphere", "arm")
    before = posed.matrices
    with pytest.raises(nrs.ArgumentError, match="channel: the mesh has no channel"):
        nrs.SkinnedMesh(posed.rest, channel="skin")
    with pytest.raises(nrs.DtypeError, match="mesh: expected a NaniteMesh"):
        nrs.SkinnedMesh(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=20)))
    with pytest.raises(nrs.ArgumentError, match=r"matrices: expected \(2, 4, 4\), not \(3, 4, 4\)"):
        posed.pose(np.tile(np.eye(4), (3, 1, 1)))
    wrong = np.tile(np.eye(4), (2, 1, 1))
    wrong[1, 3, 0] = 0.5
    with pytest.raises(nrs.ArgumentError, match="the last row of joint 1"):
        posed.pose(wrong)
    wrong = np.tile(np.eye(4), (2, 1, 1))
    wrong[1, 0, 0] = np.nan
    with pytest.raises(nrs.ArgumentError, match="that of joint 1 is not finite"):
        posed.pose(wrong)
    assert (posed.matrices == before).all()
    with pytest.raises(nrs.ArgumentError, match="joints: row 1 has joint 5 of 3"):
        nrs.SkinnedMesh.joint_weights([[0], [5]], [[1.0], [1.0]], joint_count=3)
    with pytest.raises(nrs.ArgumentError, match=r"weights: row 0 has -1\.0"):
        nrs.SkinnedMesh.joint_weights([[0], [1]], [[-1.0], [1.0]])
    for wrong, message in (("abc", "expected real numbers"), (np.eye(4)[None] * 1j, "expected real numbers")):
        with pytest.raises(nrs.DtypeError, match=f"matrices: {message}"):
            posed.pose(wrong)
    labels = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20), channels={"weights": np.arange(12)})
    with pytest.raises(nrs.ArgumentError, match="expected weights as float32"):
        nrs.SkinnedMesh(labels)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "uint32", "uint64", "int8", "int64"])
def test_joint_weights_of_any_integers(dtype: str) -> None:
    rows = nrs.SkinnedMesh.joint_weights(
        np.array([[0, 3], [2, 2]], dtype), np.array([[1, 3], [1, 1]], np.uint8)
    )
    assert (rows == [[0.25, 0, 0, 0.75], [0, 0, 1, 0]]).all()
    assert nrs.SkinnedMesh.joint_weights(np.empty((0, 4), dtype), np.empty((0, 4))).shape == (0, 0)


@pytest.mark.parametrize("scale", [0.0, 1e-20, 1e20])
def test_extreme_poses_do_no_harm(scale: float) -> None:
    posed = nrs.SkinnedMesh(body("sphere", "arm")[0].rest)
    matrices = np.tile(np.eye(4) * [scale, scale, scale, 1.0], (2, 1, 1))
    posed.pose(matrices)
    cut = posed.cut(error=0.0)
    assert np.isfinite(cut.vertices).all()
    picture(posed)
