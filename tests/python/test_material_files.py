"""Materials in ``.nanite`` files: what goes in comes out, images bit for bit and when they are looked at."""

from __future__ import annotations

import io
import json
import pickle
import warnings
from dataclasses import replace

import numpy as np
import PIL.Image
import pytest

import nanite_rs as nrs
from nanite_rs import _material_files
from nanite_rs.cli import main
from oracles import data
from oracles.materials import textures

RNG = np.random.default_rng(7)


def picture(dtype: str, channels: int) -> np.ndarray:
    """Any pixels."""
    shape = (5, 9, channels)
    if dtype == "float32":
        return RNG.uniform(-2, 70000, shape).astype(np.float32)
    return RNG.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def ball(materials, **more) -> nrs.NaniteMesh:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=2_000)
    uvs = [vertices[:, :2].astype(np.float32)]
    return nrs.NaniteMesh.from_arrays(vertices, faces, uvs=uvs, materials=materials, progress=False, **more)


def saved(mesh: nrs.NaniteMesh, path) -> nrs.NaniteMesh:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mesh.save(path)
        return nrs.NaniteMesh.open(path)


def assert_same(ours, theirs) -> None:
    """Compare factors and textures; images by what they hold."""
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        own, other = textures(a), textures(b)
        assert own.keys() == other.keys()
        none = dict.fromkeys(own)
        assert replace(a, **none) == replace(b, **none)
        assert a.name == b.name
        for slot, texture in own.items():
            same = other[slot]
            assert replace(texture, image=same.image) == same
            assert texture.image.pixels.dtype == same.image.pixels.dtype
            np.testing.assert_array_equal(texture.image.pixels, same.image.pixels)


def everything() -> list[nrs.Material]:
    """Materials with all fields, and images of all kinds."""
    shared = nrs.Image(picture("uint8", 3))
    moved = {"offset": (0.25, -1.5), "rotation": 0.3, "scale": (2.0, 0.1)}
    return [
        nrs.Material(
            base_color=(0.1, 0.2, 1 / 3, 0.7),
            metallic=0.123456789,
            emissive=(7.0, 0.0, 1e-3),
            smooth=False,
            alpha_mode="blend",
            base_color_texture=nrs.Texture(
                shared, wrap=("mirror", "clamp"), filter="nearest", mipmaps=None, **moved
            ),
            emissive_texture=nrs.Texture(nrs.Image(picture("float32", 3)), anisotropy=3),
            name="Ζink",
        ),
        nrs.Material(
            roughness=0.0,
            double_sided=True,
            unlit=True,
            normal_scale=-2.0,
            occlusion_strength=0.5,
            alpha_mode="mask",
            alpha_cutoff=0.25,
            normal_texture=nrs.Texture(nrs.Image(picture("uint16", 2)), mipmaps="nearest"),
            occlusion_texture=nrs.Texture(shared),
            metallic_roughness_texture=nrs.Texture(nrs.Image(picture("uint8", 1))),
        ),
        nrs.Material(base_color_texture=nrs.Texture(nrs.Image(picture("uint8", 4)))),
    ]


def test_all_that_materials_say_comes_back(tmp_path) -> None:
    looks = everything()
    mesh = ball(looks, face_materials=np.arange(2_000) % 3)
    again = saved(mesh, tmp_path / "a.nanite")
    assert_same(again.materials, looks)
    first, second = again.materials[:2]
    assert first.base_color_texture.image is second.occlusion_texture.image
    parts = nrs.NaniteMesh.file_info(tmp_path / "a.nanite")["parts"]
    assert parts["materials"] > 0 < parts["images"]
    # What was opened is written again, as it is.
    assert_same(saved(again, tmp_path / "b.nanite").materials, looks)
    assert (tmp_path / "a.nanite").read_bytes() == (tmp_path / "b.nanite").read_bytes()
    for copy in (pickle.loads(pickle.dumps(again)), pickle.loads(pickle.dumps(mesh))):
        assert_same(copy.materials, looks)


