"""Scenes: handles that go stale, instances that move, hide and leave, and many of them at once."""

import gc

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import camera, compare, picture, subjects, topology

SIZE = (320, 240)
LENS = nrs.PerspectiveCamera(yfov=0.8, znear=0.05)
POSE = camera.look_at(np.array([0.0, 1.0, 6.0]), np.zeros(3))


@pytest.fixture(scope="module")
def mesh():
    return subjects.built("small sphere")


@pytest.fixture(scope="module")
def renderer():
    with nrs.Renderer(*SIZE, backend="cpu") as r:
        yield r


def lit() -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0, 0, 0))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=POSE)
    return scene


def at(x: float, y: float = 0.0, z: float = 0.0, scale: float = 0.5) -> np.ndarray:
    pose = np.diag([scale, scale, scale, 1.0])
    pose[:3, 3] = x, y, z
    return pose


def shown(renderer, scene, **options) -> np.ndarray:
    return renderer.render(scene, LENS, POSE, **options).instance_id


def same(a, b) -> bool:
    return all(
        np.array_equal(getattr(a, n), getattr(b, n)) for n in ("color", "depth", "instance_id", "face_id")
    )


def test_every_use_of_a_removed_instance_raises(mesh, renderer) -> None:
    scene = lit()
    node = scene.add(mesh, pose=at(-1))
    other = scene.add(mesh, pose=at(1))
    scene.remove(node)
    for use in (
        lambda: node.pose,
        lambda: setattr(node, "pose", np.eye(4)),
        lambda: node.visible,
        lambda: setattr(node, "visible", False),
        lambda: setattr(node, "material", nrs.Material()),
        node.remove,
        lambda: scene.remove(node),
    ):
        with pytest.raises(nrs.StaleHandleError):
            use()
    assert "removed" in repr(node)
    # The next instance takes the slot, not the handle.
    again = scene.add(mesh, pose=at(-1))
    assert again.instance_id == node.instance_id
    with pytest.raises(nrs.StaleHandleError):
        _ = node.pose
    np.testing.assert_array_equal(again.pose, at(-1))
    assert set(np.unique(shown(renderer, scene))) == {-1, again.instance_id, other.instance_id}


def test_removed_lights_raise_and_their_light_goes(mesh, renderer) -> None:
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0, 0, 0))
    scene.add(mesh)
    dark = renderer.render(scene, LENS, POSE).color
    light = scene.add(nrs.PointLight(intensity=30.0), pose=POSE)
    assert renderer.render(scene, LENS, POSE).color.mean() > 1.5 * dark.mean()
    light.remove()
    np.testing.assert_array_equal(renderer.render(scene, LENS, POSE).color, dark)
    with pytest.raises(nrs.StaleHandleError):
        _ = light.pose
    with pytest.raises(nrs.StaleHandleError):
        light.remove()


def test_spots_light_their_cone(mesh, renderer) -> None:
    """What glTF says of the cone: all of a point light within the inner angle, nothing beyond the outer one."""
    poses = {"color": (1.0, 1.0, 1.0), "intensity": 30.0}
    scene = nrs.Scene(bg_color=(0, 0, 0))
    scene.add(mesh)
    node = scene.add(nrs.PointLight(**poses), pose=POSE)
    frame = renderer.render(scene, LENS, POSE, outputs=("color", "depth"))
    whole, depth = frame.color, frame.depth
    row, column = np.indices(depth.shape)
    height, width = depth.shape
    slope = np.tan(LENS.yfov / 2) * 2 / height
    angle = np.arctan(slope * np.hypot(column + 0.5 - width / 2, row + 0.5 - height / 2))
    covered = (depth > 0) & (whole.max(axis=2) > 0)
    inner, outer = np.quantile(angle[covered], [0.3, 0.6])
    node.remove()
    scene.add(nrs.SpotLight(**poses, innerConeAngle=inner, outerConeAngle=outer), pose=POSE)
    color = renderer.render(scene, LENS, POSE).color
    np.testing.assert_array_equal(color[covered & (angle < inner)], whole[covered & (angle < inner)])
    assert not color[covered & (angle > outer)].any()
    # Between them, the square of what is left of the cosine, before the power 1/2.2.
    rim = covered & (angle > inner) & (angle < outer)
    left = (np.cos(angle[rim]) - np.cos(outer)) / (np.cos(inner) - np.cos(outer))
    expected = 255 * ((whole[rim] / 255) ** 2.2 * left[:, None] ** 2) ** (1 / 2.2)
    assert rim.sum() > 100
    assert np.abs(expected - color[rim]).max() < 2


@pytest.mark.parametrize(
    ("angles", "name"),
    [
        ((0.2, 0.1), "innerConeAngle"),
        ((-0.1, 0.1), "innerConeAngle"),
        ((np.nan, 0.1), "innerConeAngle"),
        ((0.1, 1.6), "outerConeAngle"),
        ((0.0, 0.0), "outerConeAngle"),
        ((0.0, np.nan), "outerConeAngle"),
    ],
)
def test_cones_are_checked(angles, name) -> None:
    with pytest.raises(nrs.ArgumentError, match=name):
        nrs.SpotLight(innerConeAngle=angles[0], outerConeAngle=angles[1])


