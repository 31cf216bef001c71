"""`nrs.foliage`: leaves that are holes in images as triangles, against rays and analytic shapes."""

from __future__ import annotations

import itertools
import re
import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter
from scipy.spatial import cKDTree

import nanite_rs as nrs
from nanite_rs import cli
from oracles import camera, cards, data, topology

QUAD = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def quad(image: np.ndarray, uvs: np.ndarray = QUAD, **material: object) -> dict:
    """A square of unit size in the plane z = 0."""
    return {
        "vertices": np.pad(QUAD, [(0, 0), (0, 1)]),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "uvs": np.asarray(uvs, np.float32),
        "materials": cards.leaf_material(image, **material),
    }


def clamped(arrays: dict) -> dict:
    """The same, with an image that goes on as it ends."""
    look = arrays["materials"]
    return {
        **arrays,
        "materials": replace(look, base_color_texture=replace(look.base_color_texture, wrap="clamp")),
    }


def made(arrays: dict, **options: object) -> nrs.foliage.Foliage:
    return nrs.foliage.to_geometry(nrs.io.Source(**_source(arrays)), **options)


def _source(arrays: dict) -> dict:
    looks = arrays["materials"]
    uvs = arrays["uvs"]
    return {
        **arrays,
        "uvs": list(uvs) if isinstance(uvs, list | tuple) else [uvs],
        "materials": looks if isinstance(looks, tuple) else (looks,),
    }


def areas(tree: nrs.foliage.Foliage, number: int | None = None) -> np.ndarray:
    faces = tree.faces if number is None else tree.faces[tree.face_materials == number]
    a, b, c = tree.vertices[faces].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def disc(radius: float, size: int = 64) -> np.ndarray:
    """An image of a disc about its middle, of so many texels, whose edge takes one."""
    y, x = np.mgrid[0:size, 0:size] + 0.5 - size / 2
    image = np.full((size, size, 4), 200, np.uint8)
    image[..., 3] = np.rint(np.clip(radius - np.hypot(x, y) + 0.5, 0, 1) * 255)
    return image


# -------------------------------------------------------------------------------------------------- outlines


@pytest.mark.parametrize("tolerance", [0.0, 0.25, 1.0])
def test_a_disc_has_its_area_and_its_outline(tolerance: float) -> None:
    tree = made(quad(disc(20.0)), tolerance=tolerance)
    (report,) = tree.report.materials
    assert abs(areas(tree).sum() * 64**2 / (np.pi * 400) - 1) < 2e-3
    assert abs(report.area - 1) < 1e-9
    outline = topology_boundary(tree) * 64
    off = np.abs(np.linalg.norm(outline - [32, 32, 0], axis=1) - 20.0)
    # Alpha of the image itself is off the disc by a few hundredths.
    assert off.max() <= report.deviation + 0.05
    assert report.deviation <= 2 * tolerance + 0.2
    assert report.error == pytest.approx(report.deviation / 64)


def topology_boundary(tree: nrs.foliage.Foliage, count: int = 8) -> np.ndarray:
    """Points on edges that have one triangle, (N, 3)."""
    faces = topology.by_position(tree.vertices, tree.faces)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    named, times = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    a, b = tree.vertices[named[times == 1]].swapaxes(0, 1)
    part = ((np.arange(count) + 0.5) / count)[None, :, None]
    return (a[:, None] * (1 - part) + b[:, None] * part).reshape(-1, 3)


def test_fewer_triangles_where_more_may_differ() -> None:
    arrays = quad(cards.leaves(9, 128, seed=3))
    counts = [len(made(arrays, tolerance=t).faces) for t in (0.0, 0.25, 0.5, 1.0, 2.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0] / 8


def test_triangles_of_a_leaf_are_as_many_as_asked_for() -> None:
    image = np.concatenate([np.concatenate([disc(20.0)] * 2, axis=1)] * 2, axis=0)
    tree = made(quad(image), triangles_per_leaf=12)
    (report,) = tree.report.materials
    assert report.outlines == 4
    assert len(tree.faces) <= 4 * 12
    assert report.tolerance > 0.5
    assert abs(areas(tree).sum() * 128**2 / (4 * np.pi * 400) - 1) < 5e-3


def test_parts_and_holes_below_the_tolerance_go_and_leave_their_area() -> None:
    image = disc(24.0)
    image[2:4, 2:4, 3] = 255
    image[30:32, 30:32, 3] = 0
    tree = made(quad(image), tolerance=3.0)
    (report,) = tree.report.materials
    assert (report.outlines, report.dropped) == (1, 2)
    assert report.area == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), tolerance=st.sampled_from([0.0, 0.3, 1.0]), linear=st.booleans())