def test_files_of_images_stay_as_they_are(tmp_path) -> None:
    for kind in ("JPEG", "PNG", "WEBP"):
        PIL.Image.fromarray(picture("uint8", 3)).save(tmp_path / kind, format=kind)
    images = [nrs.Image.open(tmp_path / kind) for kind in ("JPEG", "PNG", "WEBP", "JPEG")]
    looks = [nrs.Material(base_color_texture=nrs.Texture(image)) for image in images]
    again = saved(ball(looks, face_materials=np.arange(2_000) % 4), tmp_path / "a.nanite")
    for look, kind in zip(again.materials, ("JPEG", "PNG", "WEBP", "JPEG"), strict=True):
        assert look.base_color_texture.image.encoded() == (tmp_path / kind).read_bytes()
    # By what they hold, not by who opened them.
    assert again._core.image_count == 3


def test_images_are_read_when_they_are_looked_at(tmp_path) -> None:
    pixels = RNG.integers(0, 255, (512, 512, 3)).astype(np.uint8)
    ball(nrs.Material(base_color_texture=nrs.Texture(pixels))).save(tmp_path / "a.nanite")
    with open(tmp_path / "a.nanite", "rb") as file:
        mesh = nrs.NaniteMesh.open(file)
        image = mesh.materials[0].base_color_texture.image
        assert repr(image) == "<Image 512 x 512, 3 channels, uint8>"
        assert image.size == (512, 512)
        assert mesh.traffic.read_bytes < 400_000
        np.testing.assert_array_equal(image.pixels, pixels)
        assert mesh.traffic.read_bytes > 700_000


def test_an_opened_mesh_looks_as_the_one_that_was_built(tmp_path) -> None:
    checker = np.kron([[0, 1], [1, 0]], np.ones((8, 8))).astype(np.uint8) * 200 + 40
    mesh = ball(nrs.Material(base_color=(1, 1, 1), base_color_texture=nrs.Texture(checker)))
    mesh.save(tmp_path / "a.nanite", precision="exact")
    pictures = []
    for one in (mesh, nrs.NaniteMesh.open(tmp_path / "a.nanite")):
        scene = nrs.Scene()
        scene.add(one)
        scene.add(nrs.DirectionalLight(intensity=3.0))
        camera, pose = (
            scene.framing() if hasattr(scene, "framing") else (nrs.PerspectiveCamera(yfov=0.8), None)
        )
        pose = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]]) if pose is None else pose
        pictures.append(nrs.Renderer(96, 96).render(scene, camera, pose).color)
    assert np.ptp(pictures[0]) > 50
    np.testing.assert_array_equal(*pictures)


def test_plain_looks_are_not_written(tmp_path) -> None:
    for look in ((), nrs.Material(), nrs.Material(base_color=(1, 1, 1))):
        again = saved(ball(look), tmp_path / "a.nanite")
        assert again.materials == ()
        assert nrs.NaniteMesh.file_info(tmp_path / "a.nanite")["parts"]["materials"] == 0
    assert saved(ball(nrs.Material(name="steel")), tmp_path / "a.nanite").materials[0].name == "steel"


def test_the_command_line_counts_them(tmp_path, capsys) -> None:
    ball(everything()).save(tmp_path / "a.nanite")
    assert main(["info", str(tmp_path / "a.nanite")]) == 0
    assert "materials  3, with 5 images\n" in capsys.readouterr().out