def test_a_node_of_another_scene_is_refused(mesh) -> None:
    a, b = lit(), lit()
    node = a.add(mesh)
    b.add(mesh)
    with pytest.raises(nrs.ArgumentError, match="scene"):
        b.remove(node)
    node.remove()


def test_hidden_moved_and_removed_instances_show_as_if_never_there(mesh, renderer) -> None:
    left, right = at(-1.2), at(1.2)
    plain = lit()
    plain.add(mesh, pose=left)
    expected = renderer.render(plain, LENS, POSE)

    scene = lit()
    scene.add(mesh, pose=left)
    node = scene.add(mesh, pose=right)
    assert len(np.unique(shown(renderer, scene))) == 3
    node.visible = False
    assert same(renderer.render(scene, LENS, POSE), expected)
    node.visible = True
    assert len(np.unique(shown(renderer, scene))) == 3
    node.pose = at(500.0)
    assert same(renderer.render(scene, LENS, POSE), expected)
    node.pose = right
    both = renderer.render(scene, LENS, POSE)
    node.remove()
    assert same(renderer.render(scene, LENS, POSE), expected)
    scene.add(mesh, pose=right)
    assert same(renderer.render(scene, LENS, POSE), both)


def test_a_mesh_that_is_gone_from_python_still_renders(renderer) -> None:
    scene = lit()
    scene.add(nrs.NaniteMesh.from_arrays(*subjects.cube(8), progress=False))
    before = renderer.render(scene, LENS, POSE)
    gc.collect()
    assert same(before, renderer.render(scene, LENS, POSE))


def test_frames_do_not_follow_later_edits(mesh, renderer) -> None:
    scene = lit()
    node = scene.add(mesh)
    frame = renderer.render(scene, LENS, POSE, outputs=())
    expected = renderer.render(scene, LENS, POSE)
    node.pose = at(0.7)
    node.material = nrs.Material(base_color=(1, 0, 0))
    assert same(frame, expected)
    node.remove()
    del node, scene
    gc.collect()
    assert (frame.normal[expected.depth > 0] != 0).any(axis=-1).all()


def test_occlusion_changes_nothing_but_the_cost(mesh, renderer) -> None:
    scene = lit()
    rng = np.random.default_rng(0)
    for _ in range(60):
        scene.add(mesh, pose=at(*rng.uniform(-1.5, 1.5, 2), rng.uniform(-6, 2), 0.4))
    for tau in (0.0, 1.0, 4.0):
        for _ in range(2):
            frame = renderer.render(scene, LENS, POSE, pixel_error=tau)
            assert same(frame, renderer.render(scene, LENS, POSE, pixel_error=tau, occlusion=False))


@pytest.mark.parametrize("z", [1e6, 6.4e6])
def test_far_from_the_origin_nothing_shakes(mesh, renderer, z: float) -> None:
    """The same scene moved by whole numbers, camera and all: the same picture, depth to a few float32 steps."""
    near, far = lit(), lit()
    shift = np.array([z, -2 * z, z / 2])
    near.add(mesh, pose=at(0.25, 0.125))
    moved, eye = at(0.25, 0.125), POSE.copy()
    moved[:3, 3] += shift
    eye[:3, 3] += shift
    far.add(mesh, pose=moved)
    a, b = renderer.render(near, LENS, POSE), renderer.render(far, LENS, eye)
    assert np.count_nonzero((a.depth > 0) ^ (b.depth > 0)) <= 4
    inside = compare.away_from_silhouettes(a.depth, 1 / 284) & (b.depth > 0)
    assert np.abs(a.depth - b.depth)[inside].max() < 1e-3
    assert compare.psnr(a.color, b.color, inside) > 45


