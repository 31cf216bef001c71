"""glTF files as descriptions: against trimesh's reading, and generated ones with whatever the format allows."""

from __future__ import annotations

import base64
import errno
import gzip
import io
import json
import sys
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image as Pillow

import nanite_rs as nrs
from nanite_rs.assets import read_asset
from oracles import data
from oracles.documents import QUAD, QUAD_FACES, QUAD_UV, Document, png

if TYPE_CHECKING:
    from pathlib import Path

RNG = np.random.default_rng(5)
PIXELS = RNG.integers(0, 256, (4, 8, 4), dtype=np.uint8)


def parts_of(path: Path, **options):
    asset = read_asset(path, **options)
    return asset, [part for mesh in asset.meshes for part in mesh]


def only(document: Document, tmp_path: Path):
    """The one part of a document."""
    _, parts = parts_of(document.save(tmp_path / "a.glb"))
    assert len(parts) == 1
    return parts[0]


# -------------------------------------------------------------------------------------- beside trimesh's reading

MODELS = [
    name
    for name in data.model_names("gltf") + data.model_names("cad")
    if name.startswith("gltf/")
    or name in ("cad/japanese_bridge_garden", "cad/occlusion_room", "cad/zdm2_level")
]
PACKED = ("lamborghini", "japanese_bridge")


def file_of(name: str) -> Path:
    folder, _, asset = name.partition("/")
    found = [
        path
        for path in data.folder_models(folder)
        if path.parent.name == asset and path.suffix in (".glb", ".gltf")
    ]
    if not found:
        pytest.skip(f"real mesh is absent: {name}")
    return found[0]


def by_trimesh(path: Path) -> trimesh.Scene:
    if not any(part in str(path) for part in PACKED):
        return trimesh.load_scene(path, process=False)
    raw = data._without_meshopt(path.read_bytes())
    return trimesh.load_scene(io.BytesIO(raw), file_type="glb", process=False)


def sorted_rows(rows: np.ndarray) -> np.ndarray:
    rows = np.round(rows, 4)
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("name", MODELS)
def test_triangles_and_places_are_trimeshs(name) -> None:
    path = file_of(name)
    scene, asset = by_trimesh(path), read_asset(path)
    theirs, ours = [], []
    for node in scene.graph.nodes_geometry:
        pose, key = scene.graph[node]
        mesh = scene.geometry[key]
        theirs.append(trimesh.transform_points(mesh.vertices, pose)[mesh.faces].reshape(-1, 9))
    for _, number, pose in asset.placed:
        for part in asset.meshes[number]:
            points = trimesh.transform_points(part.source.vertices, pose)
            ours.append(points[part.source.faces].reshape(-1, 9))
    assert np.allclose(sorted_rows(np.concatenate(ours)), sorted_rows(np.concatenate(theirs)), atol=2e-4)


SLOTS = {
    "base_color_texture": "baseColorTexture",
    "metallic_roughness_texture": "metallicRoughnessTexture",
    "normal_texture": "normalTexture",
    "occlusion_texture": "occlusionTexture",
    "emissive_texture": "emissiveTexture",
}


@pytest.mark.parametrize("name", MODELS)
def test_uvs_textures_and_factors_are_trimeshs(name) -> None:
    path = file_of(name)
    scene, asset = by_trimesh(path), read_asset(path)
    surfaces: dict[bytes, list[trimesh.Trimesh]] = {}
    for mesh in scene.geometry.values():
        surfaces.setdefault(np.float32(mesh.vertices).tobytes() + mesh.faces.tobytes(), []).append(mesh)
    parts = [part for mesh in asset.meshes for part in mesh]
    compared = 0
    for part in parts:
        source = part.source
        same = surfaces.get(source.vertices.tobytes() + np.asarray(source.faces).tobytes(), [])
        compared += bool(same)
        if len(same) != 1:  # one and the same shape in several looks
            continue
        visual = same[0].visual
        if source.uvs and getattr(visual, "uv", None) is not None:
            assert np.allclose(source.uvs[0], visual.uv, atol=1e-6)
        found = getattr(visual, "material", None)
        if isinstance(found, trimesh.visual.material.PBRMaterial):
            same_look(part, found, glossy="japanese" in name)
    assert compared == len(parts)


def same_look(part, found: trimesh.visual.material.PBRMaterial, *, glossy: bool) -> None:
    material = part.material
    for own, other in SLOTS.items():
        texture, image = getattr(material, own), getattr(found, other)
        if image is None or not part.source.uvs:
            assert texture is None
            continue
        pixels = np.asarray(image if image.mode != "P" else image.convert("RGB"))
        stored = texture.image.pixels
        stored = stored >> 8 if stored.dtype == np.uint16 else stored  # which is what Pillow makes of them
        assert np.array_equal(stored, pixels.reshape(stored.shape))
    assert material.double_sided == bool(found.doubleSided)
    assert material.alpha_mode == (found.alphaMode or "OPAQUE").lower()
    if not glossy:
        assert material.metallic == pytest.approx(
            1.0 if found.metallicFactor is None else found.metallicFactor
        )
        assert material.roughness == pytest.approx(
            1.0 if found.roughnessFactor is None else found.roughnessFactor
        )


# ------------------------------------------------------------------------------------------------------ accessors


@pytest.mark.parametrize("stride", [0, 12, 16, 40])
@pytest.mark.parametrize("before", [0, 8])
def test_strides_and_offsets(tmp_path, stride, before) -> None:
    document = Document()
    places = document.accessor(QUAD, stride=stride, before=before)
    document.mesh({"attributes": {"POSITION": places}, "indices": document.accessor(QUAD_FACES)})
    assert np.array_equal(only(document, tmp_path).source.vertices, QUAD)


