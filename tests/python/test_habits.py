"""Habits from elsewhere: pictures as pyrender's, RGBA and depth as files, lights that are switched off, creases."""

import warnings

import numpy as np
import PIL.Image
import pytest
import trimesh

import nanite_rs as nrs
from oracles import picture
from oracles.compare import psnr

POSE, LAMP = nrs.look_at((1, 1, 3), (0, 0, 0)), nrs.look_at((2, 2, 2), (0, 0, 0))
CAMERA = nrs.PerspectiveCamera(yfov=0.8)


def bumpy() -> trimesh.Trimesh:
    ball = trimesh.creation.icosphere(subdivisions=4)
    x, y, _ = ball.vertices.T
    return trimesh.Trimesh(ball.vertices * (1 + 0.1 * np.sin(5 * x) * np.sin(4 * y))[:, None], ball.faces)


def painted() -> trimesh.Trimesh:
    mesh = bumpy()
    mesh.visual.vertex_colors = (np.abs(mesh.vertices) * 255).clip(0, 255).astype(np.uint8)
    return mesh


LIGHTS = {
    "none": [],
    "directional": [("DirectionalLight", {}, POSE)],
    "sun": [("DirectionalLight", {"color": np.array([1.0, 0.9, 0.8]), "intensity": 3.0}, LAMP)],
    "point": [("PointLight", {"intensity": 10.0}, LAMP)],
    "spot": [("SpotLight", {"intensity": 8.0}, LAMP), ("PointLight", {}, POSE)],
}


@pytest.mark.parametrize("ambient", [None, (0.2, 0.2, 0.2)])
@pytest.mark.parametrize("lights", LIGHTS.values(), ids=LIGHTS)
@pytest.mark.parametrize("make", [bumpy, painted, trimesh.creation.box])
def test_scenes_made_by_hand_look_as_in_pyrender(make, lights, ambient) -> None:
    pyrender = picture.import_pyrender()
    kinds = {} if ambient is None else {"ambient_light": ambient}
    theirs, ours = pyrender.Scene(**kinds), nrs.Scene(**kinds)
    theirs.add(pyrender.Mesh.from_trimesh(make()))
    ours.add(nrs.NaniteMesh.from_trimesh(make()))
    for kind, parameters, pose in lights:
        theirs.add(getattr(pyrender, kind)(**parameters), pose=pose)
        ours.add(getattr(nrs, kind)(**parameters), pose=pose)
    theirs.add(pyrender.PerspectiveCamera(yfov=0.8), pose=POSE)
    renderer = pyrender.OffscreenRenderer(160, 120)
    try:
        expected, _ = renderer.render(theirs)
    finally:
        renderer.delete()
    with nrs.Renderer(160, 120) as renderer, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there is no light
        found = renderer.render(ours, CAMERA, POSE, pixel_error=0).color
    assert psnr(expected, found) > 50


# ------------------------------------------------------------------------------------------------------- lights


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
def test_lights_are_switched_off_and_on(backend) -> None:
    scene = nrs.Scene()
    scene.add(nrs.NaniteMesh.from_trimesh(bumpy()))
    sun = scene.add(nrs.DirectionalLight(intensity=3.0), pose=LAMP)
    lamp = scene.add(nrs.PointLight(intensity=9.0), pose=POSE)
    alone = nrs.Scene()
    alone.add(scene.instances[0].mesh)
    alone.add(nrs.DirectionalLight(intensity=3.0), pose=LAMP)
    with nrs.Renderer(64, 48, backend=backend) as renderer:
        both = renderer.render(scene, CAMERA, POSE).color
        lamp.visible = False
        one = renderer.render(scene, CAMERA, POSE).color
        expected = renderer.render(alone, CAMERA, POSE).color
        lamp.pose, lamp.light = POSE, nrs.PointLight(intensity=9.0)  # stays off
        assert not lamp.visible
        assert np.array_equal(renderer.render(scene, CAMERA, POSE).color, one)
        lamp.visible = True
        assert np.array_equal(renderer.render(scene, CAMERA, POSE).color, both)
        sun.visible = lamp.visible = False
        with pytest.warns(nrs.UsageWarning, match="has no light"):
            _ = renderer.render(scene, CAMERA, POSE).color
    assert np.array_equal(one, expected)
    assert not np.array_equal(one, both)
    assert repr(lamp).endswith("off>")