@pytest.mark.parametrize("kind", ["turned", "mirrored", "sheared", "flattened"])
def test_instances_of_every_affine_pose_against_pyrender(kind: str, tmp_path) -> None:
    """pyrender draws the transformed vertices: its own instance transforms know no mirror or shear."""
    source = subjects.subject("small sphere")
    linear = {
        "turned": camera.look_at(np.array([1.0, 2, 3]), np.zeros(3))[:3, :3] * 0.8,
        "mirrored": np.diag([-0.8, 0.8, 0.8]),
        "sheared": np.array([[0.8, 0.5, 0], [0, 0.8, 0.3], [0, 0, 0.6]]),
        "flattened": np.diag([1.0, 0.05, 0.7]),
    }[kind]
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = linear, (0.2, -0.1, 0.3)
    vertices = source.vertices @ linear.T + pose[:3, 3]
    faces = source.faces if np.linalg.det(linear) > 0 else source.faces[:, ::-1]
    normals = topology.vertex_normals(source.vertices, source.faces) @ np.linalg.inv(linear)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    view = camera.framing(vertices, (0.3, 0.4, 1.0), width=640, height=480)
    light = picture.Light("directional", view.pose, 3.0)
    base = picture.Material()
    theirs, depth = picture.Picture(vertices, faces, normals, material=base, lights=(light,)).render(view)

    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0, 0, 0))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=view.pose)
    material = nrs.Material(base_color=base.base, metallic=base.metallic, roughness=base.roughness)
    mesh = nrs.NaniteMesh.from_arrays(
        source.vertices,
        source.faces,
        normals=topology.vertex_normals(source.vertices, source.faces),
        progress=False,
    )
    scene.add(mesh, pose=pose, material=material)
    lens = nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
    with nrs.Renderer(view.width, view.height, backend="cpu") as renderer:
        full = renderer.render(scene, lens, view.pose, pixel_error=0.0)
        cut = renderer.render(scene, lens, view.pose, pixel_error=1.0)
    assert np.count_nonzero((full.depth > 0) ^ (depth > 0)) <= 1e-4 * (depth > 0).sum() + 2
    assert compare.outside_by_more_than_a_pixel(cut.depth > 0, depth > 0) == 0
    with compare.evidence(tmp_path / f"{kind}.png", full.color, theirs):
        assert compare.psnr(full.color, theirs, compare.away_from_silhouettes(depth, 1 / view.focal)) >= 40


def test_vertex_colors_and_point_lights_against_pyrender(tmp_path) -> None:
    source = subjects.subject("sphere")
    normals = topology.vertex_normals(source.vertices, source.faces)
    unit = source.vertices / np.abs(source.vertices).max()
    colors = np.concatenate([unit * 127 + 128, np.full((len(unit), 1), 255.0)], axis=1).astype(np.uint8)
    view = camera.framing(source.used, (0.3, 0.4, 1.0), width=640, height=480)
    above = view.pose.copy()
    above[:3, 3] += (1.0, 2.0, 0.0)
    lights = (
        picture.Light("point", above, 40.0, (1.0, 0.8, 0.6)),
        picture.Light("directional", view.pose, 1.0, (0.3, 0.5, 1.0)),
    )
    base = picture.Material(metallic=0.7, roughness=0.3)
    shot = picture.Picture(
        source.vertices, source.faces, normals, colors=colors, material=base, lights=lights
    )
    theirs, depth = shot.render(view)

    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0, 0, 0))
    mesh = nrs.NaniteMesh.from_arrays(
        source.vertices, source.faces, normals=normals, colors=colors, progress=False
    )
    scene.add(mesh, material=nrs.Material(base_color=base.base, metallic=0.7, roughness=0.3))
    scene.add(nrs.PointLight(color=(1.0, 0.8, 0.6), intensity=40.0), pose=above)
    scene.add(nrs.DirectionalLight(color=(0.3, 0.5, 1.0), intensity=1.0), pose=view.pose)
    with nrs.Renderer(view.width, view.height, backend="cpu") as renderer:
        lens = nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
        ours = renderer.render(scene, lens, view.pose, pixel_error=0.0).color
    with compare.evidence(tmp_path / "colors.png", ours, theirs):
        assert compare.psnr(ours, theirs, compare.away_from_silhouettes(depth, 1 / view.focal)) >= 40


def test_arrays_of_a_frame_are_owned_contiguous_and_writable(mesh, renderer) -> None:
    scene = lit()
    scene.add(mesh)
    frame = renderer.render(scene, LENS, POSE)
    kinds = {"color": np.uint8, "depth": np.float32, "normal": np.float32, "instance_id": np.int32}
    for name, dtype in kinds.items():
        array = getattr(frame, name)
        assert array.shape[:2] == (SIZE[1], SIZE[0])
        assert array.dtype == dtype
        assert array.flags.c_contiguous
        assert array.flags.writeable
    kept = frame.color.copy()
    renderer.render(nrs.Scene(bg_color=(1, 0, 1)), LENS, POSE)
    np.testing.assert_array_equal(frame.color, kept)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pose", np.full((4, 4), np.nan)),
        ("pose", np.eye(3)),
        ("pose", np.diag([1.0, 1, 0, 1])),
        ("pose", np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1.0]])),
        ("pixel_error", -1.0),
        ("pixel_error", float("nan")),
        ("scene", "scene"),
        ("camera", 0.8),
    ],
    ids=str,
)
def test_wrong_render_arguments_are_named(mesh, renderer, name: str, value) -> None:
    scene = lit()
    scene.add(mesh)
    arguments = {"scene": scene, "camera": LENS, "pose": POSE, "pixel_error": 1.0, name: value}
    with pytest.raises(nrs.NaniteError, match=name):
        renderer.render(**arguments)


@pytest.mark.parametrize("pose", [np.zeros((4, 4)), np.full((4, 4), np.inf), np.eye(3), "pose"], ids=str)
def test_wrong_poses_of_instances_are_named(mesh, pose) -> None:
    scene = lit()
    with pytest.raises(nrs.NaniteError, match="pose"):
        scene.add(mesh, pose=pose)
    assert len(scene) == 0