def test_interleaved_attributes(tmp_path) -> None:
    document = Document()
    rows = np.hstack([QUAD, QUAD_UV]).astype(np.float32)
    view = document.view(rows.tobytes(), byteStride=20)
    attributes = {
        "POSITION": document.row("accessors", bufferView=view, componentType=5126, count=4, type="VEC3"),
        "TEXCOORD_0": document.row(
            "accessors", bufferView=view, byteOffset=12, componentType=5126, count=4, type="VEC2"
        ),
    }
    document.mesh({"attributes": attributes, "indices": document.accessor(QUAD_FACES)})
    source = only(document, tmp_path).source
    assert np.array_equal(source.vertices, QUAD)
    assert np.array_equal(source.uvs[0], [[0, 0], [1, 0], [1, 1], [0, 1]])


@pytest.mark.parametrize("index", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize("stored", [True, False])
def test_sparse_accessors(tmp_path, index, stored) -> None:
    document = Document()
    before = RNG.random((4, 3)).astype(np.float32) if stored else np.zeros((4, 3), np.float32)
    changed = np.array([1, 3], index)
    places = document.accessor(before, sparse=(changed, QUAD[[1, 3]] + 5.0), stored=stored)
    faces = np.array([0, 1, 3], np.uint16)
    document.mesh({"attributes": {"POSITION": places}, "indices": document.accessor(faces)})
    expected = before.copy()
    expected[[1, 3]] = QUAD[[1, 3]] + 5.0
    assert np.array_equal(only(document, tmp_path).source.vertices, expected)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16])
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("sparse", [False, True])
def test_quantized_attributes(tmp_path, dtype, normalized, sparse) -> None:
    """KHR_mesh_quantization: f = max(c / (2^(b-1) - 1), -1) for signed and c / (2^b - 1) for unsigned numbers."""
    most, least = np.iinfo(dtype).max, np.iinfo(dtype).min
    places = np.array([[0, 0, 0], [most, 0, 3], [most, most, least], [0, most, 7]], dtype)
    uvs = np.array([[0, most], [most, most], [most, 0], [0, 0]], dtype)
    document = Document()
    document.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    some = (np.array([2], np.uint8), places[[2]]) if sparse else None
    first = np.where(np.arange(4)[:, None] == 2, 9, places).astype(dtype) if sparse else places
    attributes = {
        "POSITION": document.accessor(first, normalized=normalized, stride=8, sparse=some),
        "TEXCOORD_0": document.accessor(uvs, normalized=normalized, stride=4),
    }
    document.mesh({"attributes": attributes, "indices": document.accessor(QUAD_FACES)})
    source = only(document, tmp_path).source
    scale = float(most) if normalized else 1.0
    assert np.allclose(source.vertices, np.maximum(places / scale, -1.0 if normalized else least), rtol=1e-6)
    assert np.allclose(
        source.uvs[0], np.stack([uvs[:, 0] / scale, 1.0 - uvs[:, 1] / scale], axis=1), rtol=1e-6
    )
    assert source.vertices.dtype == source.uvs[0].dtype == np.float32


@pytest.mark.parametrize("mode", [4, 5, 6])
@pytest.mark.parametrize("indexed", [False, True])
def test_lists_strips_and_fans(tmp_path, mode, indexed) -> None:
    around = np.linspace(0.0, 5.0, 6)
    if mode == 5:
        points = np.array([[x // 2, x % 2, 0] for x in range(6)], np.float32)[:, [1, 0, 2]]
        expected = [[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]]
    else:
        points = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1).astype(np.float32)
        expected = [[0, 1, 2], [3, 4, 5]] if mode == 4 else [[0, k, k + 1] for k in range(1, 5)]
    document = Document()
    primitive = {"attributes": {"POSITION": document.accessor(points)}, "mode": mode}
    if indexed:
        primitive["indices"] = document.accessor(np.arange(6, dtype=np.uint8))
    document.mesh(primitive)
    source = only(document, tmp_path).source

    def turned(face):
        return min(tuple(np.roll(face, k)) for k in range(3))

    assert [turned(f) for f in source.faces.tolist()] == [turned(f) for f in expected]


def test_without_normals_faces_are_flat_and_with_them_smooth(tmp_path) -> None:
    document = Document()
    document.mesh(document.quad(), name="flat")
    smooth = document.quad()
    smooth["attributes"]["NORMAL"] = document.accessor(np.tile(np.float32([0, 0, 1]), (4, 1)))
    document.mesh(smooth)
    _, (flat, smooth) = parts_of(document.save(tmp_path / "a.glb"))
    assert flat.source.normals is None
    assert not flat.material.smooth
    assert np.array_equal(smooth.source.normals, [[0, 0, 1]] * 4)
    assert smooth.material.smooth


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("width", [3, 4])
def test_vertex_colors(tmp_path, dtype, width) -> None:
    levels = np.array([[0, 51, 102, 153], [255, 204, 0, 255], [1, 2, 3, 4], [5, 6, 7, 8]], np.uint8)[
        :, :width
    ]
    stored = levels if dtype is np.uint8 else levels.astype(np.uint16) * 257
    stored = levels.astype(np.float32) / 255 if dtype is np.float32 else stored
    document = Document()
    primitive = document.quad()
    primitive["attributes"]["COLOR_0"] = document.accessor(
        stored, normalized=dtype is not np.float32, stride={1: 4, 2: 8, 4: 16}[stored.itemsize]
    )
    document.mesh(primitive)
    found = only(document, tmp_path).source.colors
    assert np.array_equal(found[:, :width], levels)
    assert width == 4 or (found[:, 3] == 255).all()


def test_uv_sets_and_custom_attributes(tmp_path) -> None:
    document = Document()
    primitive = document.quad()
    other = (QUAD_UV * 0.25).astype(np.float32)
    primitive["attributes"]["TEXCOORD_1"] = document.accessor(other)
    heat = np.array([1.0, 2.0, 3.0, 4.0], np.float32)
    primitive["attributes"]["_HEAT"] = document.accessor(heat)
    document.mesh(primitive)
    source = only(document, tmp_path).source
    assert np.array_equal(source.uvs[1], np.stack([other[:, 0], 1.0 - other[:, 1]], axis=1))
    assert np.array_equal(source.channels["_HEAT"], heat)


# ---------------------------------------------------------------------------------------------------------- nodes


def test_nodes_have_their_transforms_and_share_meshes(tmp_path) -> None:
    document = Document()
    leaf = document.mesh(document.quad(), name="leaf", translation=[1, 2, 3], scale=[1, 1, -2])
    turn = [0.0, 0.0, np.sin(0.3), np.cos(0.3)]
    root = document.row("nodes", name="root", rotation=turn, scale=[2, 2, 2], children=[leaf])
    matrix = trimesh.transformations.random_rotation_matrix()
    matrix[:3, 3] = 4, 5, 6
    again = document.row("nodes", mesh=0, name="leaf", matrix=matrix.T.reshape(-1).tolist())
    document.row("nodes", mesh=0, name="not in the scene")
    document.row("scenes", nodes=[])
    document.row("scenes", nodes=[root, again])
    document.json["scene"] = 1
    asset = read_asset(document.save(tmp_path / "a.glb"))
    assert len(asset.meshes) == 1
    assert [name for name, _, _ in asset.placed] == ["leaf", "leaf_1"]
    spin = trimesh.transformations.rotation_matrix(0.6, [0, 0, 1])
    inner = np.diag([1.0, 1.0, -2.0, 1.0])
    inner[:3, 3] = 1, 2, 3
    assert np.allclose(asset.placed[0][2], spin @ np.diag([2, 2, 2, 1]) @ inner)
    assert np.allclose(asset.placed[1][2], matrix)


def test_primitives_that_differ_in_material_alone_share_their_arrays(tmp_path) -> None:
    document = Document()
    for color in ([1, 0, 0, 1], [0, 1, 0, 1]):
        document.row("materials", pbrMetallicRoughness={"baseColorFactor": color})
    quad = document.quad()
    document.mesh({**quad, "material": 0}, {**quad, "material": 1})
    document.mesh({**quad, "material": 1})
    _, parts = parts_of(document.save(tmp_path / "a.glb"))
    assert len(parts) == 3
    assert len({id(part.source) for part in parts}) == 1
    assert [part.material.base_color for part in parts] == [(1, 0, 0), (0, 1, 0), (0, 1, 0)]


def test_instances_on_the_gpu(tmp_path) -> None:
    document = Document()
    places = RNG.random((5, 3)).astype(np.float32)
    sizes = RNG.random((5, 3)).astype(np.float32) + 1.0
    attributes = {"TRANSLATION": document.accessor(places), "SCALE": document.accessor(sizes)}
    document.mesh(
        document.quad(),
        translation=[1, 0, 0],
        extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}},
    )
    document.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    asset = read_asset(document.save(tmp_path / "a.glb"))
    assert len(asset.placed) == 5
    for (_, _, pose), place, size in zip(asset.placed, places, sizes, strict=True):
        assert np.allclose(pose[:3, 3], place + np.array([1, 0, 0]))
        assert np.allclose(pose[:3, :3], np.diag(size))


