"""Levels beyond the seams of textures: what their images show, against the source."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import data
from oracles.captures import capture

if TYPE_CHECKING:
    from collections.abc import Sequence

FOSSIL = ("scans", "smithsonian_fossil_100k", "USNM_1145291-150k-2048-medium-100k-2048_draco.glb")
REBAKE = nrs.BuildOptions(rebake="auto", texture_size=512, quality="fast", error="quadric")


def stripes(points: np.ndarray) -> np.ndarray:
    """Smooth colours of a direction."""
    u = points / np.linalg.norm(points, axis=1, keepdims=True)
    wave = np.sin(12 * u[:, 0] + 3 * np.sin(7 * u[:, 1])) * np.cos(9 * u[:, 2] + 2 * u[:, 0])
    other = 0.2 * np.cos(5 * u[:, 1] + wave)
    return np.stack([0.5 + 0.35 * wave, 0.45 + other, 0.35 + 0.3 * np.sin(4 * u[:, 2])], axis=1)


@pytest.fixture(scope="module")
def stone() -> dict:
    """A capture of 600 charts."""
    made = capture(16_000, 600)
    look = nrs.Material(
        base_color=(1.0, 1.0, 1.0),
        metallic=0.0,
        base_color_texture=nrs.Texture(made.painted(1024, stripes)),
    )
    return made.arrays() | {"materials": look}


@pytest.fixture(scope="module")
def rebaked(stone) -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(**stone, options=REBAKE)


def scene_of(cut: nrs.Cut, looks: Sequence[nrs.Material]) -> nrs.Scene:
    """The cut as it is, with these looks."""
    scene = nrs.Scene()
    scene.add(
        nrs.TriangleMesh(
            cut.vertices,
            cut.faces,
            normals=cut.normals,
            uvs=cut.uvs,
            face_materials=cut.face_materials,
            materials=looks,
        )
    )
    return scene


def shots(
    cut: nrs.Cut, bounds: np.ndarray, pixel: float, unlit: bool = False, outline: bool = False
) -> np.ndarray:
    """A picture in which a pixel is so long, of sixteen samples each; or its outline alone, of one colour."""
    looks = [replace(look, unlit=unlit) for look in cut.materials]
    if outline:
        looks = [nrs.Material(base_color=(0.35, 0.3, 0.25), unlit=True, double_sided=True)] * len(looks)
    scene = scene_of(cut, looks)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at([1, 1, 2], [0, 0, 0]))
    size, middle = float(np.linalg.norm(bounds[1] - bounds[0])), bounds.mean(axis=0)
    count = int(np.clip(size / pixel, 8, 500))
    half = count * pixel / 2
    camera = nrs.OrthographicCamera(xmag=half, ymag=half, znear=0.01 * size, zfar=10 * size)
    pose = nrs.look_at(middle + np.array([0.6, 0.5, 0.9]) * 2 * size, middle)
    frame = nrs.Renderer(4 * count, 4 * count, backend="cpu").render(scene, camera, pose, outputs=("linear",))
    light = np.clip(frame.linear.reshape(count, 4, count, 4, 3).mean(axis=(1, 3)), 0.0, 1.0)
    encoded = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def flip(mesh: nrs.NaniteMesh, triangles: int) -> float:
    """Against full detail, where the cut is off by a pixel."""
    cut, full = mesh.cut(target_faces=triangles), mesh.cut(error=0.0)
    pixel = max(cut.error, cut.attribute_error)
    return nrs.compare(*(shots(one, mesh.bounds, pixel) for one in (cut, full))).flip


def sampled(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Nearest pixels, v up."""
    at = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]) * image.shape[1::-1]
    column, row = np.clip(at.astype(int), 0, np.array(image.shape[1::-1]) - 1).T
    return image[row, column]