def test_points_on_the_wrong_side_are_as_near_as_stated(seed: int, tolerance: float, linear: bool) -> None:
    """What is a leaf by SciPy's alpha and not by the triangles, or the other way, lies near an outline."""
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.standard_normal((40, 40)), 2.5, mode="wrap")
    image = np.zeros((40, 40, 4), np.uint8)
    image[..., 3] = np.clip(noise / np.abs(noise).max() * 255 + 127.5, 0, 255)
    look = quad(image)["materials"]
    texture = replace(look.base_color_texture, filter="linear" if linear else "nearest")
    tree = made({**quad(image), "materials": replace(look, base_color_texture=texture)}, tolerance=tolerance)
    (report,) = tree.report.materials
    points = rng.random((4000, 2))
    if linear:
        leaf = cards.bilinear(image[..., 3], points * [1, -1] + [0, 1]) >= 0.5
    else:
        row, column = ((1 - points[:, 1]) * 40).astype(int), (points[:, 0] * 40).astype(int)
        leaf = image[row, column, 3] >= 127.5
    triangles = shapely.union_all(shapely.polygons(tree.vertices[tree.faces][..., :2]))
    inside = shapely.contains_xy(triangles, *points.T)
    wrong = leaf != inside
    # Where an outline leaves the card, the nearest of it may lie beyond the border.
    outlines = shapely.boundary(tree._converted[0].outlines.polygons)
    near = cKDTree(shapely.get_coordinates(shapely.segmentize(outlines, 0.04)))
    # Half of that between samples; a dropped part may lie anywhere, and is smaller than the tolerance's square.
    far = wrong & (near.query(points * [40, -40] + [0, 40])[0] > report.deviation + 0.03)
    assert far.mean() <= report.dropped * max(tolerance, 1e-3) ** 2 * 4 / 1600
    assert wrong.mean() < 0.25


# ----------------------------------------------------------------------------------------------------- cards


@pytest.mark.parametrize("kind", ["bent", "many"])
def test_rays_see_what_they_saw_of_cards(kind: str) -> None:
    arrays = cards.tree(kind, 10)
    tree = made(arrays)
    rng = np.random.default_rng(1)
    for direction in ([0.3, -0.4, -1.0], [1.0, 0.2, 0.1], [-0.5, -1.0, 0.4]):
        d = np.array(direction) / np.linalg.norm(direction)
        side = np.linalg.svd(d[None])[2][1:]
        origins = [0, 1, 0] - 4 * d + rng.uniform(-1.2, 1.2, (6000, 2)) @ side
        before, after = cards.seen(arrays, origins, d), cards.seen(tree.arrays(), origins, d)
        print(kind, direction, before.mean(), after.mean(), (before != after).mean())
        assert 0.05 < before.mean() < 0.9
        assert abs(after.sum() / before.sum() - 1) < 0.02
        assert (before != after).mean() < 0.01


def test_bent_cards_hold_together() -> None:
    """Edges with one triangle are outlines, or the card's own border: none lies where facets meet."""
    points, faces, uvs = cards.card(8, 5, 2.0)
    image = cards.leaves(12, 128, seed=5)
    tree = made({"vertices": points, "faces": faces, "uvs": uvs, "materials": cards.leaf_material(image)})
    names = topology.by_position(tree.vertices, tree.faces)
    edges = np.sort(np.concatenate([names[:, [0, 1]], names[:, [1, 2]], names[:, [2, 0]]]), axis=1)
    _named, first, times = np.unique(edges, axis=0, return_index=True, return_counts=True)
    assert times.max() == 2
    single = first[times == 1]
    corner = np.concatenate([tree.faces[:, [0, 1]], tree.faces[:, [1, 2]], tree.faces[:, [2, 0]]])[single]
    middle = tree.uvs[0][corner].astype(float).mean(axis=1)
    alpha = cards.bilinear(image[..., 3], middle * [1, -1] + [0, 1])
    # A texel from all to nothing: half a texel and the move that keeps the area change alpha by less than 1.
    assert np.abs(alpha - 0.5).max() < 0.5
    assert (np.abs(alpha - 0.5) < 0.3).mean() > 0.9


def test_leaves_lie_on_their_card() -> None:
    points, faces, uvs = cards.card(6, 3, 1.6)
    image = cards.leaves(8, 64)
    tree = made({"vertices": points, "faces": faces, "uvs": uvs, "materials": cards.leaf_material(image)})
    surface = trimesh.Trimesh(points, faces, process=False)
    middle = tree.vertices[tree.faces].mean(axis=1)
    _, off, _ = trimesh.proximity.closest_point(surface, np.concatenate([tree.vertices, middle]))
    assert off.max() < 1e-6


