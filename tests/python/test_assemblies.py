"""Assemblies against the same instances added one by one: pictures, shadows, ids, motion, memory, mistakes."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import trimesh
from scipy import ndimage

import nanite_rs as nrs

SIZE = 160, 120
CAMERA = nrs.PerspectiveCamera(yfov=0.8)


def at(points) -> np.ndarray:
    """Poses that move to points."""
    points = np.asarray(points, np.float64)
    poses = np.tile(np.eye(4), (len(points), 1, 1))
    poses[:, :3, 3] = points
    return poses


def turned(poses: np.ndarray) -> np.ndarray:
    """Every second one a quarter of a turn: products of such maps are exact."""
    out = poses.copy()
    out[1::2, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    out[2::4, :3, :3] *= -0.5  # mirrored, too
    return out


@pytest.fixture(scope="module")
def leaf():
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=2_000))


@pytest.fixture(scope="module")
def tree(leaf):
    rng = np.random.default_rng(3)
    green, red = nrs.Material(base_color=(0.2, 0.8, 0.1)), nrs.Material(base_color=(0.8, 0.1, 0.1))
    points = rng.integers(-160, 160, (60, 3)) / 8.0
    return nrs.Assembly(
        [(leaf, turned(at(points[:40])), green), (leaf, at(points[40:]), red)], far_triangles=12_000
    )


@pytest.fixture(scope="module")
def grove(tree, leaf):
    """Trees, and stones that are no trees: two levels."""
    poses = turned(at([(0, 0, 0), (64, 0, 0), (0, 0, -128), (64, 0, -512), (0, 64, 64)]))
    return nrs.Assembly([(tree, poses), (leaf, at([(32, 0, 0), (32, 8, 0)]))], far_triangles=40_000)


def world() -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((3, 5, 4), (0, 0, 0)))
    return scene


def flat(scene: nrs.Scene, item, pose, look=None) -> None:
    """Add what an assembly consists of one by one."""
    if isinstance(item, nrs.Assembly):
        for part, poses, own in item.parts:
            for one in poses:
                flat(scene, part, pose @ one, own)
    else:
        scene.add(item, pose=pose, material=look)


def of(item, poses) -> tuple[nrs.Scene, nrs.Scene]:
    """A scene with an assembly at poses, and the same one by one."""
    whole, single = world(), world()
    whole.add_many(item, poses)
    for pose in poses:
        flat(single, item, pose)
    return whole, single


def pictures(frame) -> tuple[np.ndarray, ...]:
    return frame.color, frame.depth, frame.normal


def same(a, b) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(pictures(a), pictures(b), strict=True))


NEAR = nrs.look_at((60, 20, 50), (10, 0, -10))


@pytest.mark.parametrize("name", ["tree", "grove"])
def test_expanded_it_is_the_picture_of_its_parts_bit_for_bit(request, backend, name) -> None:
    item = request.getfixturevalue(name)
    whole, single = of(item, turned(at([(0, 0, 0), (96, 0, 0), (0, 0, -64)])))
    with nrs.Renderer(*SIZE, backend=backend) as one, nrs.Renderer(*SIZE, backend=backend) as other:
        found = one.render(whole, CAMERA, NEAR, pixel_error=0)
        assert found.stats.assemblies.expanded > 1
        assert (found.depth > 0).mean() > 0.02
        assert same(found, other.render(single, CAMERA, NEAR, pixel_error=0))


@pytest.mark.parametrize("streaming", [False, True])
def test_so_are_streamed_blended_and_sampled_parts(backend, tmp_path, leaf, streaming) -> None:
    leaf.save(tmp_path / "leaf.nanite")
    opened = nrs.NaniteMesh.open(tmp_path / "leaf.nanite")
    glass = nrs.Material(base_color=(1, 0, 0, 0.5), alpha_mode="blend")
    points = np.random.default_rng(0).integers(-80, 80, (20, 3)) / 8.0
    item = nrs.Assembly([(opened, at(points[:10]), glass), (opened, at(points[10:]))], far_triangles=4_000)
    whole, single = of(item, at([(0, 0, 0), (0, 16, 0)]))
    pose, how = nrs.look_at((0, 10, 40), (0, 0, 0)), {"pixel_error": 0, "samples": 4}
    with (
        nrs.Renderer(*SIZE, backend=backend, streaming=streaming) as one,
        nrs.Renderer(*SIZE, backend=backend, streaming=streaming) as other,
    ):
        found, want = one.render(whole, CAMERA, pose, **how), other.render(single, CAMERA, pose, **how)
        assert found.stats.assemblies.expanded == 2
        assert same(found, want)


def test_so_are_its_shadows(backend, tree) -> None:
    whole, single = of(tree, turned(at([(0, 0, 0), (96, 0, 0), (0, 0, -64)])))
    # Nothing lies outside of the picture, where far meshes throw shadows.
    pose = nrs.look_at((100, 100, 200), (40, 0, -20))
    with nrs.Renderer(*SIZE, backend=backend) as one, nrs.Renderer(*SIZE, backend=backend) as other:
        found, want = (
            renderer.render(scene, CAMERA, pose, pixel_error=0, shadows=True)
            for renderer, scene in ((one, whole), (other, single))
        )
        assert (found.stats.assemblies.outside, found.stats.assemblies.expanded) == (0, 3)
        assert same(found, want)


def test_it_is_expanded_where_the_rule_of_cuts_says_so(tree) -> None:
    whole, _ = of(tree, at([(0, 0, 0)]))
    radius = np.linalg.norm(np.ptp(tree.bounds, axis=0)) / 2.0
    focal = 0.5 * SIZE[1] / np.tan(0.4)
    middle = tree.bounds.mean(axis=0)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:

        def expanded(distance: float, tau: float = 1.0) -> int:
            pose = nrs.look_at(np.add(middle, (0, 0, distance)), middle)
            return renderer.render(whole, CAMERA, pose, pixel_error=tau).stats.assemblies.expanded

        # On the axis the bound is error · focal / (distance − radius − error), and its secants at most 1 / cos².
        limit = tree.far_error * focal + radius + tree.far_error
        assert expanded(0.99 * limit) == 1
        assert expanded(2.5 * limit) == 0
        assert expanded(2.5 * limit, tau=0.1) == 1
        assert expanded(0.99 * limit, tau=50.0) == 0


def test_from_far_away_it_is_the_parts_within_the_threshold(backend, tree) -> None:
    poses = at([(0, 0, 0), (40, 0, 0), (-40, 0, -30)])
    whole, single = of(tree, poses)
    with nrs.Renderer(*SIZE, backend=backend) as one, nrs.Renderer(*SIZE, backend=backend) as other:
        for distance in (150, 400, 1_000):
            pose = nrs.look_at((10, 30, distance), (0, 0, 0))
            found, want = one.render(whole, CAMERA, pose), other.render(single, CAMERA, pose, pixel_error=0)
            stats = found.stats.assemblies
            assert (stats.far, stats.parts) == (3, 0)
            shown, parts = found.depth > 0, want.depth > 0
            # No point of either is off by more than a pixel, and a pixel's centre by half of one more.
            disc = ndimage.generate_binary_structure(2, 2)
            grown = ndimage.binary_dilation(parts, disc, iterations=2)
            assert not (shown & ~grown).any()
            assert abs(int(shown.sum()) - int(parts.sum())) <= 0.12 * parts.sum() + 4
            # Materials are those of the parts: green and red in the same shares.
            green = [(f.color[..., 1] > f.color[..., 0])[f.depth > 0].mean() for f in (found, want)]
            assert abs(green[0] - green[1]) < 0.08


def test_both_backends_draw_the_same(backend, grove) -> None:
    whole, _ = of(grove, at([(0, 0, 0), (0, 0, -400)]))
    pose = nrs.look_at((40, 40, 90), (20, 0, -100))
    with nrs.Renderer(*SIZE, backend="cpu") as one, nrs.Renderer(*SIZE, backend=backend) as other:
        for tau in (0.0, 0.3, 1.0):
            a, b = (r.render(whole, CAMERA, pose, pixel_error=tau) for r in (one, other))
            assert np.array_equal(a.depth, b.depth)
            assert np.array_equal(a.instance_id, b.instance_id)
            kinds = ("walked", "outside", "far", "expanded", "parts")
            walks = [[getattr(f.stats.assemblies, kind) for kind in kinds] for f in (a, b)]
            assert walks[0] == walks[1]


def test_levels_are_walked_one_by_one(grove) -> None:
    whole, _ = of(grove, at([(0, 0, 0)]))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        stats = renderer.render(whole, CAMERA, nrs.look_at((0, 0, 30), (0, 0, 0))).stats.assemblies
        # The grove is taken apart, and of its trees those that are near.
        assert stats.walked == 1 + 5
        assert stats.walked == stats.outside + stats.far + stats.expanded
        assert 2 <= stats.expanded < 6
        away = renderer.render(whole, CAMERA, nrs.look_at((32, 0, 900), (32, 0, 1_900))).stats.assemblies
        assert (away.walked, away.outside, away.parts) == (1, 1, 0)


def test_what_is_drawn_depends_on_no_frame_before(backend, grove) -> None:
    whole, _ = of(grove, at([(0, 0, 0), (200, 0, 0)]))
    poses = [nrs.look_at((x, 20, 60), (x + 20, 0, -40)) for x in (0, 120, 40, 260, 0)]
    with nrs.Renderer(*SIZE, backend=backend) as moving:
        for pose in poses:
            found = moving.render(whole, CAMERA, pose, pixel_error=0.5, shadows=True)
            with nrs.Renderer(*SIZE, backend=backend) as fresh:
                assert same(found, fresh.render(whole, CAMERA, pose, pixel_error=0.5, shadows=True))
        again = moving.render(whole, CAMERA, poses[-1], pixel_error=0.5)
        again = moving.render(whole, CAMERA, poses[-1], pixel_error=0.5)
        assert again.stats.assemblies.changed == 0
        assert again.stats.uploaded_bytes == 0


def test_nodes_of_assemblies_are_like_others(backend, tree, leaf) -> None:
    scene = world()
    stone = scene.add(leaf, pose=at([(0, 0, 30)])[0])
    first, second = scene.add(tree), scene.add(tree, pose=at([(48, 0, 0)])[0])
    pose = nrs.look_at((24, 10, 90), (24, 0, 0))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:

        def ids(tau: float) -> set[int]:
            return set(np.unique(renderer.render(scene, CAMERA, pose, pixel_error=tau).instance_id).tolist())

        every = {-1, stone.instance_id, first.instance_id, second.instance_id}
        assert ids(0) == ids(100) == every
        second.visible = False
        assert ids(0) == ids(100) == every - {second.instance_id}
        second.visible = True
        second.pose = at([(1_000, 0, 0)])[0]
        assert ids(0) == every - {second.instance_id}
        second.pose = at([(40, 0, 0)])[0]
        assert ids(0) == every
        first.remove()
        assert ids(0) == every - {first.instance_id}
        third = scene.add(tree, pose=at([(0, 16, 0)])[0])
        assert third.instance_id == first.instance_id != second.instance_id
        assert ids(0) == every
        assert second.mesh is tree
        assert second.material == ()
        assert len(scene) == 3
        with pytest.raises(nrs.ArgumentError, match=r"^material: the parts"):
            second.material = nrs.Material()
        scene.clear()
        assert ids(0) == {-1}


def test_shadows_fall_from_assemblies(backend, tree) -> None:
    ground = nrs.TriangleMesh(
        np.array([[-300, -40, -300], [300, -40, -300], [300, -40, 300], [-300, -40, 300]], np.float32),
        [[0, 2, 1], [0, 3, 2]],
    )
    whole, single = of(tree, at([(0, 0, 0)]))
    nodes = [scene.add(ground) for scene in (whole, single)]
    # The tree itself is behind the camera's back: it stands for itself by its far mesh.
    pose = nrs.look_at((-40, 0, -50), (-40, -40, -50.5))
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        frames = [renderer.render(s, CAMERA, pose, shadows=True, pixel_error=0.05) for s in (whole, single)]
        assert frames[0].stats.assemblies.outside == 1
        dark = [frame.color.astype(int).sum(axis=-1) < 300 for frame in frames]
        assert 0.01 < dark[1].mean() < 0.9
        # What its error adds lies along outlines: of 1 / 15 of a leaf's radius.
        assert (dark[0] != dark[1]).mean() < 0.25 * dark[1].mean()
        whole.instances[0].casts_shadows = False
        lit = renderer.render(whole, CAMERA, pose, shadows=True)
        assert (lit.color.astype(int).sum(axis=-1) < 300).mean() < 0.2 * dark[1].mean()
    assert nodes[0].receives_shadows


def test_parts_move_with_the_whole(tree) -> None:
    scene, other = world(), world()
    node, whole = scene.add(tree), other.add(tree)
    pose = nrs.look_at((0, 0, 70), (0, 0, 0))
    near, far = {"pixel_error": 0, "motion": True}, {"pixel_error": 100, "motion": True}
    with nrs.Renderer(*SIZE, backend="cpu") as one, nrs.Renderer(*SIZE, backend="cpu") as two:
        for how in (near, far, near, near):  # what stands still does, whatever is drawn of it
            frame = one.render(scene, CAMERA, pose, **how)
            assert not frame.motion.any()
        two.render(other, CAMERA, pose, **far)
        node.pose = whole.pose = at([(2, 1, 0)])[0]
        a = one.render(scene, CAMERA, pose, **near)
        b = two.render(other, CAMERA, pose, **near)  # by parts that were not there before
        covered = a.depth > 0
        assert np.array_equal(a.motion, b.motion)
        focal = 0.5 * SIZE[1] / np.tan(0.4)
        moved = focal / a.depth[covered][:, None] * (2, -1)
        assert np.allclose(a.motion[covered], moved, rtol=1e-3, atol=1e-3)


def test_views_of_one_call_see_the_same(tree) -> None:
    whole, _ = of(tree, at([(0, 0, 0)]))
    near, far = (nrs.look_at((0, 10, d), (0, 0, 0)) for d in (40, 900))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frames = renderer.render_views(whole, [(CAMERA, near), (CAMERA, far)])
        assert [frame.stats.assemblies.expanded for frame in frames] == [1, 1]
        assert same(frames[0], renderer.render(whole, CAMERA, near))
        arrays = renderer.render_batch([(whole, CAMERA, pose) for pose in (near, far, near, far)])
        for k, pose in enumerate((near, far)):
            alone = renderer.render(whole, CAMERA, pose)
            assert np.array_equal(arrays["color"][k], alone.color)
            assert np.array_equal(arrays["depth"][k + 2], alone.depth)


def test_the_far_mesh_states_how_far_it_is_off(tree, leaf) -> None:
    assert len(tree) == 60
    assert tree.far_error > 0.0
    assert len(tree.far) <= 12_000
    assert tree.far.cut(error=0).error == tree.far_error
    points = np.concatenate(
        [
            leaf.cut(error=0).vertices @ pose[:3, :3].T + pose[:3, 3]
            for part in tree.parts
            for pose in part.poses
        ]
    )
    cut = tree.far.cut(error=0)
    surface = trimesh.Trimesh(cut.vertices, cut.faces, process=False)
    some = points[:: len(points) // 40]
    _, distance, _ = trimesh.proximity.closest_point_naive(surface, some)
    assert distance.max() <= tree.far_error * (1 + 1e-6)
    low, high = tree.bounds
    assert (points >= low).all()
    assert (points <= high).all()


def test_where_all_parts_fit_the_far_mesh_is_exact(leaf) -> None:
    small = nrs.Assembly([(leaf, at([(0, 0, 0), (8, 0, 0)]))])
    assert len(small.far) == 2 * len(leaf)
    # But for positions that single precision rounds.
    assert small.far_error < 1e-6
    scene = world()
    scene.add(small)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        stats = renderer.render(scene, CAMERA, nrs.look_at((4, 0, 9), (4, 0, 0)), pixel_error=0.01).stats
    assert (stats.assemblies.far, stats.assemblies.expanded) == (1, 0)


def test_far_meshes_can_be_given(leaf) -> None:
    poses = at([(0, 0, 0), (8, 0, 0)])
    far = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=320))
    made = nrs.Assembly([(leaf, poses)], far=far, far_error=9.0)
    assert made.far_error >= 9.0
    assert len(made.far) == 320
    with pytest.raises(nrs.ArgumentError, match=r"^far_error: is needed"):
        nrs.Assembly([(leaf, poses)], far=far)
    with pytest.raises(nrs.ArgumentError, match=r"^far_error: goes with"):
        nrs.Assembly([(leaf, poses)], far_error=1.0)
    with pytest.raises(nrs.DtypeError, match=r"^far: expected a NaniteMesh"):
        nrs.Assembly([(leaf, poses)], far=3, far_error=1.0)


def test_pickles_and_copies_hold_each_mesh_once(grove, leaf) -> None:
    scene = world()
    node = scene.add(grove)
    scene.add(leaf)
    scene.add(grove, pose=at([(300, 0, 0)])[0]).visible = False
    alone = len(pickle.dumps(grove))
    kept = pickle.dumps(scene)
    assert len(kept) < alone + len(pickle.dumps(leaf)) + 20_000
    other = pickle.loads(kept)
    assert other.instances[0].mesh is other.instances[2].mesh
    assert not other.instances[2].visible
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        for tau in (0.0, 1.0):
            found, want = (renderer.render(s, CAMERA, NEAR, pixel_error=tau) for s in (other, scene))
            assert same(found, want)
            again = pickle.loads(pickle.dumps(found))
            assert again.stats.assemblies.walked == found.stats.assemblies.walked
    assert pickle.loads(pickle.dumps(grove)).far_error == grove.far_error
    assert node.mesh is grove


def test_exports_hold_the_parts(tmp_path, tree) -> None:
    scene = nrs.Scene()
    scene.add(tree)
    scene.export(tmp_path / "tree.glb", error=0.2)
    assert len(nrs.load_scene(tmp_path / "tree.glb").scene) == len(tree)


def test_exports_as_usd_hold_the_parts(tmp_path, leaf) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    places = [[0.0, 0, 0], [3, 0, 0], [6, 1, 0]]
    scene = nrs.Scene()
    scene.add_many(nrs.Assembly([(leaf, at(places))], far=leaf, far_error=9.0), at([[0.0, 0, 0], [0, 0, 20]]))
    scene.add(leaf, pose=at([[0.0, 40, 0]])[0])
    scene.export(tmp_path / "a.usda", error=0.2)
    geom = pytest.importorskip("pxr.UsdGeom")
    stage = usd.Stage.Open(str(tmp_path / "a.usda"))
    nodes = stage.GetPrimAtPath("/scene").GetChildren()
    found = [geom.Xformable(node).GetLocalTransformation().ExtractTranslation() for node in nodes]
    expected = np.concatenate([places, np.add(places, [0, 0, 20]), [[0, 40, 0]]])
    assert sorted(tuple(f) for f in found) == sorted(tuple(row) for row in expected.tolist())


def test_far_meshes_serve_other_assemblies(tree) -> None:
    """What a far mesh states itself is not counted again."""
    again = nrs.Assembly(tree.parts, far=tree.far, far_error=0.0)
    assert tree.far_error <= again.far_error <= tree.far_error * (1.0 + 1e-12)


def test_memory_follows_the_parts(leaf) -> None:
    rng = np.random.default_rng(0)
    few, many = (
        nrs.Assembly([(leaf, at(rng.uniform(-50, 50, (n, 3))))], far=leaf, far_error=100.0) for n in (50, 200)
    )
    per_pose = (many.nbytes - many.far.nbytes - few.nbytes + few.far.nbytes) / 150
    assert per_pose < 256
    places = at(rng.uniform(-9_000, 9_000, (1_000, 3)))
    forest = nrs.Assembly([(many, places)], far=leaf, far_error=9_000.0)
    assert forest.nbytes < many.nbytes + forest.far.nbytes + 256 * 1_000
    assert len(forest) == 200_000


def wrong(poses, i, value):
    out = poses.copy()
    out[i] = value
    return out


def test_mistakes_name_argument_and_index(leaf, tree) -> None:
    poses = at([(0, 0, 0), (8, 0, 0), (16, 0, 0)])
    nan, singular = np.full((4, 4), np.nan), np.diag([1.0, 0.0, 1.0, 1.0])
    huge = np.diag([1e300, 1e300, 1e300, 1.0])
    for make, kind, message in [
        (lambda: nrs.Assembly([]), nrs.ArgumentError, r"^parts: expected one at least"),
        (lambda: nrs.Assembly(3), nrs.DtypeError, r"^parts: expected a sequence"),
        (lambda: nrs.Assembly([leaf]), nrs.DtypeError, r"^parts\[0\]: expected \(item, poses\)"),
        (
            lambda: nrs.Assembly([(leaf, poses), (3, poses)]),
            nrs.DtypeError,
            r"^parts\[1\]: expected a Nanite",
        ),
        (lambda: nrs.Assembly([(leaf, "no")]), nrs.DtypeError, r"^parts\[0\]: poses: expected"),
        (lambda: nrs.Assembly([(leaf, poses[:0])]), nrs.ArgumentError, r"^parts\[0\]: poses: expected one"),
        (lambda: nrs.Assembly([(leaf, np.eye(3))]), nrs.ArgumentError, r"^parts\[0\]: poses: expected shape"),
        (
            lambda: nrs.Assembly([(leaf, wrong(poses, 2, nan))]),
            nrs.ArgumentError,
            r"^parts\[0\]: poses\[2\]\[0, 0\] must be finite",
        ),
        (
            lambda: nrs.Assembly([(leaf, poses), (leaf, wrong(poses, 1, singular))]),
            nrs.ArgumentError,
            r"^parts\[1\]: poses\[1\]: the upper left",
        ),
        (lambda: nrs.Assembly([(tree, poses, nrs.Material())]), nrs.ArgumentError, r"^parts\[0\]: material"),
        (lambda: nrs.Assembly([(leaf, poses, 3)]), nrs.DtypeError, r"^parts\[0\]: material: expected"),
        (lambda: nrs.Assembly([(leaf, poses)], far_triangles=0), nrs.ArgumentError, r"^far_triangles"),
        (
            lambda: nrs.Assembly([(leaf, poses)], far_triangles=2),
            nrs.ArgumentError,
            r"^far_triangles: the co",
        ),
        (lambda: nrs.Assembly([(leaf, poses)], options=3), nrs.DtypeError, r"^options"),
        (lambda: nrs.Scene().add(tree, material=nrs.Material()), nrs.ArgumentError, r"^material: the parts"),
        (lambda: nrs.Scene().add(tree, pose=singular), nrs.ArgumentError, r"^pose"),
        (lambda: nrs.Scene().add_many(tree, wrong(poses, 1, nan)), nrs.ArgumentError, r"^poses\[1\]"),
        (lambda: nrs.Scene().add_many(leaf, wrong(poses, 1, singular)), nrs.ArgumentError, r"^poses\[1\]"),
        (lambda: nrs.Scene().add_many(3, poses), nrs.DtypeError, r"^item"),
    ]:
        with pytest.raises(kind, match=message):
            make()
    with pytest.raises(nrs.NaniteError):
        nrs.Assembly([(leaf, wrong(poses, 1, huge) * 1e8)])
    scene = nrs.Scene()
    with pytest.raises(nrs.ArgumentError):
        scene.add_many(leaf, wrong(poses, 2, nan))
    assert len(scene) == 0


def test_assemblies_are_nested_no_deeper_than_they_can_be_walked(leaf) -> None:
    far = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20))
    item = leaf
    for _ in range(32):
        item = nrs.Assembly([(item, np.eye(4))], far=far, far_error=0.0)
    with pytest.raises(nrs.ArgumentError, match=r"^parts: assemblies hold assemblies, 33 inside"):
        nrs.Assembly([(item, np.eye(4))], far=far, far_error=0.0)
    scene = world()
    scene.add(item)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        assert (renderer.render(scene, CAMERA, nrs.look_at((0, 0, 4), (0, 0, 0))).depth > 0).any()


def test_too_many_parts_are_refused_and_later_frames_drawn(leaf) -> None:
    item = leaf
    far = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20))
    for _ in range(3):  # 200 ** 3 leaves
        poses = at(np.stack([np.linspace(-1, 1, 200), np.zeros(200), np.zeros(200)], axis=1))
        item = nrs.Assembly([(item, poses)], far=far, far_error=0.5)
    scene = world()
    scene.add(item)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        with pytest.raises(nrs.MeshError, match="parts of assemblies"):
            renderer.render(scene, CAMERA, nrs.look_at((0, 0, 9), (0, 0, 0)), pixel_error=0)
        frame = renderer.render(scene, CAMERA, nrs.look_at((0, 0, 9), (0, 0, 0)), pixel_error=1_000)
        assert frame.stats.assemblies.far == 1
