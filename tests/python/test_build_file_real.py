"""Real sources in blocks: terrain in tiles, scans as one soup; and one like a textured capture, of many charts."""

from __future__ import annotations

import numpy as np

import nanite_rs as nrs
from conftest import SOAK
from oracles import data
from oracles.captures import capture
from test_build_file import LITTLE, assert_bounds_hold, write_ply
from test_piece_files import assert_same, both


def errors(mesh: nrs.NaniteMesh) -> list[float]:
    largest = mesh.cut(target_faces=1).error
    return (np.geomspace(1e-3, 0.5, 12 if SOAK else 3) * largest).tolist()


def used_once(faces: np.ndarray) -> int:
    """Edges with one face."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.uint64), axis=1)
    _, uses = np.unique(edges[:, 0] << np.uint64(32) | edges[:, 1], return_counts=True)
    return int((uses == 1).sum())


def joined(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces over one vertex for each position."""
    _, names = np.unique(vertices, axis=0, return_inverse=True)
    return names.reshape(-1)[faces]


def heights() -> np.ndarray:
    """Metres above the sea, from north to south; what is unknown is not a number."""
    path = data.require("huge", "srtm_N43E006", "N43E006.hgt")
    side = int(np.sqrt(path.stat().st_size // 2))
    rows = np.fromfile(path, ">i2").reshape(side, side).astype(np.float64)
    rows[rows == -32768] = np.nan
    return rows if SOAK else rows[300:621, 500:821]


def tile(rows: np.ndarray, first: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Terrain in metres, as of UTM: east, north, up. Where a height is unknown there is a hole."""
    y, x = np.mgrid[: rows.shape[0], : rows.shape[1]]
    points = [300_000.0 + 67.5 * (x + first[1]), 4_800_000.0 - 92.6 * (y + first[0]), rows]
    vertices = np.stack(points, axis=-1).reshape(-1, 3)
    at = (y[:-1, :-1] * rows.shape[1] + x[:-1, :-1]).reshape(-1)
    below = at + rows.shape[1]
    faces = np.concatenate([np.stack([at, below, below + 1], 1), np.stack([at, below + 1, at + 1], 1)])
    faces = faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]
    used, names = np.unique(faces, return_inverse=True)
    return vertices[used], names.reshape(-1, 3)


def test_terrain_in_tiles_that_touch(tmp_path) -> None:
    rows = heights()
    step = 300 if SOAK else 80
    (tmp_path / "tiles").mkdir()
    for north in range(0, rows.shape[0] - 1, step):
        for west in range(0, rows.shape[1] - 1, step):
            own = rows[north : north + step + 1, west : west + step + 1]
            path = tmp_path / "tiles" / f"tile_{north // step}_{west // step}.ply"
            write_ply(path, *tile(own, (north, west)))
    mesh = nrs.build_file(
        tmp_path / "tiles", tmp_path / "terrain.nanite", memory=16 * LITTLE if SOAK else LITTLE
    )
    vertices, faces = tile(rows, (0, 0))
    assert mesh.check().clusters == mesh.report.clusters
    assert mesh.report.input_faces == len(faces)
    assert mesh.report.border_edges == used_once(faces)
    assert mesh.cut(error=0.0).face_materials is None
    assert mesh.report.levels[-1].triangles < 500
    for error in errors(mesh):
        assert_bounds_hold(mesh.cut(error=error), vertices, faces)


def test_scans_as_one_soup_of_tiles(tmp_path) -> None:
    """Copies of scans, without any shared vertex, in files for parts of space that cut through them."""
    scans = [data.scan(name) for name in ("bunny", "armadillo")]
    soups, edges = [], 0
    for number in range(12 if SOAK else 2):
        scan = scans[number % 2]
        moved = (scan.vertices - scan.center.astype(np.float32)) / np.float32(scan.diagonal)
        moved += np.float32([number % 4, number // 4, 0]) * np.float32(0.75)
        soups.append(moved[scan.faces])
        edges += used_once(joined(moved, scan.faces))
    triangles = np.concatenate(soups)
    (tmp_path / "tiles").mkdir()
    cells = np.floor(triangles.mean(axis=1) / 0.4).astype(int)
    for number, cell in enumerate(np.unique(cells, axis=0)):
        own = triangles[(cells == cell).all(axis=1)]
        row = np.zeros(len(own), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        row["corners"] = own
        content = bytes(80) + np.uint32(len(own)).tobytes() + row.tobytes()
        (tmp_path / "tiles" / f"part {number}.stl").write_bytes(content)
    mesh = nrs.build_file(tmp_path / "tiles", tmp_path / "soup.nanite", memory=4 * LITTLE)
    assert mesh.check().clusters == mesh.report.clusters
    assert mesh.report.input_faces == len(triangles)
    assert mesh.report.border_edges == edges
    vertices, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    for error in errors(mesh):
        assert_bounds_hold(mesh.cut(error=error), vertices, faces)


#: Cells along a side of the atlas.
SIDE = 45 if SOAK else 8


def test_a_capture_with_many_charts(tmp_path) -> None:
    """No cut opens a seam, and no triangle is of two charts."""
    made = capture(400_000 if SOAK else 16_000, SIDE * SIDE)
    vertices, faces, uvs, corners = made.vertices, made.faces, made.uvs, made.corners
    lines = ["v " + " ".join(map(repr, row)) for row in vertices.tolist()]
    lines += ["vt " + " ".join(map(repr, row)) for row in uvs.tolist()]
    for face, own in zip((faces + 1).tolist(), (corners + 1).tolist(), strict=True):
        lines.append("f " + " ".join(f"{v}/{uv}" for v, uv in zip(face, own, strict=True)))
    (tmp_path / "x.obj").write_text("\n".join([*lines, ""]))
    assert_same(*both(tmp_path / "x.obj", tmp_path, memory=4 * LITTLE if SOAK else LITTLE))
    mesh = nrs.NaniteMesh.open(tmp_path / "blocks.nanite")
    for error in errors(mesh):
        cut = mesh.cut(error=error)
        assert used_once(joined(cut.vertices, cut.faces)) == 0
        cells = np.floor(cut.uvs[0][cut.faces] * SIDE)
        assert (cells == cells[:, :1]).all()
        assert_bounds_hold(cut, vertices, faces)