def test_everything_that_cards_carry_is_carried() -> None:
    points, faces, uvs = cards.card(4, 4, 0.0)
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    linear = points @ [[1.0], [2.0], [0.0]]
    arrays = {
        "vertices": points @ turn.T,
        "faces": faces,
        "uvs": [uvs.astype(np.float32), (uvs * 3 + 1).astype(np.float32)],
        "normals": np.broadcast_to(turn[:, 2], points.shape).astype(np.float32),
        "colors": np.rint(100 + 50 * points[:, [0, 1, 1]]).astype(np.uint8),
        "channels": {"x": linear.astype(np.float32), "side": (points[:, 0] > 0).astype(np.int8)},
        "face_channels": {"half": (np.arange(len(faces)) % 16 < 8).astype(np.uint8)},
        "materials": cards.leaf_material(cards.leaves(10, 64)),
    }
    tree = made(arrays)
    flat = tree.vertices @ turn
    assert np.abs(tree.uvs[0] - (flat[:, :2] + [0.5, 0])).max() < 1e-6
    assert np.abs(tree.uvs[1] - (3 * tree.uvs[0] + 1)).max() < 1e-5
    assert np.abs(tree.normals - turn[:, 2]).max() < 1e-6
    assert np.abs(tree.channels["x"] - flat @ [[1.0], [2.0], [0.0]]).max() < 1e-5
    assert np.abs(tree.colors - (100 + 50 * flat[:, [0, 1, 1]])).max() <= 1.01
    assert set(np.unique(tree.channels["side"])) == {0, 1}
    assert tree.channels["side"].dtype == np.int8
    # A face has what the face of the card under its middle has.
    middle = flat[tree.faces].mean(axis=1)[:, :2] + [0.5, 0]
    cell = np.clip((middle * 4).astype(int), 0, 3)
    # Cells come row by row, first the lower triangles of all, then the upper ones.
    assert (tree.face_channels["half"] == (cell[:, 1] * 4 + cell[:, 0] < 8)).all()


@pytest.mark.parametrize("mirrored", [False, True])
def test_leaves_face_where_their_card_does(mirrored: bool) -> None:
    uvs = QUAD * ([-1, 1] if mirrored else [1, 1]) + ([1, 0] if mirrored else [0, 0])
    image = disc(14.0)
    image[:, 40:, 3] = 0
    tree = made(quad(image, uvs))
    a, b, c = tree.vertices[tree.faces].swapaxes(0, 1)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    low, high = tree.vertices[:, 0].min() * 64, tree.vertices[:, 0].max() * 64
    # Cut at column 40 of the image, on its right.
    assert ((low >= 24.0 - 0.6) and high > 45) if mirrored else (low < 19 and high <= 40.6)


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_images_go_on_as_they_are_wrapped(wrap: str) -> None:
    image = disc(10.0)
    image[:, :20, 3] = 0
    arrays = quad(image, QUAD * [3, 1])
    look = arrays["materials"]
    texture = replace(look.base_color_texture, wrap=wrap)
    tree = made({**arrays, "materials": replace(look, base_color_texture=texture)})
    one = areas(made(quad(image))).sum()
    times = 1 if wrap == "clamp" else 3
    assert areas(tree).sum() == pytest.approx(one / 3 * times, rel=0.02)
    assert tree.report.materials[0].outlines == times


def test_an_image_without_filter_has_square_texels() -> None:
    image = np.zeros((8, 8, 4), np.uint8)
    image[2:4, 1:6, 3] = 255
    arrays = quad(image)
    texture = replace(arrays["materials"].base_color_texture, filter="nearest")
    look = replace(arrays["materials"], base_color_texture=texture)
    tree = made({**arrays, "materials": look}, tolerance=0.1)
    low, high = tree.vertices.min(axis=0) * 8, tree.vertices.max(axis=0) * 8
    assert np.abs(low[:2] - [1, 4]).max() < 0.01
    assert np.abs(high[:2] - [6, 6]).max() < 0.01
    assert len(tree.faces) <= 6