@pytest.mark.parametrize("path", [pytest.param(p, id=p.stem) for p in data.folder_models("gltf")])
def test_real_materials_come_back(path, tmp_path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = nrs.NaniteMesh.from_file(
            path, options=nrs.BuildOptions(quality="fast", error="quadric"), progress=False
        )
    again = saved(mesh, tmp_path / "a.nanite")
    if nrs.NaniteMesh.file_info(tmp_path / "a.nanite")["parts"]["materials"] == 0:
        assert all(look in (nrs.Material(), nrs.Material(base_color=(1, 1, 1))) for look in mesh.materials)
        return
    assert_same(again.materials, mesh.materials)
    for look, before in zip(again.materials, mesh.materials, strict=True):
        for slot, texture in textures(before).items():
            assert getattr(look, slot).image.encoded() == texture.image.encoded()


def test_real_materials_are_there() -> None:
    assert data.folder_models("gltf") or data.require("gltf")


# ------------------------------------------------------------------------------------------------- damage


def table_of(materials) -> tuple[dict, list[bytes]]:
    table, images = _material_files.encoded(materials)
    return json.loads(table), images


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t["materials"][0].update(metallic=2), "metallic"),
        (lambda t: t["materials"][0].update(metallic="a"), "metallic"),
        (lambda t: t["materials"][0].update(base_color=[1]), "base_color"),
        (lambda t: t["materials"][0].update(base_color_texture=3), "TypeError|AttributeError"),
        (lambda t: t["materials"][0]["base_color_texture"].update(image=1), "image 1 of 1"),
        (lambda t: t["materials"][0]["base_color_texture"].update(image=True), "image True"),
        (lambda t: t["materials"][0]["base_color_texture"].pop("image"), "KeyError: 'image'"),
        (lambda t: t["materials"][0]["base_color_texture"].update(wrap=[1, 2]), "wrap"),
        (lambda t: t["images"].pop(), "0 images, 1 sections|image 0 of 0"),
        (lambda t: t["images"][0].update(width="wide"), "ValueError"),
        (lambda t: t.pop("materials"), "KeyError: 'materials'"),
    ],
)
def test_a_damaged_table_is_an_error(change, message) -> None:
    table, images = table_of([nrs.Material(base_color_texture=nrs.Texture(picture("uint8", 3)))])
    change(table)
    with pytest.raises(nrs.FormatError, match=rf"^ball\.nanite: section Materials: .*({message})"):
        _material_files.decoded(json.dumps(table), len(images), images.__getitem__, "ball.nanite")


@pytest.mark.parametrize("table", ["{", "[]", "null", "[" * 100_000])
def test_a_table_that_is_none_is_an_error(table) -> None:
    with pytest.raises(nrs.FormatError, match=r"^ball\.nanite: section Materials: "):
        _material_files.decoded(table, 0, [].__getitem__, "ball.nanite")


def test_fields_of_others_are_ignored() -> None:
    look = nrs.Material(base_color_texture=nrs.Texture(picture("uint8", 3)))
    table, images = table_of([look])
    table["more"] = 1
    table["materials"][0]["clearcoat"] = 0.5
    table["materials"][0]["base_color_texture"]["more"] = {}
    del table["materials"][0]["metallic"]
    assert_same(_material_files.decoded(json.dumps(table), 1, images.__getitem__, ""), [look])


def test_a_damaged_image_is_an_error_when_it_is_looked_at(tmp_path) -> None:
    pixels = RNG.integers(0, 255, (64, 64, 3)).astype(np.uint8)
    ball(nrs.Material(base_color_texture=nrs.Texture(pixels))).save(tmp_path / "a.nanite")
    content = bytearray((tmp_path / "a.nanite").read_bytes())
    content[content.index(b"IDAT") + 100] ^= 1
    (tmp_path / "b.nanite").write_bytes(content)
    image = nrs.NaniteMesh.open(tmp_path / "b.nanite").materials[0].base_color_texture.image
    with pytest.raises(nrs.FormatError, match=r"b\.nanite.*section Images, number 0: the checksum"):
        _ = image.pixels
    with pytest.raises(nrs.FormatError, match="section Images, number 0: the checksum"):
        nrs.NaniteMesh.from_file(io.BytesIO(content), format="nanite")


def test_an_image_of_another_size_is_an_error() -> None:
    table, images = table_of([nrs.Material(base_color_texture=nrs.Texture(picture("uint8", 3)))])
    table["images"][0]["width"] = 10
    (look,) = _material_files.decoded(json.dumps(table), 1, images.__getitem__, "ball.nanite")
    with pytest.raises(
        nrs.FormatError, match=r"^ball\.nanite: image 0: it is uint8 of shape \(5, 9, 3\), and"
    ):
        _ = look.base_color_texture.image.pixels
