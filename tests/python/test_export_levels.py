"""``mesh.export``: levels of detail in one file, with coverages that follow from their errors, or in several."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs._export_levels import SCREEN, YFOV, coverages
from nanite_rs._export_textures import halved
from test_export import source

FOCAL = 0.5 * SCREEN[1] / math.tan(0.5 * YFOV)


def document(path: Path) -> dict:
    return json.loads(path.read_text())


def test_one_file_has_all_levels(tmp_path) -> None:
    mesh = source()
    levels = [1.0, 0.5, 0.1]
    assert mesh.export(tmp_path / "a.gltf", levels=levels) == [str(tmp_path / "a.gltf")]
    found = document(tmp_path / "a.gltf")
    assert "MSFT_lod" in found["extensionsUsed"]
    assert "extensionsRequired" not in found
    (shown,) = found["scenes"][0]["nodes"]
    first = found["nodes"][shown]
    nodes = [first, *(found["nodes"][k] for k in first["extensions"]["MSFT_lod"]["ids"])]
    cuts = [mesh.cut(error=0.0), mesh.cut(target_reduction=0.5), mesh.cut(target_reduction=0.9)]
    for node, cut in zip(nodes, cuts, strict=True):
        assert node["extras"]["error"] == cut.error
        assert node["extras"]["triangles"] == len(cut)
        primitives = found["meshes"][node["mesh"]]["primitives"]
        assert sum(found["accessors"][p["indices"]]["count"] for p in primitives) == 3 * len(cut)
    # In common.
    assert len(found["materials"]) == 2
    assert len(found["images"]) == 2
    stated = first["extras"]["MSFT_screencoverage"]
    assert len(stated) == 3
    assert stated == sorted(stated, reverse=True)
    assert stated[-1] == 0.0
    # Who does not know the extension shows the finest.
    assert sum(len(node.mesh) for node in nrs.load_scene(tmp_path / "a.gltf").scene.instances) == len(mesh)
    assert len(trimesh.load(tmp_path / "a.gltf", force="mesh").faces) == len(mesh)


@pytest.mark.parametrize("pixel_error", [1.0, 4.0])
def test_no_level_is_off_by_more_pixels(pixel_error, tmp_path) -> None:
    """Where each level begins: the camera at the distance that its coverage says, in all directions."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces)
    errors = [0.0, 0.002, 0.01, 0.05]
    mesh.export(tmp_path / "a.gltf", errors=errors, pixel_error=pixel_error)
    found = document(tmp_path / "a.gltf")
    stated = found["nodes"][found["scenes"][0]["nodes"][0]]["extras"]["MSFT_screencoverage"]
    center, radius = mesh.bounds.mean(axis=0), 0.5 * np.linalg.norm(np.ptp(mesh.bounds, axis=0))
    surface = trimesh.Trimesh(vertices, faces, process=False)
    rng = np.random.default_rng(2)
    most = []
    for error, covered in zip(errors[1:], stated, strict=False):
        points = mesh.cut(error=error).vertices.astype(np.float64)
        points = points[rng.permutation(len(points))[:1000]]
        nearest = trimesh.proximity.closest_point(surface, points)[0]
        # The sphere's area is this part of the screen.
        away = FOCAL * radius / math.sqrt(covered * SCREEN[0] * SCREEN[1] / math.pi)
        for _ in range(20):
            back = rng.normal(size=3)
            back /= np.linalg.norm(back)
            up = np.cross(back, rng.normal(size=3))
            up /= np.linalg.norm(up)
            axes = np.stack([np.cross(up, back), up, back])
            a, b = ((p - center) @ axes.T - (0, 0, away) for p in (points, nearest))
            off = np.linalg.norm(FOCAL * (a[:, :2] / -a[:, 2:] - b[:, :2] / -b[:, 2:]), axis=1)
            most.append(off.max())
    assert max(most) <= pixel_error
    # Not by being far too careful: errors are proven, and mostly smaller.
    assert max(most) > 0.1 * pixel_error


def test_coverages_of_anything() -> None:
    assert coverages([0.0], 1.0, 1.0) == [0.0]
    assert coverages([0.0, 0.0, 0.5], 1.0, 1.0)[0] > 0.4
    assert coverages([0.1, 0.2], 0.0, 1.0) == [0.0, 0.0]
    rising = coverages([0.0, 0.3, 0.2, 0.4], 1.0, 1.0)
    assert rising == sorted(rising, reverse=True)