def test_places_in_the_image_are_the_textures() -> None:
    """Offset, rotation, scale and the set of UVs, as they are drawn."""
    image = cards.leaves(6, 64, seed=9)
    look = cards.leaf_material(image)
    texture = replace(look.base_color_texture, uv_set=1, offset=(0.2, -0.1), rotation=0.4, scale=(1.3, 0.8))
    arrays = {**quad(image), "materials": replace(look, base_color_texture=texture)}
    arrays["uvs"] = [np.zeros((4, 2), np.float32), QUAD.astype(np.float32)]
    tree = made(arrays)
    pictures = []
    for one in (_source(arrays), tree.arrays()):
        scene = nrs.Scene(ambient_light=(1, 1, 1))
        drawn = {k: v for k, v in one.items() if k not in ("channels", "face_channels")}
        scene.add(nrs.TriangleMesh(**drawn))
        pose = np.eye(4)
        pose[:3, 3] = 0.5, 0.5, 1.0
        with nrs.Renderer(256, 256, backend="cpu") as renderer:
            pictures.append(renderer.render(scene, nrs.OrthographicCamera(0.5, 0.5), pose).depth > 0)
    assert 0.05 < pictures[0].mean() < 0.8
    assert (pictures[0] != pictures[1]).mean() < 0.01


def test_equal_cards_are_cut_once() -> None:
    tree = made(cards.tree("many", 24))
    report = tree.report.materials[1]
    assert (report.cards, report.distinct) == (24, 1)
    bent = made(cards.tree("bent", 24)).report.materials[1]
    assert bent.cards == 24
    # Columns of a bent card are flat: two of them and their mirror images show each of six things.
    assert bent.distinct <= 2 * 6


def test_facets_that_lie_over_themselves_stay_apart() -> None:
    """Two triangles with the same part of the image, side by side."""
    arrays = quad(disc(20.0), np.array([[0, 0], [1, 0], [1, 1], [1, 0]], float))
    tree = made(arrays)
    assert areas(tree).sum() == pytest.approx(np.pi * 400 / 64**2, rel=0.01)


# --------------------------------------------------------------------------------------- which are leaves


def test_what_is_a_leaf_is_found() -> None:
    full = np.full((8, 8, 4), 255, np.uint8)
    holes = disc(3.0, 8)
    looks = {
        "opaque": cards.leaf_material(holes, alpha_mode="opaque"),
        "mask": cards.leaf_material(holes, alpha_mode="mask"),
        "blend": cards.leaf_material(holes, alpha_mode="blend"),
        "full": cards.leaf_material(full, alpha_mode="mask"),
        "grey": nrs.Material(alpha_mode="blend", base_color=(1, 1, 1, 0.5)),
    }
    one = quad(holes)
    arrays = {
        "vertices": np.concatenate([one["vertices"] + [0, 0, k] for k in range(5)]),
        "faces": np.concatenate([one["faces"] + 4 * k for k in range(5)]),
        "uvs": np.concatenate([one["uvs"]] * 5),
        "face_materials": np.repeat(np.arange(5), 2),
        "materials": tuple(replace(look, name=name) for name, look in looks.items()),
    }
    tree = made(arrays)
    found = {row.name: row.leaf for row in tree.report.materials}
    assert found == {"opaque": False, "mask": True, "blend": True, "full": False, "grey": False}
    assert all(row.before == row.after == 2 for row in tree.report.materials if not row.leaf)
    named = made(arrays, leaf_materials=["opaque"])
    assert [row.name for row in named.report.materials if row.leaf] == ["opaque"]
    assert named.materials[0].alpha_mode == "opaque"
    assert named.materials[1] == looks["mask"]
    text = str(tree.report)
    assert "leaves (mask, " in text
    assert "trunk (opaque)" in text
    assert text.splitlines()[0].split()[0] == "material"
    assert "<table>" in tree.report._repr_html_()


def test_the_cutoff_is_the_materials_or_the_callers() -> None:
    ramp = np.zeros((16, 16, 4), np.uint8)
    ramp[..., 3] = np.linspace(0, 255, 16).astype(np.uint8)

    def width(cutoff: float | None = None, **options: object) -> float:
        return areas(made(clamped(quad(ramp, **options)), cutoff=cutoff)).sum() * 16

    # Alpha is k / 15 in the middle of column k.
    assert width(alpha_cutoff=0.2) == pytest.approx(16 - 3.5, abs=0.05)
    assert width(alpha_cutoff=0.2, cutoff=0.6) == pytest.approx(16 - 9.5, abs=0.05)
    assert width(alpha_mode="blend") == pytest.approx(16 - 8, abs=0.05)


def test_alpha_of_the_material_counts() -> None:
    ramp = np.zeros((16, 16, 4), np.uint8)
    ramp[..., 3] = np.linspace(0, 255, 16).astype(np.uint8)
    arrays = clamped(quad(ramp))
    faint = replace(arrays["materials"], base_color=(1, 1, 1, 0.75))
    tree = made({**arrays, "materials": faint})
    assert areas(tree).sum() * 16 == pytest.approx(16 - 10.5, abs=0.05)
    assert tree.materials[0].base_color == (1.0, 1.0, 1.0)
    with pytest.raises(nrs.ArgumentError, match="nothing is seen of it"):
        made({**arrays, "materials": replace(faint, base_color=(1, 1, 1, 0.25))})


