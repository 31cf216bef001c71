"""What files say of surfaces holds in every shading, on both backends: transforms of textures, UV sets, unlit
materials, and factors times colours times textures."""

import json

import numpy as np
import pytest

import nanite_rs as nrs

BACKENDS = ("cpu", "gpu")
SHADINGS = ("pyrender", "gltf", "flat")
CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
CAMERA, POSE = nrs.OrthographicCamera(1.0, 1.0), nrs.look_at((0, 0, 3), (0, 0, 0))
QUARTERS = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]], np.uint8)
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)


def middles(frame: nrs.Frame) -> np.ndarray:
    """What is in the middle of each quarter of a picture of 32 pixels, linear."""
    return frame.linear[8:32:16, 8:32:16].clip(0.0, 1.0)


def shown(material: nrs.Material, shading: str, backend: str, *, ambient: float = 1.0, **arrays) -> nrs.Frame:
    scene = nrs.Scene(ambient_light=(ambient,) * 3, bg_color=(0, 0, 0))
    scene.add(nrs.NaniteMesh.from_arrays(CORNERS, FACES, **arrays), material=material)
    scene.add(nrs.DirectionalLight(color=(0.5, 1.0, 0.2), intensity=0.0 if ambient else 4.0), pose=POSE)
    with nrs.Renderer(32, 32, backend=backend) as renderer:
        return renderer.render(scene, CAMERA, POSE, shading=shading)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shading", SHADINGS)
@pytest.mark.parametrize(
    ("moved", "turned"),
    [
        ({"offset": (0.5, 0.0)}, QUARTERS[:, ::-1]),
        ({"offset": (0.0, 0.5)}, QUARTERS[::-1]),
        ({"scale": (2.0, 2.0), "offset": (0.25, 0.25)}, None),
        ({"rotation": np.pi / 2, "offset": (0.0, 1.0)}, np.rot90(QUARTERS, -1)),
        ({"uv_set": 1}, QUARTERS),
    ],
    ids=["right", "down", "scale", "turn", "set"],
)
def test_textures_lie_where_the_file_says(moved, turned, shading, backend) -> None:
    texture = nrs.Texture(QUARTERS, filter="nearest", mipmaps=None, **moved)
    material = nrs.Material(base_color=(1, 1, 1), metallic=0.0, base_color_texture=texture)
    uvs = [UV, UV] if "uv_set" not in moved else [UV[::-1] * 0.01, UV]
    found = middles(shown(material, shading, backend, uvs=uvs))
    if turned is None:  # a quarter holds a whole image: places half way between
        places = (np.array([[0.25, 0.75]]) * 2 + 0.25) % 1.0
        index = (places[0] * 2).astype(int)
        turned = QUARTERS[np.ix_(index, index)]
    assert np.array_equal(found > 0.5, turned > 127)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("shading", SHADINGS)
@pytest.mark.parametrize("ambient", [0.0, 1.0])
@pytest.mark.parametrize("textured", [False, True])
def test_unlit_is_the_product_whatever_the_light(textured, ambient, shading, backend) -> None:
    colors = np.array([[255, 128, 255, 255]] * 4, np.uint8)
    texture = nrs.Texture(np.full((2, 2, 3), 255, np.uint8)) if textured else None
    material = nrs.Material(
        base_color=(0.2, 0.4, 0.8),
        metallic=1.0,
        emissive=(1, 1, 1),
        unlit=True,
        base_color_texture=texture,
    )
    frame = shown(material, shading, backend, ambient=ambient, colors=colors, uvs=UV)
    expected = np.array([0.2, 0.4 * 128 / 255, 0.8])
    assert np.abs(middles(frame) - expected).max() < 2e-3
    assert (
        np.abs(frame.base_color[16, 16] - np.where(shading == "pyrender", (0.2, 0.4, 0.8), expected)).max()
        < 2e-3
    )
    if shading == "gltf":
        assert np.allclose(frame.shading_normal[16, 16], (0, 0, 1), atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_lit_and_unlit_parts_of_a_mesh_do_not_mix(backend) -> None:
    looks = [nrs.Material(base_color=(0, 1, 0), unlit=True), nrs.Material(base_color=(1, 0, 0), metallic=0.0)]
    mesh = nrs.NaniteMesh.from_arrays(CORNERS, FACES, face_materials=[0, 1])
    scene = nrs.Scene(bg_color=(0, 0, 0))
    scene.add(mesh, material=looks)
    scene.add(nrs.DirectionalLight(intensity=0.01), pose=POSE)
    with nrs.Renderer(32, 32, backend=backend) as renderer:
        linear = renderer.render(scene, CAMERA, POSE).linear
    assert np.allclose(linear[24, 24], (0, 1, 0), atol=1e-3)
    assert 0.0 < linear[8, 8, 0] < 0.01 > linear[8, 8, 1]


def gltf(tmp_path, material: dict, **extra):
    """A square of a material as a file."""
    import base64

    data = CORNERS.tobytes() + FACES.astype("<u4").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": list(range(1 + ("cameras" in extra)))}],
        "nodes": [{"mesh": 0}, {"camera": 0, "translation": [0, 0, 3]}][: 1 + ("cameras" in extra)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [material],
        "buffers": [{"byteLength": len(data), "uri": "data:;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 6, "type": "SCALAR"},
        ],
        **extra,
    }
    path = tmp_path / "square.gltf"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("shading", SHADINGS)
def test_unlit_files_come_back_from_exports(tmp_path, shading) -> None:
    look = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]}}
    look |= {"extensions": {"KHR_materials_unlit": {}}}
    path = gltf(tmp_path, look, extensionsUsed=["KHR_materials_unlit"])
    nrs.NaniteMesh.from_file(path).cut(error=0).export(tmp_path / "again.glb")
    for name in (path, tmp_path / "again.glb"):
        with nrs.Renderer(8, 8, backend="cpu") as renderer:
            frame = renderer.render(nrs.load_scene(name).scene, CAMERA, POSE, shading=shading)
        assert np.allclose(frame.linear[4, 4], (0.5, 0.25, 1.0), atol=1e-3)


# ------------------------------------------------------------------------------------------------------- cameras


@pytest.mark.parametrize("size", [(64, 64), (128, 64), (64, 128), (100, 60)])
@pytest.mark.parametrize(
    "lens",
    [
        {"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1, "aspectRatio": 1.7}},
        {"type": "orthographic", "orthographic": {"xmag": 3.0, "ymag": 2.0, "znear": 0.1, "zfar": 9.0}},
    ],
    ids=["perspective", "orthographic"],
)
def test_a_square_stays_a_square_in_pictures_of_any_aspect(tmp_path, lens, size) -> None:
    path = gltf(tmp_path, {}, cameras=[lens])
    scene, camera, pose = nrs.load_scene(path)
    with nrs.Renderer(*size, backend="cpu") as renderer:
        covered = renderer.render(scene, camera, pose, shading="flat").depth > 0
    high = covered.any(axis=1).sum()
    half = np.tan(0.5) * 3.0 if lens["type"] == "perspective" else 2.0
    assert abs(high - size[1] / half) <= 2
    assert abs(covered.any(axis=0).sum() - min(high, size[0])) <= 2