@pytest.mark.parametrize("ending", ["glb", "ply", "obj"])
def test_a_file_for_each_level(ending, tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=2_000))
    names = mesh.export(tmp_path / f"a.{ending}", levels=[0.5, 0.1], separate=True)
    assert [Path(name).name for name in names] == [f"a_lod0.{ending}", f"a_lod1.{ending}"]
    for name, part in zip(names, (0.5, 0.1), strict=True):
        assert len(trimesh.load(name, force="mesh").faces) == len(
            mesh.cut(target_faces=int(part * len(mesh)))
        )
    assert mesh.export(tmp_path / f"b.{ending}", errors=[0.1]) == [str(tmp_path / f"b.{ending}")]
    assert mesh.export(tmp_path / f"c.{ending}") == [str(tmp_path / f"c.{ending}")]
    assert len(trimesh.load(tmp_path / f"c.{ending}", force="mesh").faces) == len(mesh)


def test_large_coordinates_stay_exact(tmp_path) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=2_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices.astype(np.float64) + 1e7, faces)
    mesh.export(tmp_path / "a.gltf", levels=[1.0, 0.1])
    for node in document(tmp_path / "a.gltf")["nodes"]:
        np.testing.assert_allclose(node["translation"], 1e7, atol=0.1)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_halved_images_are_means_in_linear_light(dtype, channels) -> None:
    rng = np.random.default_rng(4)
    whole = 1.0 if dtype == np.float32 else np.iinfo(dtype).max
    pixels = (rng.uniform(0, 1, (16, 32, channels)) * whole).astype(dtype)
    for color in (False, True):
        values = pixels / whole
        bright = channels - (channels in (2, 4)) if color and dtype != np.float32 else 0
        values[..., :bright] = linear(values[..., :bright])
        means = values.reshape(4, 4, 8, 4, channels).mean(axis=(1, 3))
        means[..., :bright] = srgb(means[..., :bright])
        found = halved(nrs.Image(pixels), 2, color).pixels
        assert found.dtype == dtype
        np.testing.assert_allclose(found / whole, means, atol=0.6 / min(whole, 1e5) + 1e-6)


def linear(x: np.ndarray) -> np.ndarray:
    """As IEC 61966-2-1 has it."""
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def srgb(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.0031308, x * 12.92, 1.055 * x ** (1 / 2.4) - 0.055)


def test_odd_sides_are_averaged_by_area() -> None:
    pixels = np.arange(5, dtype=np.float32).reshape(1, 5, 1)
    # 2.5 pixels each.
    expected = [(0 + 1 + 0.5 * 2) / 2.5, (0.5 * 2 + 3 + 4) / 2.5]
    np.testing.assert_allclose(halved(nrs.Image(pixels), 1, False).pixels[0, :, 0], expected, rtol=1e-5)
    assert halved(nrs.Image(pixels), 9, False).size == (1, 1)