def test_colours_go_on_beyond_outlines() -> None:
    image = disc(20.0)
    image[..., :3] = np.where(image[..., 3:] >= 128, [50, 150, 60], [0, 0, 0])
    colors = made(quad(image)).materials[0].base_color_texture.image.pixels
    assert colors.shape == (64, 64, 3)
    assert np.abs(colors.astype(int) - [50, 150, 60]).max() <= 1


# ------------------------------------------------------------------------------------------------- sources


def test_every_kind_of_source_gives_the_same(tmp_path) -> None:
    arrays = _source(cards.tree("bent", 6))
    want = made(arrays)
    mesh = nrs.NaniteMesh.from_arrays(**arrays, progress=False)
    drawn = nrs.TriangleMesh(**arrays)
    scene = nrs.Scene()
    scene.add(mesh)
    file = tmp_path / "tree.glb"
    scene.export(file)
    for source in (
        mesh,
        drawn,
        scene,
        nrs.load_scene(file),
        file,
        str(file),
        file.read_bytes(),
        trimesh.load(file),
    ):
        tree = nrs.foliage.to_geometry(source)
        assert areas(tree).sum() == pytest.approx(areas(want).sum(), rel=1e-4), type(source)
        leaves = [row for row in tree.report.materials if row.leaf]
        assert [(row.name, row.cards) for row in leaves] == [("leaves", 6)], type(source)


def test_materials_without_an_image_are_given_one(tmp_path) -> None:
    """OBJ from stores: equal materials that differ in their names alone."""
    Image.fromarray(disc(20.0)).save(tmp_path / "leaf.png")
    (tmp_path / "tree.mtl").write_text("newmtl bark\nKd 0.6 0.6 0.6\nnewmtl leaf\nKd 0.6 0.6 0.6\n")
    (tmp_path / "tree.obj").write_text(
        "mtllib tree.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl leaf\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nusemtl bark\nf 5/1 6/2 7/3\n"
    )
    obj = str(tmp_path / "tree.obj")
    with pytest.raises(nrs.ArgumentError, match=r"no material is one of leaves .*textures="):
        nrs.foliage.to_geometry(obj)
    tree = nrs.foliage.to_geometry(obj, textures={"leaf": str(tmp_path / "leaf.png")})
    leaf = next(k for k, row in enumerate(tree.report.materials) if row.leaf)
    assert tree.report.materials[leaf].name == "leaf"
    assert areas(tree, leaf).sum() == pytest.approx(np.pi * 400 / 64**2, rel=0.01)
    assert tree.materials[leaf].double_sided
    assert len(tree.faces) - (tree.face_materials == leaf).sum() == 1


# ---------------------------------------------------------------------------------------------------- wind


def test_wind_knows_where_cards_hang() -> None:
    arrays = cards.tree("bent", 8)
    tree = made(arrays, wind=True)
    branch, pivot, phase = (tree.channels[f"wind_{name}"] for name in ("branch", "pivot", "phase"))
    points, trunk = arrays["vertices"], arrays["faces"][arrays["face_materials"] == 0]
    surface = trimesh.Trimesh(points, trunk, process=False)
    own = np.split(np.arange(18, len(points)), 8)
    for number in range(1, 9):
        rows = branch == number
        assert rows.any()
        assert (pivot[rows] == pivot[rows][0]).all()
        assert (phase[rows] == phase[rows][0]).all()
        _, away, _ = trimesh.proximity.closest_point(surface, points[own[number - 1]])
        nearest = points[own[number - 1]][np.argmin(away)]
        # Several corners may be as near.
        _, least, _ = trimesh.proximity.closest_point(surface, pivot[rows][:1].astype(float))
        assert least[0] == pytest.approx(away.min(), abs=1e-6), nearest
    still = np.unique(tree.faces[tree.face_materials == 0])
    assert (branch[still] == 0).all()
    assert (phase[still] == 0).all()
    assert np.abs(pivot[still]).max() < 1e-6
    assert len(np.unique(phase)) == 9
    mesh = tree.build(options=nrs.BuildOptions(preserve_area=True, error="quadric"), progress=False)
    cut = mesh.cut(target_faces=200)
    assert set(np.unique(cut.channels["wind_branch"])) <= set(range(9))


def test_leaves_alone_hang_at_their_lowest() -> None:
    tree = made(quad(disc(20.0)), wind=True, up="x")
    assert np.abs(tree.channels["wind_pivot"][:, 0]).max() == 0.0


# --------------------------------------------------------------------------------------------------- builds


