"""Cuts as files and as objects of trimesh: they look as the source did, and what is lost is named."""

from __future__ import annotations

import io
import json
import os
import warnings

import numpy as np
import pytest
import trimesh
from PIL import Image as Pillow

import nanite_rs as nrs
from nanite_rs import _export_parts as export
from oracles import data
from oracles.documents import Document, png

RNG = np.random.default_rng(7)
PIXELS = RNG.integers(0, 256, (8, 16, 3), dtype=np.uint8)
FAST = nrs.BuildOptions(quality="fast")


def source(**more) -> nrs.NaniteMesh:
    """A bumpy sheet with colours, two UV sets, channels and two looks."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=2_000)
    u, v = np.arctan2(vertices[:, 1], vertices[:, 0]) / 3, vertices[:, 2] / 2
    image = nrs.Image(PIXELS)
    holes = nrs.Image(np.dstack([PIXELS, RNG.integers(0, 256, (8, 16), dtype=np.uint8)]))
    moved = {"offset": (0.25, 0.5), "rotation": 0.7, "scale": (3.0, 0.5)}
    looks = [
        nrs.Material(
            base_color=(0.5, 0.75, 1.0),
            metallic=0.25,
            roughness=0.5,
            emissive=(0.5, 3.0, 0.25),
            base_color_texture=nrs.Texture(
                image, wrap=("clamp", "mirror"), filter="nearest", mipmaps=None, **moved
            ),
            metallic_roughness_texture=nrs.Texture(image, uv_set=1, mipmaps="nearest"),
            normal_texture=nrs.Texture(image),
            normal_scale=0.5,
            occlusion_texture=nrs.Texture(image),
            occlusion_strength=0.75,
            emissive_texture=nrs.Texture(image, filter="nearest", mipmaps="linear"),
        ),
        nrs.Material(
            base_color=(1.0, 1.0, 1.0, 0.875),
            double_sided=True,
            smooth=False,
            alpha_mode="mask",
            alpha_cutoff=0.25,
            base_color_texture=nrs.Texture(holes),
        ),
    ]
    given = {
        "colors": np.abs(np.column_stack([vertices, vertices[:, 0]])) / 2,
        "uvs": [np.stack([u, v], 1).astype(np.float32), np.stack([v, u], 1).astype(np.float32)],
        "channels": {
            "heat": vertices[:, 0].astype(np.float32),
            "part": (vertices[:, 2] > 0).astype(np.int32),
        },
        "face_materials": (vertices[faces].mean(axis=1)[:, 0] > 0).astype(np.int32),
        "materials": looks,
    }
    return nrs.NaniteMesh.from_arrays(vertices, faces, options=FAST, **(given | more))


def shot(scene: nrs.Scene, camera, pose) -> np.ndarray:
    scene.ambient_light = (0.3, 0.3, 0.3)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=pose)
    with nrs.Renderer(128, 96, backend="cpu") as renderer:
        return renderer.render(scene, camera, pose, pixel_error=0, shading="gltf").color


def of_cut(cut: nrs.Cut) -> nrs.Scene:
    """The very triangles of a cut, as a scene."""
    arrays = {
        name: getattr(cut, name) for name in ("normals", "colors", "uvs", "face_materials", "materials")
    }
    scene = nrs.Scene()
    scene.add(nrs.NaniteMesh.from_arrays(cut.vertices, cut.faces, **arrays, options=FAST))
    return scene


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    error = np.mean((a.astype(np.float64) - b) ** 2)
    return 10 * np.log10(255**2 / max(error, 1e-9))


def pictures(cut: nrs.Cut, given) -> float:
    """How near what was made of a cut looks to it."""
    back = nrs.load_scene(given, options=FAST)
    camera, pose = back.view()
    return psnr(shot(of_cut(cut), camera, pose), shot(back.scene, camera, pose))


# ------------------------------------------------------------------------------------------------------------ glTF


@pytest.mark.parametrize("ending", ["glb", "gltf"])
def test_gltf_holds_everything(tmp_path, ending) -> None:
    cut = source().cut(target_faces=500)
    path = tmp_path / f"some name.{ending}"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cut.export(path)
    back = nrs.NaniteMesh.from_file(path, options=FAST)
    assert len(back) == len(cut)
    again = back.cut(error=0)
    for old, new in zip(cut.materials, back.materials, strict=True):
        for name in (
            "base_color",
            "metallic",
            "roughness",
            "emissive",
            "double_sided",
            "smooth",
            "normal_scale",
        ):
            assert getattr(new, name) == pytest.approx(getattr(old, name))
        for name in ("occlusion_strength", "alpha_mode", "alpha_cutoff"):
            assert getattr(new, name) == getattr(old, name)
        for slot, texture in export.textures(old):
            other = getattr(new, slot)
            for name in ("uv_set", "wrap", "filter", "mipmaps", "offset", "rotation", "scale"):
                assert getattr(other, name) == getattr(texture, name), (slot, name)
            assert np.array_equal(other.image.pixels, texture.image.pixels)
    # One image for all slots that show it.
    assert len({id(texture.image) for _, texture in export.textures(back.materials[0])}) == 1
    order = [np.lexsort(c.vertices[c.faces].mean(axis=1).T) for c in (cut, again)]
    assert np.array_equal(cut.face_materials[order[0]], again.face_materials[order[1]])
    for name in ("vertices", "colors"):
        ours, theirs = (
            np.sort(getattr(c, name)[c.faces].astype(np.float64), axis=1)[o]
            for c, o in zip((cut, again), order, strict=True)
        )
        assert np.array_equal(ours, theirs)
    for k in range(2):
        ours, theirs = (
            np.sort(c.uvs[k][c.faces], axis=1)[o] for c, o in zip((cut, again), order, strict=True)
        )
        assert np.allclose(ours, theirs, atol=1e-6)
    assert np.allclose(again.channels["_heat"], again.vertices[:, 0], atol=0.2)
    assert set(again.channels["_part"].tolist()) == {0, 1}
    assert pictures(cut, path) > 60


def test_what_trimesh_reads_of_a_glb(tmp_path) -> None:
    """Its own reader: triangles, UVs, factors, images, colours."""
    look = nrs.Material(
        base_color=(0.5, 0.25, 1.0), roughness=0.25, base_color_texture=nrs.Texture(nrs.Image(PIXELS))
    )
    cut = source(materials=look, face_materials=None).cut(target_faces=500)
    cut.export(tmp_path / "a.glb")
    (mesh,) = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    assert len(mesh.faces) == len(cut)
    assert np.array_equal(mesh.vertices[mesh.faces], cut.vertices[cut.faces])
    assert np.allclose(mesh.visual.uv[mesh.faces], cut.uvs[0][cut.faces], atol=1e-6)
    assert np.array_equal(mesh.visual.vertex_attributes["color"][mesh.faces], cut.fine_colors[cut.faces])
    assert np.array_equal(np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")), PIXELS)
    assert mesh.visual.material.roughnessFactor == 0.25
    assert pictures(cut, mesh) > 40


def test_images_are_written_as_the_files_they_were(tmp_path) -> None:
    for kind in ("PNG", "JPEG", "BMP"):
        picture = tmp_path / f"a.{kind.lower()}"
        picture.write_bytes(png(PIXELS, kind))
        image = nrs.Image.open(picture)
        content, ending = export.image_file(image, True, export.Notes())
        assert (content == picture.read_bytes()) == (kind != "BMP")
        assert ending == ("jpg" if kind == "JPEG" else "png")
        assert np.array_equal(np.asarray(Pillow.open(io.BytesIO(content))), image.pixels)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png(kind, channels) -> None:
    pixels = RNG.integers(0, np.iinfo(kind).max, (5, 7, channels), dtype=kind)
    written = export.png(pixels)
    assert np.array_equal(nrs.Image._read(written, "a").pixels, pixels)
    if kind is np.uint8 or channels == 1:
        assert np.array_equal(np.asarray(Pillow.open(io.BytesIO(written))).reshape(pixels.shape), pixels)


def test_pixels_of_floats_become_srgb(tmp_path) -> None:
    pixels = np.linspace(0, 1, 64, dtype=np.float32).reshape(4, 4, 4)
    look = nrs.Material(
        base_color_texture=nrs.Texture(nrs.Image(pixels)), normal_texture=nrs.Texture(nrs.Image(pixels))
    )
    source(materials=look).cut(target_faces=500).export(tmp_path / "a.glb")
    (back,) = nrs.NaniteMesh.from_file(tmp_path / "a.glb").materials
    assert np.allclose(back.normal_texture.image.pixels / 65535, pixels, atol=1e-5)
    stored = back.base_color_texture.image.pixels / 65535
    linear = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    assert np.allclose(linear[..., :3], pixels[..., :3], atol=1e-4)
    assert np.allclose(stored[..., 3], pixels[..., 3], atol=1e-5)
    bright = nrs.Material(base_color_texture=nrs.Texture(nrs.Image(pixels * 4)))
    with pytest.warns(UserWarning, match="pixels below 0 and above 1"):
        source(materials=bright).cut(target_faces=500).export(tmp_path / "a.glb")


def test_large_coordinates_stay_exact(tmp_path) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=320)
    far = np.array([451234.567, 5412345.678, 321.123])
    cut = nrs.NaniteMesh.from_arrays(vertices + far, faces).cut(error=0)
    for ending in ("glb", "obj", "ply", "off"):
        path = tmp_path / f"a.{ending}"
        cut.export(path)
        back = nrs.NaniteMesh.from_file(path).cut(error=0)
        assert np.allclose(
            np.sort(back.vertices, axis=0), np.sort(cut.vertices, axis=0), atol=1e-6, rtol=0
        ), ending
    with pytest.warns(UserWarning, match=r"a\.stl: not everything is kept: digits beyond float32"):
        cut.export(tmp_path / "a.stl")


def test_colours_stay_as_fine_as_they_were(tmp_path) -> None:
    document = Document()
    primitive = document.quad()
    dark = np.float32([[0.001, 0.002, 0.0005], [0.0001, 0, 0], [1, 1, 1], [0.5, 0.25, 0.75]])
    primitive["attributes"]["COLOR_0"] = document.accessor(dark)
    document.mesh(primitive)
    cut = nrs.NaniteMesh.from_file(document.save(tmp_path / "a.glb")).cut(error=0)
    cut.export(tmp_path / "b.glb")
    again = nrs.NaniteMesh.from_file(tmp_path / "b.glb").cut(error=0)
    for one in (cut, again):
        assert one.fine_colors.dtype == np.float32
        assert np.array_equal(np.sort(one.fine_colors[:, :3], axis=0), np.sort(dark, axis=0))


def test_the_document_is_valid(tmp_path) -> None:
    """Alignment, bounds and types, as the specification wants them."""
    cut = source().cut(target_faces=500)
    cut.export(tmp_path / "a.gltf")
    document = json.loads((tmp_path / "a.gltf").read_text())
    body = (tmp_path / "a.bin").read_bytes()
    assert document["buffers"] == [{"byteLength": len(body), "uri": "a.bin"}]
    assert set(document["extensionsUsed"]) == {"KHR_materials_emissive_strength", "KHR_texture_transform"}
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(body)
        assert view.get("byteStride", 4) % 4 == 0
    for primitive in document["meshes"][0]["primitives"]:
        accessors = [
            document["accessors"][k] for k in (*primitive["attributes"].values(), primitive["indices"])
        ]
        assert "min" in accessors[0]
        assert len({accessor["count"] for accessor in accessors[:-1]}) == 1
        for accessor in accessors[:-1]:
            assert accessor["componentType"] != 5125


# ---------------------------------------------------------------------------------------------------- other formats


def test_obj_with_its_mtl(tmp_path) -> None:
    pixels = np.dstack([PIXELS, RNG.integers(0, 256, (8, 16), dtype=np.uint8)])
    looks = [
        nrs.Material(base_color=(0.5, 0.25, 1.0), roughness=0.5, emissive=(0, 1, 0)),
        nrs.Material(
            base_color=(1, 1, 1),
            alpha_mode="mask",
            base_color_texture=nrs.Texture(nrs.Image(pixels), offset=(0.25, 0.5), scale=(2, 3), wrap="clamp"),
        ),
    ]
    cut = source(materials=looks, colors=None, channels=None).cut(target_faces=500)
    with pytest.warns(UserWarning, match=r"a\.obj: not everything is kept: UV sets beyond the first"):
        cut.export(tmp_path / "a.obj")
    assert pictures(cut, tmp_path / "a.obj") > 40
    mesh = trimesh.load(tmp_path / "a.obj", process=False)
    assert sum(len(part.faces) for part in getattr(mesh, "geometry", {"": mesh}).values()) == len(cut)


def test_ply_holds_what_vertices_carry(tmp_path) -> None:
    cut = source(materials=None).cut(target_faces=500)
    cut.export(tmp_path / "a.ply")
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.vertices, cut.vertices)
    assert np.array_equal(mesh.faces, cut.faces)
    raw = mesh.metadata["_ply_raw"]
    assert np.array_equal(raw["vertex"]["data"]["part"], cut.channels["part"])
    for k, name in enumerate(("red", "green", "blue", "alpha")):
        assert np.array_equal(raw["vertex"]["data"][name], cut.fine_colors[:, k])
    assert np.array_equal(raw["vertex"]["data"]["s1"], cut.uvs[1][:, 0])
    assert np.array_equal(raw["face"]["data"]["material_index"].ravel(), cut.face_materials)


@pytest.mark.parametrize(
    ("ending", "lost"),
    [
        ("ply", ["materials"]),
        ("stl", ["colours", "UVs", "materials", r"channels \(heat, part\)"]),
        ("off", ["colours", "UVs", "materials", r"channels \(heat, part\)"]),
        ("obj", [r"channels \(heat, part\)", "double-sided materials", "flat shading", "metallic factors"]),
    ],
)
def test_what_a_format_cannot_hold_is_named(tmp_path, ending, lost) -> None:
    cut = source().cut(target_faces=500)
    with pytest.warns(UserWarning, match=rf"a\.{ending}: not everything is kept") as caught:
        cut.export(tmp_path / f"a.{ending}")
    (warning,) = caught
    assert warning.filename == __file__
    for text in lost:
        with pytest.warns(UserWarning, match=text):
            cut.export(os.fsencode(tmp_path / f"a.{ending}"))
    mesh = trimesh.load_mesh(tmp_path / f"a.{ending}", process=False)
    corners = cut.vertices[cut.faces].astype(np.float64)
    area = trimesh.triangles.area(corners).sum()
    parts = mesh.geometry.values() if isinstance(mesh, trimesh.Scene) else [mesh]
    assert sum(len(part.faces) for part in parts) == len(cut)
    assert sum(part.area for part in parts) == pytest.approx(area, rel=1e-5)


def test_endings(tmp_path) -> None:
    cut = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80)).cut(error=0)
    with pytest.raises(nrs.FormatError, match=r"a\.xyzw: cannot write that; .*glb, gltf, obj, off, ply, stl"):
        cut.export(tmp_path / "a.xyzw")
    with pytest.raises(nrs.MissingFileError, match="none"):
        cut.export(tmp_path / "none" / "a.glb")
    with pytest.raises(nrs.DtypeError, match="path: expected a path, not int"):
        cut.export(3)
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------------------------------------------- trimesh


def test_to_trimesh_is_textured() -> None:
    texture = nrs.Texture(nrs.Image(PIXELS), offset=(0.25, 0.5), rotation=0.7, scale=(3.0, 0.5))
    looks = [
        nrs.Material(base_color=(0.5, 0.75, 1.0), base_color_texture=texture),
        nrs.Material(base_color=(1, 0, 0), double_sided=True),
    ]
    for materials in (looks, looks[:1]):
        mesh = source(materials=materials)
        cut = mesh.cut(target_faces=500)
        with pytest.warns(UserWarning, match="to_trimesh: not everything is kept: UV sets beyond the first"):
            made = cut.to_trimesh()
        assert np.array_equal(made.visual.vertex_attributes["color"], cut.colors)
        assert pictures(cut, made) > 40
        back = nrs.NaniteMesh.from_trimesh(made)
        assert len(back.materials) == len(materials)
        assert back.cut(error=0).colors is not None


def test_colours_alone_stay_colours_for_trimesh() -> None:
    vertices, faces = nrs.shapes.icosphere(faces=80)
    for materials in (None, nrs.Material(base_color=(1, 1, 1))):
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, colors=np.abs(vertices), materials=materials)
        cut = mesh.cut(error=0)
        with pytest.warns(UserWarning, match="colours finer than 8 bits"):
            made = cut.to_trimesh()
        assert np.array_equal(made.visual.vertex_colors, cut.colors)


# ------------------------------------------------------------------------------------------------------- real files

QUICK = [
    ("gltf", "MultiUVTest", "MultiUVTest.glb"),
    ("gltf", "NegativeScaleTest", "NegativeScaleTest.glb"),
    ("gltf", "VertexColorTest", "VertexColorTest.glb"),
    ("foliage", "quaternius_tree_3_cards", "OBJ", "Tree_3.obj"),
    ("foliage", "town_tree_cards", "scene.gltf"),
]
SOAKED = [
    ("gltf", "AlphaBlendModeTest", "AlphaBlendModeTest.glb"),
    ("cad", "japanese_bridge_garden", "scene.glb"),
    ("cad", "occlusion_room", "room.glb"),
    ("cad", "zdm2_level", "zdm2.glb"),
    ("foliage", "GlassVaseFlowers", "GlassVaseFlowers.glb"),
    ("foliage", "quaternius_birch_8_cards", "OBJ", "Birch_8.obj"),
    ("foliage", "quaternius_pine_1_cards", "OBJ", "Pine_1.obj"),
    ("foliage", "scatter_pine_tree", "pine_tree.glb"),
    ("foliage", "scatter_tree", "tree.glb"),
    ("gltf", "FlightHelmet", "FlightHelmet.gltf"),
    ("gltf", "SheenChair", "glTF", "SheenChair.gltf"),
    ("gltf", "ToyCar", "glTF", "ToyCar.gltf"),
    ("gltf", "chess_board", "chess-board.glb"),
    ("gltf", "dutch_ship_medium_1k", "polyhaven", "dutch_ship_medium_1k.gltf"),
    ("gltf", "house_lightmap_uv2", "house.glb"),
    ("gltf", "lamborghini_gt3", "scene.glb"),
    ("gltf", "usd_shaderball", "usd-shaderball-ball.glb"),
    ("nasty", "capsule", "capsule.obj"),
    ("scans", "smithsonian_fossil_100k", "USNM_1145291-150k-2048-medium-100k-2048_draco.glb"),
]
# Of these trimesh reads less than they hold: one UV set and no texture transforms.
BEYOND_TRIMESH = ("MultiUVTest", "SheenChair")


@pytest.mark.filterwarnings("ignore:.*not everything is kept")
@pytest.mark.parametrize(
    "path", QUICK + (SOAKED if os.environ.get("NANITE_SOAK") else []), ids=lambda path: path[1]
)
def test_cuts_of_real_files_look_the_same_again(tmp_path, path) -> None:
    cut = nrs.NaniteMesh.from_file(data.require(*path), options=FAST).cut(target_reduction=0.9)
    assert cut.materials
    cut.export(tmp_path / "a.glb")
    assert pictures(cut, tmp_path / "a.glb") >= 40
    if path[1] not in BEYOND_TRIMESH:
        assert pictures(cut, trimesh.load(tmp_path / "a.glb", process=False)) >= 40
        assert pictures(cut, cut.to_trimesh()) >= 40


@pytest.mark.parametrize("ending", ["glb", "gltf", "obj"])
def test_names_of_materials_are_kept(ending: str, tmp_path) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=320)
    looks = [nrs.Material(name="bark"), nrs.Material(base_color=(1, 0, 0), name="bark"), nrs.Material()]
    rows = np.arange(len(faces)) % 3
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, face_materials=rows, materials=looks)
    path = tmp_path / f"named.{ending}"
    mesh.cut(error=0).export(path)
    again = nrs.NaniteMesh.from_file(path)
    assert {look.name for look in again.materials} <= {"bark", "bark_1", "material_2"}
    assert len(again.materials) >= 2
    loaded = trimesh.load(path)
    parts = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
    names = {part.visual.material.name for part in parts if getattr(part.visual.material, "name", None)}
    assert {"bark", "bark_1", "material_2"} >= names
    assert nrs.Material(name="a") == nrs.Material(name="b")
    with pytest.raises(nrs.DtypeError, match=r"^name"):
        nrs.Material(name=3)  # type: ignore[arg-type]