def points_of(cut: nrs.Cut, number: int, count: int = 4_000) -> tuple[np.ndarray, np.ndarray]:
    """Points of the faces of a material, and their UVs, away from the borders of triangles."""
    rng = np.random.default_rng(1)
    rows = np.flatnonzero(cut.face_materials == number)
    shares = rng.dirichlet([3.0, 3.0, 3.0], count)
    faces = cut.faces[rng.choice(rows, count)]
    points, uvs = ((of[faces] * shares[..., None]).sum(axis=1) for of in (cut.vertices, cut.uvs[0]))
    return points, uvs


def test_levels_go_on_and_show_what_the_source_shows(stone, rebaked) -> None:
    assert rebaked.check().clusters == rebaked.report.clusters
    assert len(rebaked.cut(error=np.inf)) <= 128
    assert len(rebaked.materials) == 1 + len({part.material for part in rebaked.report.rebaked})
    for part in rebaked.report.rebaked[::3]:
        cut = rebaked.cut(target_faces=part.triangles)
        number = part.material
        if not (cut.face_materials == number).any():
            continue
        points, uvs = points_of(cut, number)
        image = rebaked.materials[number].base_color_texture.image.pixels
        found = sampled(image, uvs) / 255.0
        near, _, _ = trimesh.proximity.closest_point(
            trimesh.Trimesh(stone["vertices"], stone["faces"], process=False), points[:500]
        )
        error = np.abs(found[:500] - np.clip(stripes(near), 0.0, 1.0))
        # A texel of these stripes differs little from the next.
        assert np.median(error) < 0.02 + 2.0 * part.texel, part
    assert np.median([flip(rebaked, part.triangles) for part in rebaked.report.rebaked[::4]]) <= 0.06


def test_every_cut_is_closed(rebaked) -> None:
    for error in np.geomspace(1e-3, 0.5, 9):
        cut = rebaked.cut(error=error)
        _, places = np.unique(cut.vertices, axis=0, return_inverse=True)
        assert trimesh.Trimesh(
            cut.vertices[np.unique(places, return_index=True)[1]],
            places.reshape(-1)[cut.faces],
            process=False,
        ).is_watertight


def test_texels_are_stated(rebaked) -> None:
    sizes = [part.texel for part in rebaked.report.rebaked]
    assert sizes == sorted(sizes)
    coarse = rebaked.cut(error=np.inf)
    assert coarse.attribute_error >= sizes[-1]
    assert "rebaked" in str(rebaked.report)
    for part in rebaked.report.rebaked:
        # Texels are as large as they say: a square of the image is one of the surface.
        cut = rebaked.cut(target_faces=part.triangles)
        own = (cut.face_materials == part.material) & (
            np.repeat(cut.cluster_levels, np.diff([*cut._first_face])) == part.level
        )
        if own.sum() < 20:
            continue
        width, height = rebaked.materials[part.material].base_color_texture.image.size
        assert max(width, height) <= 512
        corners, uvs = cut.vertices[cut.faces[own]], cut.uvs[0][cut.faces[own]] * [width, height]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        (a, b), (c, d) = (uvs[:, 1] - uvs[:, 0]).T, (uvs[:, 2] - uvs[:, 0]).T
        covered = a * d - b * c
        assert (covered > 0.0).mean() > 0.99  # counter-clockwise: no chart is mirrored
        assert np.isclose(np.sqrt(area.sum() / covered.sum()), part.texel, rtol=0.1)


def test_normals_are_those_of_the_source() -> None:
    """With a normal map on the source, and without one: the map of a level bends its own normals to them."""
    made = capture(16_000, 300)
    rng = np.random.default_rng(2)
    plain = made.arrays()
    flat = np.full((64, 64, 3), (128, 128, 255), np.uint8)
    bent = flat.copy()
    bent[..., :2] = rng.integers(100, 156, (1, 1, 2))
    color = nrs.Texture(np.full((8, 8, 3), 200, np.uint8))
    for image in (None, flat, bent):
        texture = None if image is None else nrs.Texture(image)
        look = nrs.Material(base_color_texture=color, normal_texture=texture)
        mesh = nrs.NaniteMesh.from_arrays(**plain, materials=look, options=REBAKE)
        part = mesh.report.rebaked[0]
        cut = mesh.cut(target_faces=part.triangles)
        full = mesh.cut(error=0.0)
        pixel = float(np.linalg.norm(mesh.bounds[1] - mesh.bounds[0])) / 200
        for shading in ("pyrender", "gltf"):
            ours, theirs = (seen_normals(one, mesh.bounds, pixel, shading) for one in (cut, full))
            angles = apart(ours, theirs)
            assert np.median(angles) < 3.0, (shading, np.median(angles))