@pytest.mark.parametrize("kind", ["bent", "many"])
def test_levels_cover_what_leaves_do(kind: str) -> None:
    tree = made(cards.tree(kind, 16), tolerance=1.0)
    mesh = tree.build(progress=False)
    mesh.check()
    both = np.concatenate([tree.faces, tree.faces[:, ::-1]])
    options = nrs.BuildOptions(error="quadric")
    full = nrs.NaniteMesh.from_arrays(tree.vertices, both, options=options, progress=False)
    for part in (0.5, 0.2):
        cut = mesh.cut(target_faces=int(part * len(tree.faces)))
        both = np.concatenate([cut.faces, cut.faces[:, ::-1]])
        less = nrs.NaniteMesh.from_arrays(cut.vertices, both, options=options, progress=False)
        ratio = [_covered(less, d) / _covered(full, d) for d in np.eye(3) + 0.2]
        assert abs(np.mean(ratio) - 1) < 0.05, (part, ratio)


def _covered(mesh: nrs.NaniteMesh, direction: np.ndarray) -> int:
    scene = nrs.Scene()
    scene.add(mesh)
    pose = nrs.look_at([0, 1, 0] + 4 * direction, (0, 1, 0), (0.1, 1.0, 0.2))
    with nrs.Renderer(256, 256, backend="cpu") as renderer:
        frame = renderer.render(scene, nrs.OrthographicCamera(1.3, 1.3), pose, pixel_error=0.0)
    return int((frame.depth > 0).sum())


REAL = {
    "town_tree_cards/scene.gltf": None,
    "GlassVaseFlowers/GlassVaseFlowers.glb": None,
    "quaternius_birch_8_cards/OBJ/Birch_8.obj": ("Birch_Leaves", "Birch_Leaves_Green.png"),
    "quaternius_tree_3_cards/OBJ/Tree_3.obj": ("Tree_Leaves", "Tree_Leaves.png"),
    "quaternius_pine_1_cards/OBJ/Pine_1.obj": ("Pine_Leaves", "Pine_Leaves.png"),
}


@pytest.mark.filterwarnings("ignore:.*not everything is kept")
@pytest.mark.parametrize("name", REAL, ids=lambda name: name.split("/")[0])
def test_real_trees_cover_what_their_cards_did(name: str, soak: bool) -> None:
    """The alpha-tested original at 1,000 pixels: coverage within 2 %, outlines within a pixel in 98 % of theirs."""
    path = data.require("foliage", *name.split("/"))
    given = REAL[name]
    textures = None if given is None else {given[0]: path.parents[1] / "Textures" / given[1]}
    tree = nrs.foliage.to_geometry(path, textures=textures)
    source = tree._source
    # At its finest level, as rays through pixels see it.
    looks = tuple(
        replace(
            look,
            alpha_mode="mask",
            alpha_cutoff=0.5 if look.alpha_mode == "blend" else look.alpha_cutoff,
            base_color_texture=replace(look.base_color_texture, mipmaps=None),
        )
        if row.leaf
        else look
        for look, row in zip(source.materials, tree.report.materials, strict=True)
    )
    used = source.vertices[np.unique(source.faces)]
    center, diagonal = (used.min(0) + used.max(0)) / 2, float(np.linalg.norm(np.ptp(used, axis=0)))
    lens = nrs.OrthographicCamera(0.55 * diagonal, 0.55 * diagonal, znear=0.01 * diagonal)
    count = 24 if soak else 6
    seen = []
    for arrays in ({**source.arrays(), "materials": looks}, tree.arrays()):
        drawn = {k: v for k, v in arrays.items() if k not in ("channels", "face_channels")}
        scene = nrs.Scene()
        scene.add(nrs.TriangleMesh(**drawn))
        with nrs.Renderer(1000, 1000, backend="cpu") as renderer:
            poses = [
                nrs.look_at(center + 2 * diagonal * d, center, (0.1, 1.0, 0.2)) for d in camera.spread(count)
            ]
            seen.append([renderer.render(scene, lens, pose, depth_only=True).depth > 0 for pose in poses])
    for before, after in zip(*seen, strict=True):
        assert abs(after.sum() / before.sum() - 1) < 0.02
        assert outlines_within_a_pixel(before, after) >= 0.98


def outlines_within_a_pixel(one: np.ndarray, other: np.ndarray) -> float:
    """The part of the outline pixels of either that has one of the other's at most a pixel away."""
    edges = [image & ~binary_erosion(image) for image in (one, other)]
    near = [binary_dilation(edge, np.ones((3, 3))) for edge in edges]
    met = (edges[0] & near[1]).sum() + (edges[1] & near[0]).sum()
    return met / (edges[0].sum() + edges[1].sum())


# --------------------------------------------------------------------------------------------- command line