def test_lights_are_listed_and_cleared() -> None:
    scene = nrs.Scene(ambient_light=(0.1, 0.2, 0.3), bg_color=(0, 0, 1))
    node = scene.add(nrs.NaniteMesh.from_trimesh(trimesh.creation.box()))
    first, second = scene.add(nrs.PointLight()), scene.add(nrs.DirectionalLight())
    assert scene.lights == [first, second]
    assert [type(one.light) for one in scene.lights] == [nrs.PointLight, nrs.DirectionalLight]
    scene.lights[0].light = nrs.PointLight(intensity=5.0)
    assert first.light.intensity == 5.0
    first.remove()
    assert scene.lights == [second]
    scene.clear()
    assert (len(scene), scene.lights, scene.instances) == (0, [], [])
    assert np.allclose(scene.ambient_light, (0.1, 0.2, 0.3))
    assert tuple(scene.bg_color) == (0.0, 0.0, 1.0)
    for use in (lambda: node.pose, lambda: second.pose, lambda: second.light, lambda: second.visible):
        with pytest.raises(nrs.StaleHandleError):
            use()
    scene.add(nrs.PointLight())
    assert len(scene.lights) == 1


# ---------------------------------------------------------------------------------------------- files of pictures


def scene_of(**kinds) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.6, 0.5, 0.4), **kinds)
    scene.add(nrs.NaniteMesh.from_trimesh(bumpy()), material=nrs.Material(base_color=(0.9, 0.5, 0.2)))
    return scene


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("samples", [1, 4, 16])
def test_layers_laid_over_a_background_are_the_picture(samples, backend) -> None:
    """Porter and Duff's "over", in linear light, of any background gives the picture with that background."""
    with nrs.Renderer(64, 48, backend=backend) as renderer:
        frames = [
            renderer.render(scene_of(bg_color=color), CAMERA, POSE, samples=samples, transfer="linear")
            for color in ((1, 1, 1), (0, 0.2, 1))
        ]
    rgba = frames[0].rgba
    assert rgba.shape == (48, 64, 4)
    assert rgba.dtype == np.uint8
    assert np.array_equal(rgba, frames[1].rgba)
    alpha = rgba[..., 3:] / 255.0
    for frame, color in zip(frames, ((1, 1, 1), (0, 0.2, 1)), strict=True):
        over = alpha * rgba[..., :3] / 255.0 + (1 - alpha) * np.array(color)
        assert np.abs(over - frame.color / 255.0).max() < 2.1 / 255
    assert np.array_equal(rgba[..., 3] > 0, rgba[..., :3].any(axis=-1))
    whole = rgba[..., 3] == 255
    assert np.abs(rgba[whole][:, :3].astype(int) - frames[0].color[whole]).max() <= (samples > 1)
    assert bool(((rgba[..., 3] > 0) & ~whole).any()) == (samples > 1)


def test_an_environment_behind_is_left_out() -> None:
    scene = scene_of()
    scene.environment = nrs.Environment(np.ones((8, 16, 3), np.float32), background=True)
    with nrs.Renderer(64, 48) as renderer:
        frame = renderer.render(scene, CAMERA, POSE, shading="gltf")
    assert np.array_equal(frame.rgba[..., 3] == 255, frame.depth > 0)


def test_rgba_files(tmp_path) -> None:
    with nrs.Renderer(64, 48) as renderer:
        frame = renderer.render(scene_of(), CAMERA, POSE, samples=4)
        alone = renderer.render(scene_of(), CAMERA, POSE, depth_only=True)
    frame.save(tmp_path / "a.png", alpha=True)
    image = PIL.Image.open(tmp_path / "a.png")
    assert image.mode == "RGBA"
    assert np.array_equal(np.asarray(image), frame.rgba)
    with pytest.raises(nrs.ArgumentError, match="alpha: goes with the shaded picture"):
        frame.save(tmp_path / "b.png", alpha=True, view="clusters")
    with pytest.raises(nrs.ArgumentError, match="depth_only"):
        _ = alone.rgba
    pytest.importorskip("OpenImageIO")
    frame.save(tmp_path / "deep.png", alpha=True, bits=16)
    deep = nrs.Image.open(tmp_path / "deep.png").pixels
    assert deep.dtype == np.uint16
    assert np.abs(deep / 65535 - frame.rgba / 255).max() < 0.6 / 255
    frame.save(tmp_path / "a.exr", alpha=True, outputs=["linear"])
    layer = nrs.Image.open(tmp_path / "a.exr").pixels
    assert np.allclose(layer[..., 3], frame.rgba[..., 3] / 255, atol=0.003)
    with pytest.raises(nrs.ArgumentError, match='goes with outputs that have "linear"'):
        frame.save(tmp_path / "b.exr", alpha=True, outputs=["depth"])