def test_deep_trees_are_read(tmp_path) -> None:
    document = Document()
    leaf = document.mesh(document.quad())
    for _ in range(20_000):
        leaf = document.row("nodes", children=[leaf], translation=[0, 0, 1])
    document.row("scenes", nodes=[leaf])
    asset = read_asset(document.save(tmp_path / "a.glb"))
    assert asset.placed[0][2][2, 3] == 20_000


# ------------------------------------------------------------------------------------------- materials and textures


def test_factors(tmp_path) -> None:
    document = Document()
    document.row(
        "materials",
        name="all",
        pbrMetallicRoughness={
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
            "metallicFactor": 0.5,
            "roughnessFactor": 0.6,
        },
        emissiveFactor=[0.7, 0.8, 0.9],
        alphaMode="MASK",
        alphaCutoff=0.25,
        doubleSided=True,
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 10.0}},
    )
    document.row("materials")
    quad = document.quad()
    document.mesh({**quad, "material": 0}, {**quad, "material": 1}, quad)
    _, (first, second, third) = parts_of(document.save(tmp_path / "a.glb"))
    material = first.material
    assert material.base_color == pytest.approx((0.1, 0.2, 0.3, 0.4))
    assert (material.metallic, material.roughness) == (0.5, 0.6)
    assert material.emissive == pytest.approx((7.0, 8.0, 9.0))
    assert (material.alpha_mode, material.alpha_cutoff, material.double_sided) == ("mask", 0.25, True)
    for part in (second, third):  # what glTF says where nothing is said
        assert part.material == nrs.Material((1, 1, 1), 1.0, 1.0, smooth=False)


SAMPLERS = [
    (None, None, "linear", "linear"),
    (9728, 9728, "nearest", None),
    (9729, 9729, "linear", None),
    (9729, 9984, "linear", "nearest"),
    (9729, 9985, "linear", "nearest"),
    (9728, 9986, "nearest", "linear"),
    (9729, 9987, "linear", "linear"),
    (None, 9986, "nearest", "linear"),
]