@pytest.fixture
def glb(tmp_path) -> str:
    scene = nrs.Scene()
    scene.add(nrs.TriangleMesh(**_source(cards.tree("bent", 4))))
    path = tmp_path / "trees" / "birch.glb"
    path.parent.mkdir()
    scene.export(path)
    return str(path)


def test_the_command_builds_a_tree(glb: str, tmp_path, capsys) -> None:
    output = tmp_path / "birch.nanite"
    call = ["foliage", glb, "-o", str(output), "--tolerance", "1", "--wind", "--preview", str(tmp_path / "p")]
    assert cli.main(call) == 0
    said = capsys.readouterr().out
    assert "leaves (mask" in said
    mesh = nrs.NaniteMesh.open(output)
    mesh.check()
    assert "wind_phase" in mesh.info["channels"]
    assert len(mesh) == len(nrs.foliage.to_geometry(glb, tolerance=1.0).faces)
    pictures = {path.stem: np.asarray(Image.open(path)) for path in (tmp_path / "p").iterdir()}
    assert set(pictures) == {"cards", "geometry", "triangles", "outline_leaves"}
    off = np.abs(pictures["cards"].astype(float) - pictures["geometry"])
    assert off.mean() < 2.0
    assert pictures["cards"].std() > 5.0
    assert (pictures["outline_leaves"] == [255, 0, 128]).all(axis=2).sum() > 300


def test_the_command_builds_folders_with_settings(glb: str, tmp_path, capsys) -> None:
    folder = tmp_path / "trees"
    (folder / "broken.glb").write_bytes(b"glTF")
    (folder / "notes.txt").write_text("no mesh")
    settings_file = tmp_path / "trees.toml"
    settings_file.write_text('tolerance = 4.0\nwind = true\n[files."bir*.glb"]\ntolerance = 1.0\n')
    output = tmp_path / "built"
    call = ["foliage", str(folder), "-o", str(output), "--config", str(settings_file)]
    assert cli.main(call) == 1
    assert "broken.glb: failed: " in capsys.readouterr().err
    mesh = nrs.NaniteMesh.open(output / "birch.nanite")
    assert "wind_phase" in mesh.info["channels"]
    assert len(mesh) == len(nrs.foliage.to_geometry(glb, tolerance=1.0).faces)
    assert [path.name for path in output.iterdir()] == ["birch.nanite"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tolerance = ", "no TOML: "),
        ("tolerances = 1", "there is no setting tolerances"),
        ('[files."a*"]\nsize = 1', r'there is no setting files\."a\*"\.size'),
        ("files = 3", "files: expected tables"),
        ('tolerance = "fine"', "tolerance: expected a number"),
        ("leaf_materials = 3", "leaf_materials: expected 'auto' or names"),
        ("textures = 3", "textures: expected"),
    ],
)
def test_faults_of_settings_are_named(glb: str, tmp_path, capsys, text: str, message: str) -> None:
    path = tmp_path / "trees.toml"
    path.write_text(text)
    assert cli.main(["foliage", glb, "-o", str(tmp_path / "x.nanite"), "--config", str(path)]) == 1
    said = capsys.readouterr().err
    assert re.search(message, said), said
    assert not (tmp_path / "x.nanite").exists()


