"""``to_3dtiles``: proven errors, tiles that meet, and places on the globe."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import nanite_rs as nrs
from nanite_rs import cli
from nanite_rs._tiles.write import MOST_ROWS
from oracles import data, distance, tiles
from test_export import source

FAST = nrs.BuildOptions(quality="fast")
EXACT = {"compression": None, "skirts": False}


def bumpy(faces: int = 40_000, **more) -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=faces), options=FAST, **more)


def contents(found: list[tiles.Tile]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [tile.surface() for tile in found if tile.file is not None]


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("compression", [None, "quantized", "meshopt", "meshopt-khr"])
def test_a_tileset_is_what_it_says(compression, tmp_path) -> None:
    mesh = bumpy()
    report = mesh.to_3dtiles(tmp_path / "t", triangles=4_000, compression=compression, skirts=False)
    root = tiles.opened(report.path)
    found = tiles.every(root)
    assert report.tiles == len(found) > 12
    assert report.levels >= 3
    assert report.triangles == sum(tile.properties["triangles"] for tile in found)
    assert report.bytes == sum(tile.file.stat().st_size for tile in found)
    low, high = mesh.bounds
    assert json.loads(Path(report.path).read_text())["geometricError"] >= np.linalg.norm(high - low) * 0.99
    original = mesh.cut(error=0.0)
    for tile in found:
        vertices, faces = tile.surface()
        assert len(faces) == tile.properties["triangles"] <= 8_000
        # Its box holds it, and that of what it is part of.
        corners = tile.corners()
        assert (vertices >= corners.min(axis=0)).all()
        assert (vertices <= corners.max(axis=0)).all()
        for child in tile.children:
            inner = child.corners()
            assert (inner >= corners.min(axis=0) - 1e-9).all()
            assert (inner <= corners.max(axis=0) + 1e-9).all()
            assert child.error <= tile.error
        # Measured by libigl, from points of the tile to the source.
        points = np.concatenate([vertices, distance.samples(vertices, faces, 500)])
        far = distance.to_surface(points, original.vertices.astype(np.float64), original.faces)
        assert far.max() <= tile.properties["bound"] <= tile.error
    whole = contents(tiles.front(root, found[-1].error))
    parts = sum(area(*surface) for surface in whole)
    assert parts == pytest.approx(area(original.vertices.astype(np.float64), original.faces), rel=1e-3)


def test_points_of_the_source_are_near_what_stands(tmp_path) -> None:
    mesh = bumpy()
    root = tiles.opened(mesh.to_3dtiles(tmp_path / "t", triangles=3_000, skirts=False).path)
    original = mesh.cut(error=0.0)
    points = distance.samples(original.vertices.astype(np.float64), original.faces, 3_000)
    errors = sorted({tile.error for tile in tiles.every(root)})
    for error in errors[:: max(len(errors) // 4, 1)]:
        stands = tiles.front(root, error)
        parts = contents(stands)
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
        vertices = np.concatenate([part[0] for part in parts])
        faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
        assert distance.to_surface(points, vertices, faces).max() <= max(tile.error for tile in stands)


@pytest.mark.parametrize("compression", [None, "meshopt"])
def test_tiles_of_a_level_meet(compression, tmp_path) -> None:
    """On every level: where one tile ends another begins, with the same vertices."""
    how = {"compression": compression, "skirts": False}
    root = tiles.opened(bumpy().to_3dtiles(tmp_path / "t", triangles=2_500, **how).path)
    by_level: dict[int, list[tiles.Tile]] = {}
    for tile in tiles.every(root):
        by_level.setdefault(tile.properties["level"], []).append(tile)
    assert len(by_level) >= 3
    for level, own in by_level.items():
        edges: dict[tuple, int] = {}
        for vertices, faces in contents(own):
            corners = np.round(vertices * 2.0**40).astype(np.int64)[faces]
            for k in range(3):
                for a, b in zip(corners[:, k].tolist(), corners[:, (k + 1) % 3].tolist(), strict=True):
                    if a != b:
                        edges[(*a, *b)] = edges.get((*a, *b), 0) + 1
        open_edges = sum(edges.get((*edge[3:], *edge[:3])) != count for edge, count in edges.items())
        # Some tiles stand for several levels; elsewhere the surface is closed.
        if sum(tile.properties["triangles"] for tile in own) > 0.9 * max(
            sum(tile.properties["triangles"] for tile in tiles.front(root, t.error)) for t in own
        ):
            assert open_edges == 0, level


def test_skirts_hang_as_far_as_they_say(tmp_path) -> None:
    mesh = bumpy()
    chosen = {"triangles": 4_000, "compression": None}
    bare = tiles.every(tiles.opened(mesh.to_3dtiles(tmp_path / "a", skirts=False, **chosen).path))
    skirted = tiles.every(tiles.opened(mesh.to_3dtiles(tmp_path / "b", **chosen).path))
    assert len(bare) == len(skirted)
    longest = 0.0
    for one, other in zip(bare, skirted, strict=True):
        assert one.properties["skirt"] == 0.0
        length = other.properties["skirt"]
        assert length >= other.properties["bound"]
        (vertices, faces), (more, all_faces) = one.surface(), other.surface()
        assert other.properties["triangles"] == len(faces)
        if len(all_faces) == len(faces):
            continue
        far = distance.to_surface(more, vertices, faces)
        assert far.max() <= length + 1e-6  # positions are rounded
        longest = max(longest, far.max() / length)
        # They hang inwards: the sphere is around the origin.
        below = more[far > length / 2]
        assert (np.linalg.norm(below, axis=1) < np.linalg.norm(vertices, axis=1).max()).all()
    assert longest > 0.9


def test_workers_and_files_change_nothing(tmp_path) -> None:
    mesh = bumpy()
    mesh.save(tmp_path / "m.nanite")
    opened = nrs.NaniteMesh.open(tmp_path / "m.nanite")
    written = []
    for k, (one, workers) in enumerate(
        [(opened, 1), (opened, 4), (nrs.NaniteMesh.open(tmp_path / "m.nanite"), 3)]
    ):
        one.to_3dtiles(tmp_path / str(k), triangles=3_000, workers=workers)
        root = tmp_path / str(k)
        written.append({str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()})
    assert written[0] == written[1] == written[2]
    # Opened files are read tile by tile.
    assert opened.nbytes < mesh.nbytes / 2


def test_all_that_a_mesh_carries(tmp_path) -> None:
    mesh = source()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = mesh.to_3dtiles(tmp_path / "t", triangles=256, up="y", **EXACT)
    leaves = [tile for tile in tiles.every(tiles.opened(report.path)) if not tile.children]
    cut = mesh.cut(error=0.0)
    heat = part = 0
    for tile in leaves:
        own = tile.source()
        assert {"_heat", "_part"} <= set(own.channels)
        assert own.colors is not None
        assert len(own.uvs) == 2
        # y stays up in what glTF holds: values at vertices that the source has are those of the source.
        vertices = tile.surface()[0] @ tiles.TURN[:3, :3]
        near = np.linalg.norm(vertices[:, None] - cut.vertices[None].astype(np.float64), axis=2)
        at = near.argmin(axis=1)
        same = near.min(axis=1) < 1e-6
        assert same.mean() > 0.5
        assert np.abs(own.channels["_heat"] - vertices[:, 0]).max() < 0.05
        heat += np.abs(own.channels["_heat"][same] - cut.vertices[at[same], 0]).max() < 1e-5
        part += np.isin(own.channels["_part"], (0, 1)).all()
    assert heat == part == len(leaves)
    assert {look.double_sided for tile in leaves for look in tile.source().materials} == {True, False}


def test_images_are_those_of_the_tile(tmp_path) -> None:
    """A sheet of squares whose charts lie anywhere in the atlas: pictures of tiles are those of the sheet."""
    rng = np.random.default_rng(5)
    side, cells = 8, 6
    where = rng.permutation(side * side)
    vertices, uvs, faces = [], [], []
    steps = np.stack(np.meshgrid(np.arange(cells + 1), np.arange(cells + 1), indexing="ij"), axis=-1)
    steps = steps.reshape(-1, 2) / cells
    cell = np.arange(cells * (cells + 1)).reshape(cells, -1)[:, :-1].reshape(-1)
    square = np.concatenate(
        [
            np.stack([cell, cell + cells + 1, cell + 1], 1),
            np.stack([cell + 1, cell + cells + 1, cell + cells + 2], 1),
        ]
    )
    for k in range(side * side):
        corner = np.array([k % side, k // side])
        chart = np.array([where[k] % side, where[k] // side])
        faces.append(square + len(steps) * k)
        height = 0.02 * np.sin(9.0 * (steps[:, 0] + corner[0])) * np.cos(7.0 * (steps[:, 1] + corner[1]))
        vertices.append(np.column_stack([corner + steps, height]))
        uvs.append((chart + 0.1 + 0.8 * steps) / side)
    pixels = np.kron(rng.integers(30, 226, (64, 64, 3), dtype=np.uint8), np.ones((8, 8, 1), np.uint8))
    look = nrs.Material(base_color_texture=nrs.Texture(nrs.Image(pixels)), unlit=True)
    mesh = nrs.NaniteMesh.from_arrays(
        np.concatenate(vertices).astype(np.float32),
        np.concatenate(faces),
        uvs=np.concatenate(uvs).astype(np.float32),
        materials=look,
        options=FAST,
    )
    report = mesh.to_3dtiles(tmp_path / "t", triangles=600, up="z", skirts=False)
    leaves = [tile for tile in tiles.every(tiles.opened(report.path)) if not tile.children]
    assert len(leaves) >= 8
    pose = np.eye(4)
    pose[:3, 3] = 4.0, 4.0, 10.0
    camera = nrs.OrthographicCamera(xmag=4.2, ymag=4.2)

    def picture(scene: nrs.Scene) -> np.ndarray:
        return nrs.Renderer(256, 256, backend="cpu").render(scene, camera, pose, outputs=["color"]).color

    whole, parts = nrs.Scene(), nrs.Scene()
    whole.add(mesh)
    sizes = []
    for tile in leaves:
        loaded = nrs.load_scene(tile.file)
        for node in loaded.scene.instances:
            parts.add(node.mesh, pose=tile.pose @ tiles.TURN @ node.pose, material=node.material)
            sizes.append(np.prod(node.material.base_color_texture.image.size))
    # An eighth of the charts each, or less.
    assert max(sizes) < 512 * 512 / 4
    a, b = picture(whole).astype(int), picture(parts).astype(int)
    assert np.abs(a - b).max(axis=2).mean() < 1.0
    assert (np.abs(a - b).max(axis=2) > 24).mean() < 0.004


def terrain(size: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """Hills of 30 by 30 km near Innsbruck, in UTM."""
    x, y = np.meshgrid(np.linspace(0, 30_000, size), np.linspace(0, 30_000, size), indexing="ij")
    z = 1_500 + 700 * np.sin(x / 2_500) * np.cos(y / 3_100)
    vertices = np.stack([x + 670_000.125, y + 5_230_000.5, z], axis=-1).reshape(-1, 3)
    corner = np.arange(size * (size - 1)).reshape(size - 1, size)[:, :-1].reshape(-1)
    faces = np.concatenate(
        [
            np.stack([corner, corner + size, corner + 1], 1),
            np.stack([corner + 1, corner + size, corner + size + 1], 1),
        ]
    )
    return vertices, faces


def test_reference_systems(tmp_path) -> None:
    pyproj = pytest.importorskip("pyproj")
    vertices, faces = terrain()
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=FAST)
    report = mesh.to_3dtiles(tmp_path / "t", triangles=3_000, crs="EPSG:32632", compression=None)
    root = tiles.opened(report.path)
    there = pyproj.Transformer.from_crs("EPSG:32632", "EPSG:4978", always_xy=True)
    angles = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
    globe = np.stack(there.transform(*vertices.T), axis=1)
    # Somewhat finer than the mesh, whose triangles are straight in UTM.
    fine = distance.samples(vertices, faces, 4_000)
    fine = np.stack(there.transform(*fine.T), axis=1)
    middle = globe.mean(axis=0)
    for tile in tiles.every(root):
        own, corners = tile.surface()
        # Heights are upwards, and faces look there.
        a, b, c = (own[corners[: tile.properties["triangles"], k]] for k in range(3))
        assert (np.cross(b - a, c - a) @ (middle / np.linalg.norm(middle)) > 0.0).mean() > 0.9
        west, south, east, north, low, high = tile.row["boundingVolume"]["region"]
        longitude, latitude, height = angles.transform(*own.T)
        assert west <= np.radians(longitude).min()
        assert np.radians(longitude).max() <= east
        assert south <= np.radians(latitude).min()
        assert np.radians(latitude).max() <= north
        assert low <= height.min()
        assert height.max() <= high
        for child in tile.children:
            assert child.error <= tile.error
    for error in (root.error, 0.0):
        parts = contents(tiles.front(root, error))
        starts = np.cumsum([0, *(len(part[0]) for part in parts)])
        all_vertices = np.concatenate([part[0] for part in parts]) - middle
        all_faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
        bound = max(tile.properties["bound"] for tile in tiles.front(root, error))
        assert distance.to_surface(fine - middle, all_vertices, all_faces).max() <= bound
    with pytest.raises(nrs.ArgumentError, match="has angles"):
        mesh.to_3dtiles(tmp_path / "u", crs="EPSG:4326")
    with pytest.raises(nrs.ArgumentError, match="crs:"):
        mesh.to_3dtiles(tmp_path / "u", crs="EPSG:99999999")
    with pytest.raises(nrs.ArgumentError, match="up"):
        mesh.to_3dtiles(tmp_path / "u", crs="EPSG:32632", up="y")


def test_tiles_across_the_antimeridian_have_boxes(tmp_path) -> None:
    pytest.importorskip("pyproj")
    vertices, faces = terrain(60)
    # Zone 60 ends at 180 degrees: half of this lies beyond.
    mesh = nrs.NaniteMesh.from_arrays(
        vertices + np.array([833_978.6 - 685_000.0, -5_230_000.0, 0.0]), faces, options=FAST
    )
    root = tiles.opened(mesh.to_3dtiles(tmp_path / "t", triangles=1_000, crs="EPSG:32660").path)
    kinds = [next(iter(tile.row["boundingVolume"])) for tile in tiles.every(root)]
    assert kinds[0] == "box"
    assert set(kinds) == {"box", "region"}
    for tile in tiles.every(root):
        if "box" in tile.row["boundingVolume"]:
            corners, (vertices, _) = tile.corners(), tile.surface()
            assert (vertices >= corners.min(axis=0) - 1e-6).all()
            assert (vertices <= corners.max(axis=0) + 1e-6).all()


def test_large_coordinates_keep_their_digits(tmp_path) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000)
    shift = np.array([4_500_000.25, 5_400_000.5, 300.0])
    mesh = nrs.NaniteMesh.from_arrays(vertices.astype(np.float64) + shift, faces, options=FAST)
    report = mesh.to_3dtiles(tmp_path / "t", triangles=2_000, **EXACT)
    leaves = [tile for tile in tiles.every(tiles.opened(report.path)) if not tile.children]
    for tile in leaves:
        own, _ = tile.surface()
        far = distance.to_surface(own - shift, vertices.astype(np.float64), faces)
        assert far.max() <= tile.properties["bound"] < 1e-5
        # The origin is in the transform: what the file holds is small.
        assert np.abs(tile.source().vertices).max() < 4.0


def test_scenes_write_a_mesh_once(tmp_path) -> None:
    mesh, scene = bumpy(8_000), nrs.Scene()
    poses = []
    for k in range(3):
        pose = np.eye(4)
        pose[:3, :3] *= 1.0 + k
        pose[:3, 3] = 5.0 * k, 1.0, -2.0
        poses.append(pose)
        scene.add(mesh, pose=pose)
    red = nrs.Material(base_color=(1.0, 0.0, 0.0))
    scene.add(mesh, material=red)
    report = scene.to_3dtiles(tmp_path / "t", triangles=2_000, **EXACT)
    root = tiles.opened(report.path)
    assert len(root.children) == 4
    files = {tile.file for tile in tiles.every(root) if tile.file}
    assert report.tiles == len(files)
    assert len([tile for tile in tiles.every(root) if tile.file]) == 2 * len(files)
    corners = root.corners()
    for child, pose in zip(root.children, [*poses, np.eye(4)], strict=True):
        vertices, _ = child.surface()
        local = (vertices @ tiles.TURN[:3, :3] - pose[:3, 3]) @ np.linalg.inv(pose[:3, :3]).T
        far = distance.to_surface(
            local, mesh.cut(error=0.0).vertices.astype(np.float64), mesh.cut(error=0.0).faces
        )
        assert far.max() <= child.properties["bound"]
        assert root.error >= child.error * pose[0, 0]
        assert (vertices >= corners.min(axis=0)).all()
        assert (vertices <= corners.max(axis=0)).all()
    looks = tiles.every(root.children[3])[0].source().materials
    assert looks[0].base_color[:3] == (1.0, 0.0, 0.0)


def test_large_trees_are_several_files(tmp_path, monkeypatch) -> None:
    from nanite_rs._tiles import write

    assert MOST_ROWS > 1_000
    mesh = bumpy(20_000)
    one = tiles.opened(mesh.to_3dtiles(tmp_path / "a", triangles=600).path)
    monkeypatch.setattr(write, "MOST_ROWS", 9)
    other = tiles.opened(mesh.to_3dtiles(tmp_path / "b", triangles=600).path)
    assert len(list((tmp_path / "b" / "subtrees").iterdir())) > 2
    a, b = tiles.every(one), tiles.every(other)
    assert len(a) == len(b)
    for left, right in zip(a, b, strict=True):
        assert (left.file is None) == (right.file is None)
        assert left.file is None or left.file.read_bytes() == right.file.read_bytes()
        assert np.array_equal(left.pose, right.pose)
        assert left.error == right.error


def test_small_and_odd_meshes(tmp_path) -> None:
    box = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20))
    report = box.to_3dtiles(tmp_path / "a")
    assert (report.tiles, report.levels) == (1, 1)
    root = tiles.opened(report.path)
    assert root.error == root.properties["bound"] < 1e-4
    # A line of a mesh, flat along two axes.
    flat = np.array([[0, 0, 0], [1, 0, 0], [2, 1e-30, 0]], np.float32)
    nrs.NaniteMesh.from_arrays(flat, [[0, 1, 2]]).to_3dtiles(tmp_path / "b")


def test_what_is_there_is_not_written_over(tmp_path) -> None:
    mesh = bumpy(2_000)
    mesh.to_3dtiles(tmp_path / "t", triangles=500)
    (tmp_path / "t" / "mine.txt").write_text("mine")
    with pytest.raises(nrs.FileError, match="holds a tileset; give overwrite=True"):
        mesh.to_3dtiles(tmp_path / "t")
    before = len(list((tmp_path / "t").rglob("*.glb")))
    mesh.to_3dtiles(tmp_path / "t", overwrite=True)
    assert len(list((tmp_path / "t").rglob("*.glb"))) == 1 < before
    assert (tmp_path / "t" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"triangles": 10}, "triangles"),
        ({"compression": "draco"}, "compression"),
        ({"up": "x"}, "up"),
        ({"pixel_error": 0.0}, "pixel_error"),
        ({"workers": 0}, "workers"),
        ({"transform": np.eye(3)}, "transform"),
        ({"crs": "EPSG:32632", "transform": np.eye(4)}, "transform"),
    ],
)
def test_mistakes(given, named, tmp_path) -> None:
    if "crs" in given:
        pytest.importorskip("pyproj")
    with pytest.raises((nrs.ArgumentError, nrs.DtypeError), match=named):
        bumpy(500).to_3dtiles(tmp_path / "t", **given)
    assert not (tmp_path / "t" / "tileset.json").exists()


def test_the_command(tmp_path, capsys) -> None:
    folder = tmp_path / "t"
    assert cli.main(["tiles", "shape:torus_knot:20000", "-o", str(folder), "--triangles", "3000"]) == 0
    out = capsys.readouterr().out
    assert f"{folder}/tileset.json: " in out
    assert "kB in the median" in out
    # glTF has y up, which tiles have as z.
    source().cut(error=0.0).export(tmp_path / "a.glb")
    assert cli.main(["tiles", str(tmp_path / "a.glb"), "-o", str(tmp_path / "g"), "-q"]) == 0
    vertices, _ = tiles.opened(tmp_path / "g" / "tileset.json").surface()
    assert np.allclose(np.ptp(vertices, axis=0)[[0, 2, 1]], np.ptp(source().bounds, axis=0), rtol=0.05)
    assert cli.main(["tiles", "shape:torus_knot:20000", "-o", str(folder), "-q"]) == 1
    assert "holds a tileset" in capsys.readouterr().err


def test_images_that_tiles_share_are_files(tmp_path) -> None:
    """A texture that repeats is there once, as it was encoded."""
    import io

    import PIL.Image

    pixels = np.random.default_rng(3).integers(0, 256, (96, 96, 3), dtype=np.uint8)
    buffer = io.BytesIO()
    PIL.Image.fromarray(pixels).save(buffer, format="PNG")
    (tmp_path / "bricks.png").write_bytes(buffer.getvalue())
    vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000)
    look = nrs.Material(base_color_texture=nrs.Texture(nrs.Image.open(tmp_path / "bricks.png")))
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, uvs=vertices[:, :2] * 4, materials=look, options=FAST)
    # Images are smaller where a tile cannot show more; here all can.
    report = mesh.to_3dtiles(tmp_path / "t", triangles=1_500, pixel_error=1e6)
    (image,) = (tmp_path / "t" / "images").iterdir()
    assert image.read_bytes() == buffer.getvalue()
    every = [tile for tile in tiles.every(tiles.opened(report.path)) if tile.file]
    for tile in every:
        assert tile.file.stat().st_size < len(buffer.getvalue())
        assert np.array_equal(tile.source().materials[0].base_color_texture.image.pixels, pixels)
    assert report.bytes == sum(tile.file.stat().st_size for tile in every) + len(buffer.getvalue())
    small = mesh.to_3dtiles(tmp_path / "w", triangles=1_500, pixel_error=1e6, images="webp")
    (image,) = (tmp_path / "w" / "images").iterdir()
    assert image.suffix == ".webp"
    assert tiles.every(tiles.opened(small.path))[0].source().materials[0].base_color_texture is not None
    # Scenes have their contents a folder deeper.
    scene = nrs.Scene()
    scene.add(mesh)
    root = tiles.opened(scene.to_3dtiles(tmp_path / "s", triangles=1_500, pixel_error=1e6).path)
    assert all(len(tile.source().materials) == 1 for tile in tiles.every(root) if tile.file)


@pytest.mark.parametrize(
    ("path", "up"),
    [
        ("scans/lucy_100k/lucy.ply", "z"),
        ("scans/mountain/mountain.obj", "z"),
        ("cad/occlusion_room/room.glb", "y"),
        ("gltf/house_lightmap_uv2/house.glb", "y"),
        ("scans/smithsonian_fossil_100k/USNM_1145291-150k-2048-medium-100k-2048_draco.glb", "y"),
    ],
)
def test_bounds_of_real_tilesets(path, up, tmp_path) -> None:
    """A scan, terrain, a building, a house with textures, a capture: no point is farther from the source."""
    folder, _, name = path.rpartition("/")
    file = data.require(folder) / name
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = nrs.NaniteMesh.from_file(file, options=FAST, progress=False)
        report = mesh.to_3dtiles(tmp_path / "t", triangles=6_000, skirts=False, up=up)
    cut = mesh.cut(error=0.0)
    vertices = cut.vertices.astype(np.float64)
    source = distance.Surface(vertices @ tiles.TURN[:3, :3].T if up == "y" else vertices, cut.faces)
    every = [tile for tile in tiles.every(tiles.opened(report.path)) if tile.file]
    assert len(every) > 2
    for tile in every:
        own = tile.surface()
        points = np.concatenate([own[0], distance.samples(*own, 300)])
        assert source.nearest(points)[0].max() <= tile.properties["bound"] <= tile.error


def test_what_moves_is_written_as_it_stands(tmp_path) -> None:
    """A mesh that joints move, and one without levels, in a scene."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=6_000)
    bend = (vertices[:, 2] > 0.0).astype(np.float32)
    rest = nrs.NaniteMesh.from_arrays(
        vertices, faces, channels={"weights": np.stack([1.0 - bend, bend], axis=1)}, options=FAST
    )
    skinned = nrs.SkinnedMesh(rest, channel="weights")
    matrices = np.stack([np.eye(4), np.eye(4)])
    matrices[1, :3, 3] = 0.0, 0.0, 2.0
    skinned.pose(matrices)
    scene = nrs.Scene()
    scene.add(skinned)
    shift = np.eye(4)
    shift[0, 3] = 10.0
    scene.add(nrs.TriangleMesh(vertices, faces), pose=shift)
    root = tiles.opened(scene.to_3dtiles(tmp_path / "t", triangles=2_000, **EXACT).path)
    posed, plain = root.children
    where = skinned.cut(error=0.0)
    known = [(posed, where.vertices, where.faces, 0.0), (plain, vertices, faces, 10.0)]
    for child, points, corners, offset in known:
        leaves = [tile for tile in tiles.every(child) if not tile.children]
        for own, _ in contents(leaves):
            local = own @ tiles.TURN[:3, :3] - (offset, 0.0, 0.0)
            assert distance.to_surface(local, points.astype(np.float64), corners).max() < 1e-5
    top = max((own @ tiles.TURN[:3, :3])[:, 2].max() for own, _ in contents(tiles.every(posed)))
    assert top > 2.5