@pytest.mark.parametrize(("most", "least", "between", "mipmaps"), SAMPLERS)
@pytest.mark.parametrize("wrap_s", [None, 10497, 33648, 33071])
@pytest.mark.parametrize("wrap_t", [None, 33648])
def test_samplers(tmp_path, most, least, between, mipmaps, wrap_s, wrap_t) -> None:
    values = {"magFilter": most, "minFilter": least, "wrapS": wrap_s, "wrapT": wrap_t}
    document = Document()
    sampler = document.row("samplers", **{key: value for key, value in values.items() if value is not None})
    texture = document.texture(PIXELS, sampler=sampler)
    document.row("materials", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    document.mesh(document.quad(material=0))
    found = only(document, tmp_path).material.base_color_texture
    names = {None: "repeat", 10497: "repeat", 33648: "mirror", 33071: "clamp"}
    assert (found.filter, found.mipmaps) == (between, mipmaps)
    assert found.wrap == (names[wrap_s], names[wrap_t])
    assert np.array_equal(found.image.pixels, PIXELS)


def test_every_slot_has_its_own_set_and_transform(tmp_path) -> None:
    document = Document()
    textures = [document.texture(PIXELS[..., :3] // (k + 1)) for k in range(4)]
    again = document.row("textures", source=0)

    def info(number: int, **fields):
        return {"index": number, **fields}

    document.row(
        "materials",
        pbrMetallicRoughness={
            "baseColorTexture": info(textures[0], texCoord=1),
            "metallicRoughnessTexture": info(
                textures[1], extensions={"KHR_texture_transform": {"offset": [0.5, 0.25], "texCoord": 2}}
            ),
        },
        normalTexture=info(textures[2], scale=0.5, texCoord=1),
        occlusionTexture=info(textures[3], strength=0.75),
        emissiveTexture=info(
            again,
            texCoord=2,
            extensions={"KHR_texture_transform": {"rotation": 0.5, "scale": [2, 3], "texCoord": 0}},
        ),
    )
    primitive = document.quad(material=0)
    for number in (1, 2):
        primitive["attributes"][f"TEXCOORD_{number}"] = document.accessor(QUAD_UV)
    document.mesh(primitive)
    material = only(document, tmp_path).material
    slots = ("base_color", "metallic_roughness", "normal", "occlusion", "emissive")
    found = [getattr(material, f"{slot}_texture") for slot in slots]
    assert [texture.uv_set for texture in found] == [1, 2, 1, 0, 0]
    assert found[0].image is found[4].image
    for k in range(4):
        assert np.array_equal(found[k].image.pixels, PIXELS[..., :3] // (k + 1))
    assert found[1].offset == (0.5, 0.25)
    assert (found[4].rotation, found[4].scale) == (0.5, (2.0, 3.0))
    assert (material.normal_scale, material.occlusion_strength) == (0.5, 0.75)


def test_transforms_turn_as_three_and_the_khronos_viewer_do() -> None:
    """Positive rotation turns UVs from +U towards −V, upwards in the image: see KhronosGroup/glTF#1563."""
    texture = nrs.Texture(PIXELS, rotation=np.pi / 2, offset=(0.1, 0.2), scale=(2.0, 3.0))
    rows = np.array(texture._rows())

    def place(u: float, v: float) -> np.ndarray:
        """From glTF's UV, v down."""
        return rows @ [u, 1.0 - v, 1.0]

    assert np.allclose(place(0, 0), [0.1, 0.2])
    assert np.allclose(place(1, 0), [0.1, 0.2 - 2.0])
    assert np.allclose(place(0, 1), [0.1 + 3.0, 0.2])
    # three.js, Matrix3.setUvTransform without a centre, its scale after the rotation.
    angle, (sx, sy) = 0.7, (1.5, 1.5)
    c, s = np.cos(angle), np.sin(angle)
    theirs = np.array([[sx * c, sx * s, 0.1], [-sy * s, sy * c, 0.2]])
    rows = np.array(nrs.Texture(PIXELS, rotation=angle, offset=(0.1, 0.2), scale=(sx, sy))._rows())
    for u, v in RNG.random((10, 2)):
        assert np.allclose(place(u, v), theirs @ [u, v, 1.0])


@pytest.mark.parametrize("where", ["buffer", "data", "percent", "file", "escaped", "windows"])
@pytest.mark.parametrize("kind", ["PNG", "JPEG", "16 bits"])
def test_images_lie_anywhere(tmp_path, where, kind) -> None:
    if kind == "16 bits":
        pytest.importorskip("OpenImageIO")
        from test_image_files import png as deep

        expected = RNG.integers(0, 65536, (4, 8, 3), dtype=np.uint16)
        content = deep(expected, 2, 16)
    else:
        content = png(PIXELS[..., :3], kind)
        (tmp_path / "x").write_bytes(content)
        expected = np.asarray(Pillow.open(tmp_path / "x"))
    document = Document()
    if where == "buffer":
        row = {"bufferView": document.view(content), "mimeType": "image/png"}
    elif where == "data":
        row = {"uri": "data:image/png;base64," + base64.b64encode(content).decode()}
    elif where == "percent":
        row = {"uri": "data:image/png," + "".join(f"%{byte:02x}" for byte in content)}
    else:
        (tmp_path / "some folder").mkdir()
        (tmp_path / "some folder" / "a+b.png").write_bytes(content)
        names = {
            "file": "some folder/a+b.png",
            "escaped": "some%20folder/a%2Bb.png",
            "windows": "some folder\\a+b.png",
        }
        row = {"uri": names[where]}
    document.row("textures", source=document.row("images", **row))
    document.row("materials", emissiveTexture={"index": 0})
    document.mesh(document.quad(material=0))
    texture = only(document, tmp_path).material.emissive_texture
    assert np.array_equal(texture.image.pixels, expected)


@pytest.mark.parametrize("form", ["glb", "gltf", "inline", "glb.gz"])
def test_files_of_every_form(tmp_path, form) -> None:
    document = Document()
    document.mesh(document.quad())
    path = tmp_path / f"a.{form.replace('inline', 'gltf')}"
    if form == "glb.gz":
        path.write_bytes(gzip.compress(document.glb()))
    else:
        document.save(path, inline=form == "inline")
    _, (part,) = parts_of(path)
    assert np.array_equal(part.source.vertices, QUAD)


def test_a_jpeg_has_no_holes(tmp_path) -> None:
    document = Document()
    document.row("textures", source=document.image(PIXELS[..., :3], "JPEG"))
    document.row("materials", alphaMode="MASK", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    document.mesh(document.quad(material=0))
    material = only(document, tmp_path).material
    assert material.alpha_mode == "mask"
    assert material.base_color_texture.image.pixels.shape[2] == 3
    assert len(material.base_color) == 3


def test_images_of_extensions_stand_in_where_there_is_no_other(tmp_path) -> None:
    document = Document()
    plain, webp = (
        document.image(PIXELS),
        document.row("images", bufferView=document.view(png(PIXELS, "WEBP"))),
    )
    broken = document.row("images", bufferView=document.view(b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(80)))
    document.row("textures", extensions={"EXT_texture_webp": {"source": webp}})
    document.row("textures", source=plain, extensions={"KHR_texture_basisu": {"source": broken}})
    document.row("textures", extensions={"KHR_texture_basisu": {"source": broken}})
    for number in range(3):
        document.row("materials", emissiveTexture={"index": number})
    document.mesh(document.quad(material=0), document.quad(material=1))
    _, parts = parts_of(document.save(tmp_path / "a.glb"))
    assert parts[0].material.emissive_texture.image.size == (8, 4)
    assert np.array_equal(parts[1].material.emissive_texture.image.pixels, PIXELS)
    document.mesh(document.quad(material=2))
    with pytest.raises(nrs.FormatError, match="KTX"):
        read_asset(document.save(tmp_path / "a.glb"))


def test_unlit(tmp_path) -> None:
    document = Document()
    texture = document.texture(PIXELS)
    document.row(
        "materials",
        pbrMetallicRoughness={
            "baseColorFactor": [0.5, 0.25, 1.0, 0.75],
            "baseColorTexture": {"index": texture},
        },
        emissiveFactor=[1, 1, 1],
        extensions={"KHR_materials_unlit": {}},
    )
    document.mesh(document.quad(material=0))
    material = only(document, tmp_path).material
    assert material.unlit
    assert material.base_color == (0.5, 0.25, 1.0, 0.75)
    assert material.base_color_texture is not None


def test_specular_glossiness_becomes_metal_and_roughness(tmp_path) -> None:
    document = Document()
    for diffuse, specular in ([0.5, 0.4, 0.3, 1.0], [0.0, 0.0, 0.0]), ([0.0, 0.0, 0.0, 1.0], [0.9, 0.6, 0.2]):
        document.row(
            "materials",
            extensions={
                "KHR_materials_pbrSpecularGlossiness": {
                    "diffuseFactor": diffuse,
                    "specularFactor": specular,
                    "glossinessFactor": 0.7,
                }
            },
        )
    document.mesh(document.quad(material=0), document.quad(material=1))
    _, (plastic, gold) = parts_of(document.save(tmp_path / "a.glb"))
    assert plastic.material.metallic == 0.0
    assert plastic.material.roughness == pytest.approx(0.3)
    assert gold.material.metallic > 0.95
    assert gold.material.base_color == pytest.approx((0.9, 0.6, 0.2), abs=0.05)


def test_transmission_is_blended(tmp_path) -> None:
    document = Document()
    volume = {"thicknessFactor": 2.0, "attenuationDistance": 1.0, "attenuationColor": [1.0, 0.5, 0.5]}
    looks = [
        {"KHR_materials_transmission": {"transmissionFactor": 1.0}},
        {"KHR_materials_transmission": {"transmissionFactor": 0.5}, "KHR_materials_ior": {"ior": 2.0}},
        {"KHR_materials_transmission": {"transmissionFactor": 1.0}, "KHR_materials_volume": volume},
        {"KHR_materials_transmission": {}},
        {"KHR_materials_ior": {"ior": 1.33}},
    ]
    for number, look in enumerate(looks):
        rough = {"baseColorFactor": [1.0, 1.0, 1.0, 0.5 if number == 1 else 1.0]}
        document.row("materials", name=f"m{number}", pbrMetallicRoughness=rough, extensions=look)
    document.mesh(*(document.quad(material=number) for number in range(len(looks))))
    asset, parts = parts_of(document.save(tmp_path / "a.glb"))
    clear, dense, tinted, none, plain = (part.material for part in parts)
    assert [one.alpha_mode for one in (clear, dense, tinted, none, plain)] == ["blend"] * 3 + ["opaque"] * 2
    # What is reflected at right angles, 4 % and 1/9, is not let through.
    assert clear.base_color[3] == pytest.approx(0.04)
    assert dense.base_color[3] == pytest.approx(0.5 * (1.0 - 0.5 * 8.0 / 9.0))
    # Two units of what lets a half through at one.
    assert tinted.base_color[:3] == pytest.approx((1.0, 0.25, 0.25))
    assert tinted.base_color[3] == pytest.approx(1.0 - 0.96 * 0.5)
    assert "transmission, drawn as thin blended surfaces (m0, m1, m2)" in str(asset.notes)
    assert "KHR_materials_ior (m4)" in str(asset.notes)


# --------------------------------------------------------------------------------------------- lights and cameras


def test_lights(tmp_path) -> None:
    document = Document()
    document.json["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "directional", "intensity": 3.0, "color": [1, 0.5, 0.25]},
                {"type": "point", "intensity": 40.0, "range": 7.0},
                {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.6}},
                {"type": "spot", "spot": {}},
            ]
        }
    }
    for number in range(4):
        document.row(
            "nodes",
            translation=[number, 0, 0],
            scale=[2, 2, 2],
            extensions={"KHR_lights_punctual": {"light": number}},
        )
    document.mesh(document.quad())
    lights = read_asset(document.save(tmp_path / "a.glb")).lights
    assert [light for light, _ in lights] == [
        nrs.DirectionalLight(lights[0][0].color, 3.0),
        nrs.PointLight(lights[1][0].color, 40.0, 7.0),
        nrs.SpotLight(lights[2][0].color, 1.0, None, 0.1, 0.6),
        nrs.SpotLight(lights[3][0].color, 1.0, None, 0.0, np.pi / 4),
    ]
    assert np.array_equal(lights[0][0].color, [1, 0.5, 0.25])
    for number, (_, pose) in enumerate(lights):
        assert np.allclose(pose[:3, :3], np.eye(3))
        assert pose[0, 3] == number


def test_cameras(tmp_path) -> None:
    document = Document()
    document.row("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5})
    document.row("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1, "zfar": 9.0})
    document.row(
        "cameras", type="orthographic", orthographic={"xmag": 2, "ymag": -3, "znear": 0.0, "zfar": 100.0}
    )
    for number in range(3):
        document.row("nodes", camera=number, scale=[2, 2, -2], translation=[0, 0, number])
    document.mesh(document.quad())
    cameras = read_asset(document.save(tmp_path / "a.glb")).cameras
    assert cameras[0][0] == nrs.PerspectiveCamera(0.7, 0.1)
    assert cameras[1][0] == nrs.PerspectiveCamera(0.7, 0.1, 9.0)
    assert (cameras[2][0].xmag, cameras[2][0].ymag) == (None, 3.0)
    for number, (_, pose) in enumerate(cameras):
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3))
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert pose[2, 3] == number


# -------------------------------------------------------------------------------------------------- compression


def packed(
    document: Document, data: bytes, rows: int, stride: int, mode: str, kind: str, extension: str
) -> int:
    """A buffer view that meshoptimizer compressed, with a fallback that has nothing in it."""
    view = document.view(data)
    part = document.json["bufferViews"][view].copy()
    if len(document.json.setdefault("buffers", [{}])) == 1:
        document.json["buffers"].append(
            {"byteLength": 1 << 20, "extensions": {extension: {"fallback": True}}}
        )
    extras = {} if kind == "NONE" else {"filter": kind}
    document.json["bufferViews"][view] = {
        "buffer": 1,
        "byteLength": rows * stride,
        **({"byteStride": stride} if mode == "ATTRIBUTES" else {}),
        "extensions": {extension: {**part, "byteStride": stride, "count": rows, "mode": mode, **extras}},
    }
    return view


def meshopt_document(extension: str, index: str, subdivisions: int = 2) -> tuple[Document, trimesh.Trimesh]:
    meshoptimizer = pytest.importorskip("meshoptimizer")
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    document = Document()
    document.json["extensionsRequired"] = [extension, "KHR_mesh_quantization"]
    vertices = np.ascontiguousarray(ball.vertices, np.float32)
    encoded = meshoptimizer.encode_vertex_buffer(vertices, len(vertices), 12)
    places = packed(document, bytes(encoded), len(vertices), 12, "ATTRIBUTES", "NONE", extension)
    faces = np.ascontiguousarray(ball.faces.reshape(-1), np.uint32)
    if index == "TRIANGLES":
        coded = meshoptimizer.encode_index_buffer(faces, len(faces), len(vertices))
    else:
        coded = meshoptimizer.encode_index_sequence(faces, len(faces), len(vertices))
    order = packed(document, bytes(coded), len(faces), 2, index, "NONE", extension)
    count = len(vertices)
    document.row("accessors", bufferView=places, componentType=5126, count=count, type="VEC3")
    document.row("accessors", bufferView=order, componentType=5123, count=len(faces), type="SCALAR")
    document.mesh({"attributes": {"POSITION": 0}, "indices": 1})
    return document, ball


@pytest.mark.parametrize("extension", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
@pytest.mark.parametrize("index", ["TRIANGLES", "INDICES"])
def test_meshopt(tmp_path, monkeypatch, extension, index) -> None:
    document, ball = meshopt_document(extension, index)
    source = only(document, tmp_path).source
    assert np.array_equal(source.vertices, np.float32(ball.vertices))
    # The codec may turn triangles.
    key = np.sort(source.faces, axis=1)
    assert np.array_equal(
        key[np.lexsort(key.T)], np.sort(ball.faces, axis=1)[np.lexsort(np.sort(ball.faces, axis=1).T)]
    )
    monkeypatch.setitem(sys.modules, "meshoptimizer", None)
    with pytest.raises(nrs.DependencyError, match=r"a\.glb: meshoptimizer is needed; pip install"):
        only(document, tmp_path)


def test_damaged_meshopt_is_refused(tmp_path) -> None:
    document, _ = meshopt_document("EXT_meshopt_compression", "TRIANGLES")
    path = document.save(tmp_path / "a.glb")
    for view in document.json["bufferViews"]:
        inner = view["extensions"]["EXT_meshopt_compression"]
        for change in (
            {"count": 2 * inner["count"] + 1},
            {"count": 1 << 40},
            {"byteLength": inner["byteLength"] - 3},
            {"byteStride": 7},
            {"mode": "NOTHING"},
            {"filter": "STRANGE"},
            {"filter": "QUATERNION"},
        ):
            before = dict(inner)
            inner.update(change)
            document.save(path)
            with pytest.raises(nrs.FormatError, match=r"a\.glb"):
                read_asset(path)
            inner.clear()
            inner.update(before)


def draco_document(subdivisions: int) -> tuple[Document, dict, trimesh.Trimesh, np.ndarray]:
    """A ball that Draco compressed, with the extension that says so, and its UVs."""
    draco = pytest.importorskip("DracoPy")
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    uv = ball.vertices[:, :2].astype(np.float32) * 0.5 + 0.5
    coded = draco.encode(
        ball.vertices.astype(np.float32),
        ball.faces,
        tex_coord=uv.astype(float),
        preserve_order=True,
        quantization_bits=16,
    )
    decoded = draco.decode(coded)
    idents = {
        {0: "POSITION", 3: "TEXCOORD_0"}[int(part["attribute_type"])]: part["unique_id"]
        for part in decoded.attributes
    }
    document = Document()
    document.json["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    count = len(decoded.points)
    document.row("accessors", componentType=5126, count=count, type="VEC3")
    document.row("accessors", componentType=5126, count=count, type="VEC2")
    document.row("accessors", componentType=5125, count=decoded.faces.size, type="SCALAR")
    extension = {"bufferView": document.view(bytes(coded)), "attributes": idents}
    document.mesh(
        {
            "attributes": {"POSITION": 0, "TEXCOORD_0": 1},
            "indices": 2,
            "extensions": {"KHR_draco_mesh_compression": extension},
        }
    )
    return document, extension, ball, uv


def test_draco(tmp_path, monkeypatch) -> None:
    document, extension, ball, uv = draco_document(3)
    source = only(document, tmp_path).source
    assert len(source.faces) == 1280
    assert np.abs(source.vertices - ball.vertices).max() < 1e-3
    assert np.abs(source.uvs[0] - np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)).max() < 1e-2
    extension["attributes"]["NORMAL"] = 77
    with pytest.raises(nrs.FormatError, match="NORMAL are not in what Draco"):
        only(document, tmp_path)
    del extension["attributes"]["NORMAL"]
    document.body[document.json["bufferViews"][0]["byteOffset"] + 20 :] = bytes(200)
    with pytest.raises(nrs.FormatError, match=r"Draco|ends at byte"):
        only(document, tmp_path)
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(nrs.DependencyError, match="DracoPy is needed"):
        only(document, tmp_path)


# ------------------------------------------------------------------------------------------------------ bad input


def textured() -> Document:
    """A document that has a bit of everything."""
    document = Document()
    document.row("samplers", wrapS=33071)
    texture = document.texture(PIXELS, sampler=0)
    document.row("images", uri="wood.png")
    document.row("materials", name="wood", pbrMetallicRoughness={"baseColorTexture": {"index": texture}})
    document.row("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1})
    camera = document.row("nodes", camera=0)
    mesh = document.mesh(document.quad(material=0))
    document.row("nodes", children=[mesh, camera])
    document.row("scenes", nodes=[2])
    return document


def changed(document: Document, path: str, value) -> None:
    """Set, or with ``...`` remove, what lies at ``accessors.0.count``."""
    *way, last = (int(step) if step.isdigit() else step for step in path.split("."))
    place = document.json
    for step in way:
        place = place[step]
    if value is ...:
        del place[last]
    else:
        place[last] = value


BAD = [
    ("asset.version", "1.0", "expected 2.0, found '1.0'"),
    ("asset", ..., "asset.version"),
    ("extensionsRequired", ["EXT_of_tomorrow"], "EXT_of_tomorrow"),
    ("accessors.0.count", 5, r"accessors\[0\]: it ends at byte 60 of bufferViews\[1\], which has 48"),
    ("accessors.0.count", -1, "whole number"),
    ("accessors.0.count", 1 << 60, "it ends at byte"),
    ("accessors.0.count", "4", "whole number"),
    ("accessors.0.componentType", 5124, "componentType 5124 is unknown"),
    ("accessors.0.type", "MAT3", "MAT3"),
    ("accessors.0.bufferView", 99, r"bufferViews\[99\]: there are 4"),
    ("accessors.0.byteOffset", 4, "it ends at byte"),
    ("accessors.1.count", 3, "3 of TEXCOORD_0 for 4 vertices"),
    ("accessors.2.componentType", 5122, "indices must be unsigned"),
    ("bufferViews.1.byteOffset", 1 << 20, r"of buffers\[0\], which has"),
    ("bufferViews.1.byteLength", ..., "byteLength: expected a whole number, found None"),
    ("bufferViews.1.buffer", 3, r"buffers\[3\]: there are 1"),
    ("meshes.0.primitives.0.attributes.POSITION", 50, r"accessors\[50\]"),
    ("meshes.0.primitives.0.attributes.POSITION", 1, "POSITION has 2 numbers a vertex, expected 3"),
    ("meshes.0.primitives.0.indices", 1, "indices must be unsigned"),
    ("meshes.0.primitives.0.material", 7, r"materials\[7\]: there are 1"),
    ("meshes.0.primitives", 3, "primitives: expected an array"),
    ("nodes.1.mesh", 2, r"meshes\[2\]: there are 1"),
    ("nodes.0.camera", 2, r"cameras\[2\]"),
    ("nodes.1.children", [2], r"nodes\[2\] is a child of two nodes, or below itself"),
    ("nodes.2.children", [1, 1], r"nodes\[1\] is a child of two nodes"),
    ("nodes.2.children", [9], r"nodes\[9\]: there are 3"),
    ("nodes.1.matrix", [1] * 15, "matrix: expected 16 numbers"),
    ("nodes.1.matrix", [1] * 16, "its last row"),
    ("nodes.1.translation", [1, "x", 2], "translation: expected 3 numbers"),
    ("scene", 4, r"scenes\[4\]: there are 1"),
    ("materials.0.pbrMetallicRoughness.baseColorTexture.index", 6, r"textures\[6\]"),
    ("materials.0.pbrMetallicRoughness.baseColorFactor", [1, 1], "expected 4 numbers"),
    ("materials.0.alphaMode", "GLASS", "material 'wood': alphaMode 'GLASS' is unknown"),
    ("textures.0.source", 9, r"images\[9\]: there are 2"),
    ("textures.0.source", ..., r"textures\[0\] has no image"),
    ("textures.0.sampler", 9, r"samplers\[9\]"),
    ("samplers.0.wrapS", 1, r"samplers\[0\]: wrapS 1 is unknown"),
    ("samplers.0.minFilter", 1, r"samplers\[0\]: minFilter 1 is unknown"),
    ("cameras.0.type", "fisheye", "fisheye"),
    ("cameras.0.perspective.yfov", 7.0, r"cameras\[0\]: yfov"),
    ("cameras.0.perspective.znear", ..., "znear: expected a number"),
    ("images.0.bufferView", 1, r"images\[0\]: it is damaged, or no image of a known format"),
    ("images.0", {"uri": "https://example.org/a.png"}, "is not fetched"),
    ("images.0", {"uri": "data:image/png;base64,###"}, "data URI|damaged"),
    ("images.0", {"uri": "data:image/png"}, "data URI has no data"),
    ("images.0", {}, "expected a URI"),
]


@pytest.mark.parametrize(("path", "value", "message"), BAD)
def test_bad_documents_are_refused(tmp_path, path, value, message) -> None:
    document = textured()
    if path == "extensionsRequired":
        document.json[path] = []
    document.glb()
    changed(document, path, value)
    target = tmp_path / "bad.glb"
    target.write_bytes(document.glb())
    with pytest.raises(nrs.FormatError, match=message) as caught:
        read_asset(target)
    assert "bad.glb" in str(caught.value)


def test_an_index_beyond_the_vertices(tmp_path) -> None:
    document = Document()
    primitive = document.quad()
    primitive["indices"] = document.accessor(np.array([0, 1, 4], np.uint8))
    document.mesh(primitive)
    with pytest.raises(nrs.FormatError, match="primitive 0: index 4 is beyond the 4 vertices"):
        only(document, tmp_path)


def test_a_sparse_index_beyond_the_elements(tmp_path) -> None:
    document = Document()
    places = document.accessor(QUAD, sparse=(np.array([4], np.uint8), QUAD[:1]))
    document.mesh({"attributes": {"POSITION": places}})
    with pytest.raises(nrs.FormatError, match=r"sparse.indices: 4 is beyond the 4 elements"):
        only(document, tmp_path)


def test_nothing_stored_of_too_much(tmp_path) -> None:
    document = Document()
    places = document.row("accessors", componentType=5126, count=1 << 40, type="VEC3")
    document.mesh({"attributes": {"POSITION": places}})
    with pytest.raises(nrs.FormatError, match="elements of which nothing is stored"):
        only(document, tmp_path)


def test_buffers_that_are_short_or_missing(tmp_path) -> None:
    document = Document()
    document.mesh(document.quad())
    path = document.save(tmp_path / "a.gltf")
    (tmp_path / "the buffer.bin").write_bytes(bytes(document.body)[:-1])
    with pytest.raises(nrs.FormatError, match=r"buffers\[0\]: it should have \d+ bytes"):
        read_asset(path)
    (tmp_path / "the buffer.bin").unlink()
    with pytest.raises(nrs.MissingFileError, match=r"a\.gltf: buffers\[0\].*the buffer\.bin"):
        read_asset(path)
    del document.json["buffers"][0]["uri"]
    path.write_text(json.dumps(document.json))
    with pytest.raises(nrs.FormatError, match="no URI"):
        read_asset(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"[" * 100_000, b"glTF", b"\xff\xfe", b'{"asset": 3}'])
def test_what_is_no_gltf_is_refused(tmp_path, content) -> None:
    for suffix in ("gltf", "glb"):
        path = tmp_path / f"a.{suffix}"
        path.write_bytes(content)
        with pytest.raises(nrs.FormatError, match=rf"a\.{suffix}"):
            read_asset(path)


def test_missing_and_bad_textures_are_refused_or_dropped(tmp_path) -> None:
    document = textured()
    document.json["textures"][0]["source"] = 1
    path = document.save(tmp_path / "a.glb")
    with pytest.raises(nrs.MissingFileError, match=r"a\.glb: images\[1\].*wood\.png"):
        read_asset(path)
    with pytest.raises(nrs.MissingFileError, match='bad_textures="drop"') as missing:
        read_asset(path)
    assert missing.value.errno == errno.ENOENT
    asset, (part,) = parts_of(path, drop_bad_textures=True)
    assert part.material.base_color_texture is None
    assert "textures left out, as they cannot be read" in str(asset.notes)
    for content in (b"no image", png(PIXELS)[:60], b"\xabKTX 20\xbb\r\n\x1a\n"):
        (tmp_path / "wood.png").write_bytes(content)
        with pytest.raises(nrs.FormatError, match=r'wood\.png.*bad_textures="drop"'):
            read_asset(path)
        assert read_asset(path, drop_bad_textures=True).meshes[0][0].material.base_color_texture is None


def test_textures_without_uvs_go_with_a_note(tmp_path) -> None:
    document = textured()
    info = document.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    for number in (1, 3, 200):
        info["texCoord"] = number
        asset, (part,) = parts_of(document.save(tmp_path / "a.glb"))
        assert part.material.base_color_texture is None
        assert str(asset.notes) == "textures left out, as surfaces have no such UVs (wood)"


def test_notes_say_what_was_changed(tmp_path) -> None:
    document = textured()
    wood = document.json["materials"][0]
    wood.update(alphaMode="BLEND", extensions={"KHR_materials_clearcoat": {}})
    wood.setdefault("pbrMetallicRoughness", {})["baseColorFactor"] = [1, 1, 1, 0.5]
    points = document.quad(mode=0)
    flat = document.quad()
    flat["indices"] = document.accessor(np.array([0, 1, 0], np.uint8))
    document.json["meshes"][0]["primitives"] += [points, flat]
    document.json["nodes"][1].update(skin=document.row("skins", joints=[0]), weights=[0.5])
    asset, (part,) = parts_of(document.save(tmp_path / "a.glb"))
    assert part.material.alpha_mode == "blend"
    ((drawn,),) = asset.strokes.values()
    assert drawn.segments is None
    for text in (
        "KHR_materials_clearcoat (wood)",
        "surfaces without area",
        "weights of morph targets that are missing (meshes[0], primitive 0",
        "skins without joints and weights",
    ):
        assert text in str(asset.notes)


KEYS = [
    "count", "byteOffset", "byteLength", "byteStride", "componentType", "type", "bufferView", "buffer", "index",
    "source", "sampler", "texCoord", "children", "mesh", "nodes", "matrix", "scale", "uri", "mode", "attributes",
]  # fmt: skip


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.integers(0, 10_000),
            st.one_of(
                st.none(),
                st.booleans(),
                st.integers(-5, 10),
                st.sampled_from([1 << 31, 1 << 62, 1e300, float("nan"), -0.5]),
                st.text(max_size=3),
                st.lists(st.integers(-1, 3), max_size=4),
                st.dictionaries(st.sampled_from(KEYS), st.integers(-1, 3), max_size=3),
            ),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_any_damage_to_the_json_gives_an_error_of_ours(tmp_path, changes) -> None:
    document = textured()
    document.glb()
    for number, value in changes:
        places = []

        def walk(node, found) -> None:
            for key in list(node) if isinstance(node, dict) else range(len(node)):
                found.append((node, key))
                if isinstance(node[key], dict | list):
                    walk(node[key], found)

        walk(document.json, places)
        node, key = places[number % len(places)]
        node[key] = value
    path = tmp_path / "a.glb"
    try:
        path.write_bytes(document.glb())
    except Exception:  # what the test's own writer needs is gone
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            nrs.load_scene(path, bad_textures="drop")
            said = "a.glb"
        except nrs.NaniteError as error:
            said = str(error)
    assert "a.glb" in said


def test_every_cut_off_file_is_refused(tmp_path) -> None:
    content = textured().glb()
    path = tmp_path / "a.glb"
    for end in range(0, len(content) - 1, 3):
        path.write_bytes(content[:end])
        with pytest.raises(nrs.FormatError, match=r"a\.glb"):
            read_asset(path)