def test_faults_of_the_command_are_named(glb: str, tmp_path, capsys) -> None:
    for call, message in {
        ("-o", "x.glb"): "the output must end in .nanite",
        ("--texture", "leaf.png"): "--texture: expected MATERIAL=FILE",
        ("--leaf-material", "leafs"): "there is no material 'leafs'; there are bark, leaves",
        ("--config", "absent.toml"): "absent.toml",
    }.items():
        assert cli.main(["foliage", glb, *call]) == 1
        assert message in capsys.readouterr().err
    empty = tmp_path / "empty"
    empty.mkdir()
    assert cli.main(["foliage", str(empty)]) == 1
    assert "there is no mesh in it" in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"leaf_materials": "leaves"}, nrs.ArgumentError, "leaf_materials: must be 'auto' or a list"),
        ({"leaf_materials": []}, nrs.ArgumentError, "leaf_materials: names at least one"),
        ({"leaf_materials": ["no"]}, nrs.ArgumentError, r"leaf_materials\[0\]: there is no material 'no'"),
        ({"leaf_materials": [3]}, nrs.DtypeError, r"leaf_materials\[0\]: expected a name, not int"),
        ({"leaf_materials": 3}, nrs.DtypeError, "leaf_materials: expected"),
        ({"cutoff": 0.0}, nrs.ArgumentError, "cutoff: must be above 0"),
        ({"cutoff": 1.5}, nrs.ArgumentError, "cutoff: must be between 0 and 1"),
        ({"cutoff": np.nan}, nrs.ArgumentError, "cutoff"),
        ({"tolerance": -1.0}, nrs.ArgumentError, "tolerance: must be 0 to 64, not -1"),
        ({"tolerance": np.inf}, nrs.ArgumentError, "tolerance: must be finite"),
        ({"tolerance": "1"}, nrs.DtypeError, "tolerance: expected a number"),
        ({"triangles_per_leaf": 0}, nrs.ArgumentError, "triangles_per_leaf: must be 1 or more"),
        ({"textures": {"no": disc(2.0, 8)}}, nrs.ArgumentError, "textures: there is no material 'no'"),
        ({"textures": 3}, nrs.DtypeError, "textures: expected"),
        ({"textures": {"leaves": 3}}, nrs.DtypeError, r"textures\['leaves'\]"),
        ({"textures": {"leaves": disc(2.0, 8)[..., :3]}}, nrs.ArgumentError, "its image has no alpha"),
        ({"up": "w"}, nrs.ArgumentError, "up: must be"),
        ({"wind": 1}, nrs.DtypeError, "wind: expected True or False"),
    ],
)
def test_faults_are_named(options: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        made(quad(disc(20.0)), **options)


def test_sources_that_are_none_are_refused() -> None:
    with pytest.raises(nrs.DtypeError, match="source: expected"):
        nrs.foliage.to_geometry(3)
    with pytest.raises(nrs.ArgumentError, match="source: the scene shows no mesh"):
        nrs.foliage.to_geometry(nrs.Scene())
    with pytest.raises(nrs.ArgumentError, match="no material is one of leaves"):
        nrs.foliage.to_geometry(trimesh.creation.box())
    with pytest.raises(nrs.DtypeError, match="options"):
        made(quad(disc(20.0))).build(options=3)


def test_places_that_are_none_are_named() -> None:
    whole = _source(quad(disc(20.0)))
    for bad in (np.nan, np.inf, -np.inf):
        vertices, uvs = whole["vertices"].copy(), whole["uvs"][0].copy()
        vertices[2, 1] = uvs[3, 0] = bad
        with pytest.raises(nrs.MeshError, match=r"source: vertices\[2\]: must be finite"):
            made({**whole, "vertices": vertices})
        with pytest.raises(nrs.MeshError, match=r"source: uvs\[0\]\[3\]: must be finite"):
            made({**whole, "uvs": [uvs]})
    for bad in (-1, 4):
        with pytest.raises(nrs.MeshError, match=r"source: faces\[1\]: refers to"):
            made({**whole, "faces": np.array([[0, 1, 2], [0, 2, bad]])})


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e30])
def test_the_size_of_a_tree_does_not_matter(scale: float) -> None:
    arrays = cards.tree("bent", 3)
    one, other = made(arrays), made({**arrays, "vertices": arrays["vertices"] * scale})
    assert np.array_equal(one.faces, other.faces)
    assert np.abs(other.vertices / scale - one.vertices).max() < 1e-12
    assert other.report.error == pytest.approx(one.report.error * scale)


def test_cards_that_show_nothing_are_named() -> None:
    corner = quad(disc(10.0), QUAD * 0.1)
    with pytest.raises(nrs.ArgumentError, match="leaves: its cards show nothing above the cutoff"):
        made(corner)
    without = _source(quad(disc(10.0)))
    with pytest.raises(nrs.ArgumentError, match="uvs: the leaves of leaves have no texture coordinates"):
        made({**without, "uvs": []}, leaf_materials=["leaves"])
    with pytest.raises(nrs.ArgumentError, match="uvs: leaves of one image reach over"):
        made(quad(disc(10.0), QUAD * 1000))


def test_faces_without_area_in_the_image_show_nothing() -> None:
    arrays = quad(disc(20.0))
    arrays["faces"] = np.concatenate([arrays["faces"], [[0, 1, 1], [0, 0, 0]]])
    assert areas(made(arrays)).sum() == pytest.approx(np.pi * 400 / 64**2, rel=0.01)


def test_packages_that_are_missing_are_named(monkeypatch) -> None:
    for package in ("shapely", "contourpy"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            with pytest.raises(nrs.DependencyError, match=f"foliage: {package} is needed; pip install"):
                made(quad(disc(20.0)))


def test_the_same_comes_of_the_same() -> None:
    one, other = (made(cards.tree("bent", 6), wind=True) for _ in range(2))
    for a, b in itertools.zip_longest(_all(one), _all(other)):
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()


def _all(tree: nrs.foliage.Foliage) -> list[np.ndarray]:
    return [tree.vertices, tree.faces, *tree.uvs, *tree.channels.values(), tree.face_materials]