def apart(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    """Degrees between what both show."""
    both = (np.abs(ours).sum(axis=2) > 0) & (np.abs(theirs).sum(axis=2) > 0)
    return np.degrees(np.arccos(np.clip((ours * theirs).sum(axis=2)[both], -1, 1)))


def seen_normals(cut: nrs.Cut, bounds: np.ndarray, pixel: float, shading: str) -> np.ndarray:
    scene = scene_of(cut, cut.materials)
    size, middle = float(np.linalg.norm(bounds[1] - bounds[0])), bounds.mean(axis=0)
    camera = nrs.OrthographicCamera(xmag=size / 2, ymag=size / 2, znear=0.01 * size, zfar=10 * size)
    pose = nrs.look_at(middle + np.array([0.6, 0.5, 0.9]) * 2 * size, middle)
    count = int(size / pixel)
    renderer = nrs.Renderer(count, count, backend="cpu")
    return renderer.render(scene, camera, pose, outputs=("shading_normal",), shading=shading).shading_normal


def test_materials_become_one_where_images_can_say_it(stone) -> None:
    """What differs in colours, metal and light is baked; what has holes stays apart."""
    part = (stone["vertices"][stone["faces"]].mean(axis=1)[:, 2] > 0.0).astype(np.int32)
    red = nrs.Material(base_color=(0.8, 0.1, 0.1), metallic=0.25, roughness=0.5, emissive=(0.0, 3.0, 0.0))
    textured = replace(stone["materials"], metallic=0.75, roughness=1.0)
    mesh = nrs.NaniteMesh.from_arrays(
        **stone | {"materials": [textured, red]}, face_materials=part, options=REBAKE
    )
    numbers = {part.material for part in mesh.report.rebaked}
    assert min(numbers) == 2
    coarse = mesh.cut(error=np.inf)
    assert set(coarse.face_materials) <= numbers
    number = int(coarse.face_materials[0])
    look = mesh.materials[number]
    assert (look.metallic, look.roughness, look.base_color) == (1.0, 1.0, (1.0, 1.0, 1.0))
    points, uvs = points_of(coarse, number)
    upper, lower = points[:, 2] > 0.2, points[:, 2] < -0.2
    orm = sampled(look.metallic_roughness_texture.image.pixels, uvs) / 255.0
    light = sampled(look.emissive_texture.image.pixels, uvs) / 255.0
    color = sampled(look.base_color_texture.image.pixels, uvs) / 255.0
    assert np.allclose(np.median(orm[upper], axis=0)[1:], [0.5, 0.25], atol=0.01)
    assert np.allclose(np.median(orm[lower], axis=0)[1:], [1.0, 0.75], atol=0.01)
    assert look.emissive[1] == pytest.approx(3.0, rel=0.02)
    assert np.median(light[upper], axis=0)[1] > 0.98
    assert np.median(light[lower], axis=0).max() == 0.0
    # sRGB of 0.8 and 0.1.
    assert np.allclose(np.median(color[upper], axis=0), [0.906, 0.349, 0.349], atol=0.01)

    holes = replace(red, alpha_mode="mask", base_color_texture=nrs.Texture(np.full((4, 4, 4), 255, np.uint8)))
    apart = nrs.NaniteMesh.from_arrays(
        **stone | {"materials": [textured, holes]}, face_materials=part, options=REBAKE
    )
    bare = nrs.NaniteMesh.from_arrays(
        **stone | {"materials": replace(textured, unlit=True, normal_texture=textured.base_color_texture)},
        options=REBAKE,
    )
    look = bare.materials[-1]
    assert look.unlit
    assert look.base_color_texture.image is not textured.base_color_texture.image
    assert look.normal_texture is None
    modes = {apart.materials[part.material].alpha_mode for part in apart.report.rebaked}
    assert modes == {"opaque", "mask"}


def test_rebake_may_be_repeated(stone, rebaked) -> None:
    plain = nrs.NaniteMesh.from_arrays(**stone, options=replace(REBAKE, rebake="never"))
    once = nrs.rebake(plain, texture_size=512, options=REBAKE)
    # Faces come in another order.
    assert np.isclose(once.report.rebaked[0].triangles, rebaked.report.rebaked[0].triangles, rtol=0.1)
    again = nrs.rebake(once, texture_size=512, options=REBAKE)
    assert len(again.materials) == len(once.materials)
    assert len(again) == len(once)


def test_bytes_do_not_depend_on_threads(stone, rebaked, tmp_path) -> None:
    rebaked.save(tmp_path / "a.nanite")
    other = nrs.NaniteMesh.from_arrays(**stone, options=replace(REBAKE, threads=1))
    other.save(tmp_path / "b.nanite")
    assert (tmp_path / "a.nanite").read_bytes() == (tmp_path / "b.nanite").read_bytes()
    back = nrs.NaniteMesh.open(tmp_path / "a.nanite")
    assert back.report.rebaked == rebaked.report.rebaked
    assert len(back.materials) == len(rebaked.materials)


def test_files_of_a_coarse_cut_have_its_image_alone(rebaked, tmp_path) -> None:
    cut = rebaked.cut(target_faces=128)
    cut.export(tmp_path / "coarse.glb")
    back = nrs.NaniteMesh.from_file(tmp_path / "coarse.glb")
    used = {int(n) for n in np.unique(cut.face_materials)}
    assert len(back.materials) == len(used)
    assert (tmp_path / "coarse.glb").stat().st_size < 300_000


def test_scenes_of_files(stone, tmp_path) -> None:
    """Each mesh of a scene has images of its own, and instances show them."""
    nrs.NaniteMesh.from_arrays(**stone).cut(error=0.0).export(tmp_path / "x.glb")
    loaded = nrs.load_scene(tmp_path / "x.glb", options=REBAKE)
    ((node,),) = loaded.instances.values()
    assert len(node.material) == len(node.mesh.materials) > 1
    assert node.mesh.report.rebaked
    plain = nrs.load_scene(tmp_path / "x.glb", options=replace(REBAKE, rebake="never"))
    ((other,),) = plain.instances.values()
    assert not isinstance(other.material, tuple) or len(other.material) == 1
    size = float(np.linalg.norm(np.ptp(stone["vertices"], axis=0)))
    pose, lens = nrs.look_at([0, 0, 20 * size], [0, 0, 0]), nrs.PerspectiveCamera(yfov=0.06)
    shown = []
    for one in (loaded.scene, plain.scene):
        one.add(nrs.DirectionalLight(intensity=3.0), pose=pose)
        with nrs.Renderer(96, 96, backend="cpu") as renderer:
            shown.append(renderer.render(one, lens, pose, pixel_error=4.0).color[..., :3])
    assert nrs.compare(*shown).flip < 0.08


def test_tiles_of_it(rebaked, tmp_path) -> None:
    report = rebaked.to_3dtiles(tmp_path / "tiles", triangles=2_000, up="z")
    assert report.tiles > 4


def test_exact_budgets_do_not_tear_images(rebaked) -> None:
    """Between two levels, the coarser one's edges are divided: its texture lies as it did."""
    counts = [part.triangles for part in rebaked.report.rebaked]
    between = (counts[2] + counts[3]) // 2
    cut, below = rebaked.cut(target_faces=between), rebaked.cut(target_faces=counts[3])
    assert between - 2 <= len(cut) <= between
    pixel = float(np.linalg.norm(rebaked.bounds[1] - rebaked.bounds[0])) / 150
    assert nrs.compare(*(shots(one, rebaked.bounds, pixel, unlit=True) for one in (cut, below))).flip < 0.01


def test_nothing_to_do(stone) -> None:
    """No textures, or no seams that are in the way."""
    bare = nrs.NaniteMesh.from_arrays(stone["vertices"], stone["faces"], options=REBAKE)
    assert bare.report.rebaked == ()
    with pytest.raises(nrs.ArgumentError, match="no textures"):
        nrs.rebake(bare)
    vertices, faces = nrs.shapes.terrain(faces=8_000)
    look = stone["materials"]
    smooth = nrs.NaniteMesh.from_arrays(
        vertices, faces, uvs=vertices[:, :2].astype(np.float32), materials=look, options=REBAKE
    )
    assert (smooth.report.rebaked, smooth.materials) == ((), (look,))
    assert smooth.cut(error=0.0).face_materials is None


def test_mistakes(stone, monkeypatch) -> None:
    with pytest.raises(nrs.DtypeError, match="mesh: expected a NaniteMesh"):
        nrs.rebake("stone.glb")
    with pytest.raises(nrs.ArgumentError, match="texture_size: must be between 16 and"):
        nrs.BuildOptions(texture_size=8)
    with pytest.raises(nrs.ArgumentError, match="rebake: must be"):
        nrs.BuildOptions(rebake="always")
    part = np.zeros(len(stone["faces"]), np.int32)
    with pytest.raises(nrs.ArgumentError, match="face_channels"):
        nrs.NaniteMesh.from_arrays(**stone, face_channels={"part": part}, options=REBAKE)
    with pytest.raises(nrs.ArgumentError, match="face_materials: 70000 leaves no number"):
        nrs.NaniteMesh.from_arrays(**stone, face_materials=part + 70_000, options=REBAKE)
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(nrs.DependencyError, match=r"rebake: xatlas is needed; pip install"):
        nrs.NaniteMesh.from_arrays(**stone, options=REBAKE)


def test_blocks_refuse_it(stone, tmp_path) -> None:
    nrs.NaniteMesh.from_arrays(**stone).cut(error=0.0).export(tmp_path / "x.glb")
    with pytest.raises(nrs.ArgumentError, match='options: rebake="auto" needs all of a mesh in memory'):
        nrs.build_file(tmp_path / "x.glb", tmp_path / "x.nanite", memory="1 MB", options=REBAKE)


def test_a_scan() -> None:
    path = data.require(*FOSSIL)
    mesh = nrs.NaniteMesh.from_file(path, options=nrs.BuildOptions(rebake="auto", texture_size=1024))
    assert mesh.check().clusters == mesh.report.clusters
    assert len(mesh.cut(error=np.inf)) <= 128
    # Where a coarser level is off by a pixel, the whole is of fifteen or fewer.
    fine = [part.triangles for part in mesh.report.rebaked if part.triangles >= 2_500]
    assert len(fine) >= 3
    assert max(flip(mesh, triangles) for triangles in fine) <= 0.06


@pytest.mark.parametrize("charts", [2_025, 2_601])
def test_captures_of_thousands_of_charts(charts) -> None:
    made = capture(120_000, charts, seed=charts)
    look = nrs.Material(
        base_color=(1, 1, 1), metallic=0.0, base_color_texture=nrs.Texture(made.painted(2048, stripes))
    )
    mesh = nrs.NaniteMesh.from_arrays(
        **made.arrays(), materials=look, options=nrs.BuildOptions(rebake="auto")
    )
    assert len(mesh.cut(error=np.inf)) <= 128
    found = {p.triangles: flip(mesh, p.triangles) for p in mesh.report.rebaked if p.triangles >= 64}
    assert max(found.values()) <= 0.06, found