def painted(size: int) -> nrs.NaniteMesh:
    """A bumpy ball with a fine pattern."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    uvs = 0.2 + 0.3 * vertices[:, :2].astype(np.float32)
    x, y = np.meshgrid(*2 * [np.linspace(0, 60, size)])
    pattern = np.stack([np.sin(x), np.sin(y), np.cos(x + y)], axis=-1)
    look = nrs.Material(
        base_color=(1, 1, 1),
        metallic=0.0,
        base_color_texture=nrs.Texture((127 + 120 * pattern).astype(np.uint8)),
    )
    return nrs.NaniteMesh.from_arrays(vertices, faces, uvs=uvs, materials=look)


def test_textures_of_coarse_levels_have_what_is_seen_of_them(tmp_path) -> None:
    mesh = painted(2048)
    errors = [0.0, 0.02, 0.1]
    names = mesh.export(tmp_path / "a.gltf", errors=errors, separate=True)
    sizes = [images(name)[0] for name in names]
    assert sizes[0] == 2048 > sizes[1] > sizes[2] >= 16
    pictures = []
    for error, name in zip(errors[1:], names[1:], strict=True):
        fitted = nrs.load_scene(name).scene
        whole = nrs.Scene()
        whole.add(nrs.NaniteMesh.from_arrays(**arrays(mesh.cut(error=error))))
        away = FOCAL * error + 1.3
        for scene in (fitted, whole):
            scene.ambient_light = (1.0, 1.0, 1.0)
            pose = np.eye(4)
            pose[2, 3] = away
            with nrs.Renderer(*SCREEN, backend="cpu") as renderer:
                pictures.append(
                    renderer.render(scene, nrs.PerspectiveCamera(yfov=YFOV), pose, pixel_error=0).color
                )
    for a, b in zip(pictures[::2], pictures[1::2], strict=True):
        seen = (b != b[0, 0]).any(axis=2)
        assert seen.sum() > 300
        assert 10 * np.log10(255**2 / np.mean((a[seen].astype(float) - b[seen]) ** 2)) > 28


def arrays(cut: nrs.Cut) -> dict:
    names = ("vertices", "faces", "normals", "uvs", "materials")
    return {name: getattr(cut, name) for name in names}


def images(name: str) -> list[int]:
    """Widths of the images of a file."""
    loaded = nrs.load_scene(name)
    (look,) = {node.material for node in loaded.scene.instances}
    return [look.base_color_texture.image.size[0]]


def test_jpeg_stays_jpeg(tmp_path) -> None:
    rng = np.random.default_rng(0)
    picture = PIL.Image.fromarray(rng.integers(0, 255, (8, 8, 3)).astype(np.uint8)).resize((512, 512))
    picture.save(tmp_path / "a.jpg")
    image = nrs.Image.open(tmp_path / "a.jpg")
    small = halved(image, 2, True)
    assert small.encoded().startswith(b"\xff\xd8\xff")
    assert small.size == (128, 128)
    assert (
        np.abs(
            small.pixels.astype(int) - np.asarray(picture.resize((128, 128), PIL.Image.Resampling.BOX))
        ).mean()
        < 4
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"levels": [1], "errors": [0]}, "found both"),
        ({"levels": []}, "levels: there are none"),
        ({"levels": [0.1, 0.5]}, "the finest comes first"),
        ({"levels": [1.5]}, "levels: must be above 0"),
        ({"levels": [0.5, 0.0]}, "levels: must be above 0"),
        ({"errors": [-1.0]}, "errors: must be 0 or more"),
        ({"errors": [0.0, float("nan")]}, "errors"),
        ({"levels": [1.0, 0.5], "pixel_error": 0.0}, "pixel_error: must be positive"),
        ({"levels": "11"}, "levels: expected numbers"),
    ],
)
def test_what_cannot_be_asked_for(given, message, tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80))
    with pytest.raises((nrs.ArgumentError, nrs.DtypeError), match=message):
        mesh.export(tmp_path / "a.glb", **given)
    assert not list(tmp_path.iterdir())


def test_formats_of_one_level(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80))
    with pytest.raises(nrs.ArgumentError, match=r"\.ply files hold one level; give separate=True"):
        mesh.export(tmp_path / "a.ply", levels=[1.0, 0.5])


@pytest.mark.parametrize("kind", ["jpeg", "png", "webp"])
def test_images_as_other_files(kind, tmp_path) -> None:
    mesh = source()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert mesh.export(tmp_path / "a.gltf", levels=[1.0, 0.2], images=kind) == [str(tmp_path / "a.gltf")]
    found = document(tmp_path / "a.gltf")
    kinds = {image["mimeType"] for image in found["images"]}
    # The second image has holes.
    assert kinds == ({"image/jpeg", "image/png"} if kind == "jpeg" else {f"image/{kind}"})
    assert ("EXT_texture_webp" in found.get("extensionsRequired", [])) == (kind == "webp")
    looks = nrs.NaniteMesh.from_file(tmp_path / "a.gltf").materials
    for look, own in zip(mesh.materials, looks, strict=True):
        for slot in ("base_color_texture", "normal_texture"):
            texture, other = getattr(look, slot), getattr(own, slot)
            assert (texture is None) == (other is None)
            if texture is not None:
                a, b = texture.image.pixels.astype(int), other.image.pixels.astype(int)
                off = np.abs(a - b[..., : a.shape[2]])
                # Noise is the worst for JPEG and WebP.
                assert off.mean() < 60
                assert kind == "jpeg" or slot == "base_color_texture" or off.max() == 0


def test_images_of_a_single_level_and_mistakes(tmp_path) -> None:
    mesh = source()
    mesh.export(tmp_path / "a.glb", images="webp", compression="meshopt")
    assert len(nrs.NaniteMesh.from_file(tmp_path / "a.glb").materials) == 2
    with pytest.raises(nrs.ArgumentError, match="images: expected None, 'jpeg', 'png', 'webp'"):
        mesh.export(tmp_path / "a.glb", images="avif")
    with pytest.raises(nrs.ArgumentError, match=r"images: for glTF; \.obj files have them as they are"):
        mesh.export(tmp_path / "a.obj", images="webp")