@pytest.mark.parametrize("depth_only", [True, False])
def test_depth_as_whole_numbers(tmp_path, depth_only) -> None:
    with nrs.Renderer(64, 48) as renderer:
        frame = renderer.render(scene_of(), CAMERA, POSE, depth_only=depth_only)
    for unit in (0.001, 0.0002, 1.0):
        frame.save_depth(tmp_path / "d.png", unit=unit)
        image = PIL.Image.open(tmp_path / "d.png")
        steps = np.asarray(image)
        assert steps.dtype == np.uint16
        assert image.text["nanite_rs:depth_unit"] == repr(unit)
        assert np.abs(steps * unit - frame.depth).max() <= 0.5001 * unit
        assert np.array_equal(steps > 0, frame.depth > 0)
    (tmp_path / "d.png").unlink()
    for unit, better in ((1e-6, r"unit=0\.0001"), (50.0, r"unit=0\.0001")):
        with pytest.raises(
            nrs.ArgumentError, match=rf"unit: depths from .* do not fit; they do with {better}"
        ):
            frame.save_depth(tmp_path / "d.png", unit=unit)
        assert not (tmp_path / "d.png").exists()
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(nrs.ArgumentError, match="unit: must be positive"):
            frame.save_depth(tmp_path / "d.png", unit=bad)
    with pytest.raises(nrs.FormatError):
        frame.save_depth(tmp_path / "d.exr")


# ------------------------------------------------------------------------------------------------------ creases


def turning(cut: nrs.Cut) -> np.ndarray:
    """The angle of each corner's normal to that of its face, degrees."""
    a, b, c = (cut.vertices[cut.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a).astype(np.float64)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cos = np.einsum("fkc,fc->fk", cut.normals[cut.faces], normal)
    return np.degrees(np.arccos(cos.clip(-1, 1)))


@pytest.fixture(scope="module")
def part() -> trimesh.Trimesh:
    """A cylinder of 64 sides with a fine wall: smooth around, sharp at both ends."""
    return trimesh.creation.cylinder(radius=1.0, height=2.0, sections=64).subdivide().subdivide()


def test_edges_of_parts_stay_sharp(part) -> None:
    smooth = nrs.NaniteMesh.from_arrays(part.vertices, part.faces)
    sharp = nrs.NaniteMesh.from_arrays(part.vertices, part.faces, options=nrs.BuildOptions(crease_angle=30.0))
    flat = nrs.NaniteMesh.from_arrays(part.vertices, part.faces, options=nrs.BuildOptions(crease_angle=0.0))
    assert turning(smooth.cut(error=0.0)).max() > 40
    assert turning(sharp.cut(error=0.0)).max() < 360 / 64
    assert turning(flat.cut(error=0.0)).max() < 0.1
    # Around the wall it is as smooth as ever: normals are those of a cylinder.
    cut = sharp.cut(error=0.0)
    wall = np.abs(cut.normals[:, 2]) < 0.5
    out = cut.vertices[wall, :2] / np.linalg.norm(cut.vertices[wall, :2], axis=1, keepdims=True)
    assert np.einsum("vc,vc->v", out, cut.normals[wall, :2]).min() > 0.998
    sharp.check()


@pytest.mark.parametrize("faces", [2000, 1000, 500])
def test_coarser_levels_have_the_creases(part, faces) -> None:
    options = nrs.BuildOptions(crease_angle=30.0)
    cut = nrs.NaniteMesh.from_arrays(part.vertices, part.faces, options=options).cut(target_faces=faces)
    assert np.quantile(turning(cut), 0.99) < 15
    assert turning(cut).max() < 40


def test_stl_files_have_them_unless_told_otherwise(tmp_path, part) -> None:
    part.export(tmp_path / "a.stl")
    part.export(tmp_path / "a.ply")
    largest = {
        (name, angle): turning(
            nrs.NaniteMesh.from_file(tmp_path / name, crease_angle=angle).cut(error=0.0)
        ).max()
        for name, angle in (("a.stl", None), ("a.stl", 180.0), ("a.ply", None), ("a.ply", 30.0))
    }
    assert largest["a.stl", None] < 10 > largest["a.ply", 30.0]
    assert largest["a.stl", 180.0] > 40 < largest["a.ply", None]
    mesh = nrs.load_scene(tmp_path / "a.stl").scene.instances[0].mesh
    assert turning(mesh.cut(error=0.0)).max() < 10
    own = nrs.BuildOptions(crease_angle=180.0)
    mesh = nrs.NaniteMesh.from_file(tmp_path / "a.stl", options=own)
    assert turning(mesh.cut(error=0.0)).max() > 40


def test_given_normals_and_seams_stay(part) -> None:
    options = nrs.BuildOptions(crease_angle=0.0)
    normals = np.tile([0.0, 0.0, 1.0], (len(part.vertices), 1))
    cut = nrs.NaniteMesh.from_arrays(part.vertices, part.faces, normals=normals, options=options).cut(error=0)
    assert np.allclose(cut.normals, (0, 0, 1), atol=1e-6)
    uv = part.vertices[:, :2].astype(np.float32)
    cut = nrs.NaniteMesh.from_arrays(part.vertices, part.faces, uvs=uv, options=options).cut(error=0)
    assert np.allclose(cut.uvs[0], cut.vertices[:, :2], atol=1e-6)
    assert turning(cut).max() < 0.1
    for bad in (-1.0, 181.0, float("nan")):
        with pytest.raises(nrs.ArgumentError, match="crease_angle: must be between 0 and 180"):
            nrs.BuildOptions(crease_angle=bad)
