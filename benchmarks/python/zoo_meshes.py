"""Meshes of many kinds for ``zoo.py``: those of ``../shared/data`` where they are, and generated ones.

``ZOO`` has a maker and a kind for each name. Makers give vertices (N, 3), float32 but for one mesh, and faces
(M, 3), int64, welded by exact position and without faces that name a vertex twice. The same call gives the same
arrays.
Generated meshes have 5 to 100 thousand triangles (one has 209 thousand), those of files 1 to 400 thousand.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import nanite_rs as nrs

from .meshes import DATA

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

Arrays = tuple[np.ndarray, np.ndarray]
SMALLEST, LARGEST = 1_000, 400_000
"""Triangles of a file that is measured."""
FOLDERS = {
    "scans": "scan",
    "cad": "cad",
    "gltf": "gltf",
    "foliage": "foliage",
    "nasty": "nasty",
}
SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".gz")
UNREADABLE = ("negative_indices", "empty", "Cray_right")
"""Files that hold no mesh, or none that can be built."""


@dataclass(frozen=True)
class Animal:
    """A mesh of the zoo."""

    kind: str
    make: Callable[[], Arrays]
    file: bool = False
    """Whether it comes from ``../shared/data``."""

    def __call__(self) -> Arrays:
        """The mesh."""
        return welded(*self.make())


def welded(vertices: np.ndarray, faces: np.ndarray) -> Arrays:
    """The same triangles with one vertex for each position that they use, without degenerate ones."""
    faces = np.asarray(faces, np.int64)
    used, faces = np.unique(faces, return_inverse=True)
    points, where = np.unique(np.asarray(vertices)[used] + 0, axis=0, return_inverse=True)
    faces = where.reshape(-1)[faces.reshape(-1, 3)]
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return points, faces[proper]


# ------------------------------------------------------------------------------------------------------- files


def load(path: Path) -> Arrays:
    """All that a file places, in one mesh of float32."""
    if path.suffix in (".glb", ".gltf"):
        asset = nrs.assets.read_asset(path, drop_bad_textures=True)
        parts = []
        for _, number, pose in asset.placed:
            for part in asset.meshes[number]:
                points = np.asarray(part.source.vertices, np.float64) @ pose[:3, :3].T + pose[:3, 3]
                faces = np.asarray(part.source.faces)
                parts.append((points, faces[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0 else faces))
        vertices, faces = merged(parts)
    else:
        source = nrs.io.from_file(path)
        vertices, faces = source.vertices, source.faces
    return np.asarray(vertices, np.float32), faces


def srtm() -> Arrays:
    """A quarter of a degree and more of real heights in metres: 400 × 400 cells of the mountains in the north."""
    heights = np.fromfile(DATA / "huge/srtm_N43E006/N43E006.hgt", ">i2").reshape(1201, 1201)
    return height_field(heights[:401, :401].astype(np.float32), 67.0, 92.6)


def _files() -> dict[str, Animal]:
    zoo = {}
    for folder, kind in FOLDERS.items():
        for path in sorted(p for p in (DATA / folder).rglob("*") if p.suffix.lower() in SUFFIXES):
            name = path.relative_to(DATA / folder).parts[0]
            if name not in UNREADABLE:
                zoo[name] = Animal(kind, functools.partial(load, path), file=True)
    if (DATA / "huge/srtm_N43E006").is_dir():
        zoo["srtm"] = Animal("terrain", srtm, file=True)
    return zoo


# ------------------------------------------------------------------------------------------------------- parts


def merged(parts: Iterable[Arrays]) -> Arrays:
    """Several meshes as one."""
    parts = list(parts)
    first = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [np.asarray(f, np.int64) + o for (_, f), o in zip(parts, first, strict=True)]
    )


def placed(mesh: Arrays, place: Iterable[float] = (0, 0, 0), size: float | Iterable[float] = 1.0) -> Arrays:
    """A mesh scaled, then moved."""
    return np.asarray(mesh[0], float) * np.asarray(size) + np.asarray(place), mesh[1]


def turned(mesh: Arrays, rng: np.random.Generator) -> Arrays:
    """A mesh turned at random about the origin."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q *= np.sign(np.diag(r))
    q[0] *= np.sign(np.linalg.det(q))
    return np.asarray(mesh[0]) @ q.T, mesh[1]


def cells(rows: int, columns: int, *, wrap_rows: bool = False, wrap_columns: bool = False) -> np.ndarray:
    """Two triangles for each cell between rows × columns vertices; wrapped, the last join the first."""
    r, c = np.meshgrid(
        np.arange(rows if wrap_rows else rows - 1),
        np.arange(columns if wrap_columns else columns - 1),
        indexing="ij",
    )
    r, c = r.ravel(), c.ravel()
    s, d = (r + 1) % rows, (c + 1) % columns
    a, b, e, f = r * columns + c, r * columns + d, s * columns + d, s * columns + c
    return np.concatenate([np.stack([a, b, e], 1), np.stack([a, e, f], 1)])


def height_field(heights: np.ndarray, dx: float = 1.0, dy: float = 1.0) -> Arrays:
    """A surface over a grid, seen from +Z."""
    y, x = np.mgrid[: heights.shape[0], : heights.shape[1]]
    vertices = np.stack([x * dx, y * dy, heights], axis=-1).reshape(-1, 3)
    return vertices, cells(*heights.shape)


def sheet(rows: int, columns: int | None = None) -> Arrays:
    """A unit square in z = 0 of 2 × rows × columns triangles."""
    columns = columns or rows
    return height_field(np.zeros((rows + 1, columns + 1)), 1 / columns, 1 / rows)


def box(steps: int) -> Arrays:
    """The closed cube [−½, ½]³ of 12 × steps² triangles."""
    v, f = sheet(steps)
    v -= [0.5, 0.5, -0.5]
    v[:, :2] = np.round(v[:, :2], 12)
    parts = []
    for axis in range(3):
        rolled = np.roll(v, axis, axis=1)
        parts += [(rolled, f), (-rolled, f[:, ::-1])]
    return welded(*merged(parts))


def revolved(profile: np.ndarray, around: int) -> Arrays:
    """A profile of (radius, z), bottom to top outside, turned about Z; points of radius 0 become poles."""
    angle = 2 * np.pi * np.arange(around) / around
    r, z = np.asarray(profile, float).T
    x, y = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    vertices = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    return welded(vertices, cells(len(r), around, wrap_columns=True))


def ball(rows: int, around: int) -> Arrays:
    """The unit sphere by longitude and latitude."""
    angle = np.pi * np.arange(rows + 1) / rows
    radius = np.sin(angle)
    radius[[0, -1]] = 0
    return revolved(np.stack([radius, -np.cos(angle)], 1), around)


def cylinder(rows: int, around: int) -> Arrays:
    """Radius 1, height 2, closed by fans."""
    z = np.linspace(-1, 1, rows + 1)
    sides = np.stack([np.ones_like(z), z], 1)
    return revolved(np.concatenate([[[0, -1]], sides, [[0, 1]]]), around)


def pipe(curve: np.ndarray, radius: np.ndarray | float, around: int) -> Arrays:
    """A tube along a curve, closed by fans at both ends."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.empty_like(curve)
    last = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    for i, t in enumerate(tangent):  # turns as little as the curve allows
        last = last - t * (last @ t)
        last /= np.linalg.norm(last)
        side[i] = last
    other = np.cross(tangent, side)
    angle = 2 * np.pi * np.arange(around) / around
    ring = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * other[:, None]
    vertices = curve[:, None] + np.broadcast_to(radius, len(curve))[:, None, None] * ring
    vertices = np.concatenate(
        [curve[:1].repeat(around, 0)[None], vertices, curve[-1:].repeat(around, 0)[None]]
    )
    return welded(vertices.reshape(-1, 3), cells(len(curve) + 2, around, wrap_columns=True))


def ear_clipped(outline: np.ndarray) -> np.ndarray:
    """Triangles of a simple polygon that turns counter-clockwise: rows of three of its vertices."""
    left = list(range(len(outline)))
    triangles = []

    def cross(o: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a[..., 0] - o[..., 0]) * (b[..., 1] - o[..., 1]) - (a[..., 1] - o[..., 1]) * (
            b[..., 0] - o[..., 0]
        )

    at = misses = 0
    while len(left) > 3 and misses < 2 * len(left):
        n = len(left)
        at %= n
        i, j, k = left[at - 1], left[at], left[(at + 1) % n]
        a, b, c = outline[[i, j, k]]
        rest = outline[left]
        inside = (cross(a, b, rest) >= 0) & (cross(b, c, rest) >= 0) & (cross(c, a, rest) >= 0)
        same = ((rest == a) | (rest == b) | (rest == c)).all(1) | (rest[:, None] == [a, b, c]).all(2).any(1)
        if cross(a, b, c) > 0 and not (inside & ~same).any():
            triangles.append((i, j, k))
            left.pop(at)
            misses = 0
        else:
            misses += 1
            at += 1
    triangles.append(tuple(left[:3]))
    return np.array(triangles)


def bridged(outline: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """An outline and a clockwise hole in it as one polygon: the nearest two vertices are joined."""
    apart = np.linalg.norm(outline[:, None] - hole[None], axis=2)
    i, j = np.unravel_index(np.argmin(apart), apart.shape)
    return np.concatenate([outline[: i + 1], np.roll(hole, -j, axis=0), hole[j : j + 1], outline[i:]])


def extruded(outline: np.ndarray, height: float, hole: np.ndarray | None = None) -> Arrays:
    """A prism over a counter-clockwise outline, with a clockwise hole; sides of two slivers for each edge."""
    whole = outline if hole is None else bridged(outline, hole)
    triangles = ear_clipped(whole)
    flat = np.column_stack([whole, np.zeros(len(whole))])
    parts = [(flat, triangles[:, ::-1]), placed((flat, triangles), (0, 0, height))]
    for loop in (outline,) if hole is None else (outline, hole):
        ring = np.column_stack([loop, np.zeros(len(loop))])
        walls = np.concatenate([ring, ring + np.array([0, 0, height])])
        parts.append((walls, cells(2, len(loop), wrap_columns=True)))
    return welded(*merged(parts))


# --------------------------------------------------------------------------------------------------- generated


def screw(around: int, turns: int, per_turn: int) -> Arrays:
    """A threaded rod with a head: a helical ridge as a height over the cylinder."""
    z = np.linspace(0, 1, turns * per_turn + 1)
    angle = 2 * np.pi * np.arange(around) / around
    phase = (z[:, None] * turns - angle / (2 * np.pi)) % 1
    radius = 0.1 + 0.02 * (1 - np.abs(2 * phase - 1))
    vertices = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.broadcast_to(z[:, None], radius.shape)], -1
    )
    ends = [np.broadcast_to([0, 0, end], (1, around, 3)) for end in (0.0, 1.0)]
    rod = np.concatenate([ends[0], vertices, ends[1]]).reshape(-1, 3)
    head = placed(cylinder(2, 6), (0, 0, 1.05), (0.25, 0.25, 0.08))
    return merged([welded(rod, cells(len(z) + 2, around, wrap_columns=True)), head])


def parts_of_many_sizes() -> Arrays:
    """320 boxes, balls, cylinders and screws, sizes over two and a half decades, turned at random."""
    rng = np.random.default_rng(1)
    makers = [
        lambda: box(1),
        lambda: box(int(rng.integers(2, 8))),
        lambda: ball(int(rng.integers(6, 20)), int(rng.integers(8, 30))),
        lambda: cylinder(int(rng.integers(1, 6)), int(rng.integers(8, 48))),
        lambda: placed(screw(int(rng.integers(8, 16)), 4, 6), (0, 0, -0.5)),
    ]
    parts = []
    for i in range(320):
        part = turned(makers[i % len(makers)](), rng)
        parts.append(placed(part, rng.uniform(-4, 4, 3), 10 ** rng.uniform(-2, 0.5)))
    return merged(parts)


def small_beside_large() -> Arrays:
    """A box of 12 triangles and, beside it, one a tenth as wide of 19,200."""
    return merged([box(1), placed(box(40), (0.6, 0, 0), 0.1)])


def boxes(count: int, steps: int) -> Arrays:
    """``count``² boxes on a square."""
    each = box(steps)
    return merged([placed(each, (1.5 * x, 1.5 * y, 0)) for x in range(count) for y in range(count)])


def teapots() -> Arrays:
    """Eight bodies as by a lathe, each with a lid, a spout and a handle that run into it."""
    t = np.linspace(0, 1, 33)
    profile = np.stack([np.sqrt(np.maximum(0, 1 - (2 * t - 1) ** 4)) * (1 - 0.2 * t), 1.4 * t], 1)
    lid = np.stack([0.4 * np.sin(np.pi * t) * (0.3 + t), 1.9 - 0.55 * t[::-1]], 1)
    s = np.linspace(0, 1, 24)
    spout = np.stack([0.8 + 0.9 * s, 0 * s, 0.4 + 0.9 * s**2], 1)
    arc = np.linspace(-0.45, 0.45, 32) * np.pi
    handle = np.stack([-0.8 - 0.7 * np.cos(arc), 0 * arc, 0.7 + 0.45 * np.sin(arc)], 1)
    pot = merged(
        [
            revolved(profile, 64),
            revolved(lid, 32),
            pipe(spout, 0.22 - 0.1 * s, 24),
            pipe(handle, 0.08, 16),
        ]
    )
    rng = np.random.default_rng(2)
    return merged([placed(turned(pot, rng), (4 * (i % 4), 4 * (i // 4), 0)) for i in range(8)])


def plate(thickness: float, steps: int) -> Arrays:
    """A curved plate of so little thickness, closed by a rim."""
    v, f = sheet(steps)
    x, y = v[:, 0], v[:, 1]
    middle = np.stack([x, y, 0.15 * np.sin(3 * x) * np.cos(2 * y)], 1)
    normal = np.stack(
        [-0.45 * np.cos(3 * x) * np.cos(2 * y), 0.3 * np.sin(3 * x) * np.sin(2 * y), 1 + 0 * x], 1
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    upper, lower = middle + normal * thickness / 2, middle - normal * thickness / 2
    n = steps + 1
    rim = np.concatenate(
        [
            np.arange(steps),
            np.arange(steps) * n + steps,
            n * n - 1 - np.arange(steps),
            (steps - np.arange(steps)) * n,
        ]
    )
    walls = cells(2, len(rim), wrap_columns=True)
    walls = np.concatenate([rim + n * n, rim])[walls]
    return np.concatenate([upper, lower]), np.concatenate([f, f[:, ::-1] + n * n, walls])


def wavy_sheet(steps: int) -> Arrays:
    """An open sheet with waves."""
    v, f = sheet(steps)
    v[:, 2] = 0.05 * np.sin(9 * v[:, 0]) * np.cos(7 * v[:, 1]) + 0.01 * np.sin(31 * v[:, 0] + 17 * v[:, 1])
    return v, f


def two_sheets() -> Arrays:
    """Two open sheets, a ten thousandth apart."""
    v, f = wavy_sheet(110)
    return merged([(v, f), placed((v, f[:, ::-1]), (0, 0, 1e-4))])


def both_windings() -> Arrays:
    """A sheet of which every face is there twice, once the other way round."""
    v, f = wavy_sheet(100)
    return v, np.concatenate([f, f[:, ::-1]])


def onion() -> Arrays:
    """Five shells, each a thousandth of the diagonal inside the other, facing in turn out and in."""
    v, f = nrs.shapes.displaced_icosphere(faces=8_000, seed=5)
    return merged([(v * (1 - 2e-3 * i), f if i % 2 == 0 else f[:, ::-1]) for i in range(5)])


def sliced(count: int, height: float, rows: int = 1) -> Arrays:
    """A cylinder of so many slices, as STL has them: slivers on the side, fans at the ends."""
    return placed(cylinder(rows, count), size=(1, 1, height / 2))


def fine_extrusion() -> Arrays:
    """A smooth outline of 2,400 edges, extruded, the ends cut into strips from side to side."""
    count = 2_400
    x = -np.cos(np.pi * np.arange(count // 2 + 1) / (count // 2))
    width = np.sqrt(np.maximum(0, 1 - x**2)) * (0.6 + 0.3 * np.sin(9 * x))
    low, high = np.stack([x, -width], 1), np.stack([x, width], 1)
    flat = np.concatenate([low, high])
    caps = cells(2, len(x))
    bottom, top = np.column_stack([flat, 0 * flat[:, 0]]), np.column_stack([flat, 0.5 + 0 * flat[:, 0]])
    outline = np.concatenate([np.arange(len(x)), len(x) + np.arange(len(x) - 2, 0, -1)])
    walls = np.concatenate([outline, outline + len(flat)])[cells(2, len(outline), wrap_columns=True)]
    v = np.concatenate([bottom, top])
    return v, np.concatenate([caps[:, ::-1], caps + len(flat), walls])


def sliced_part() -> Arrays:
    """A body of revolution whose profile has few points, of 3,000 slices: triangles a thousand times as long."""
    profile = [(0, 0), (1, 0), (1, 0.4), (0.5, 0.5), (0.5, 3), (0.3, 3.2), (0, 3.2)]
    return revolved(np.array(profile), 3_000)


def noisy_terrain() -> Arrays:
    """Hills with white noise."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:201, :201] / 200
    return height_field(
        0.15 * np.sin(5 * x) * np.cos(4 * y) + rng.normal(0, 0.002, x.shape), 1 / 200, 1 / 200
    )


def terraces() -> Arrays:
    """Hills in twelve steps: flat land and steep walls."""
    y, x = np.mgrid[:201, :201] / 200
    hills = 0.2 * np.sin(5 * x + 2 * y) * np.cos(4 * y - x)
    return height_field(np.round(hills * 30) / 30, 1 / 200, 1 / 200)


def fins() -> Arrays:
    """A sheet with 20 fins that stand on its edges: edges of three faces, and of four where fins cross."""
    n = 80
    floor, f = sheet(n)
    parts = [(floor, f)]
    upright, g = sheet(12, n)
    upright[:, 1] *= 0.15
    for i in range(10):
        at = round((8 * i + 4) / n, 12)
        along = np.stack([upright[:, 0], np.full(len(upright), at), upright[:, 1]], 1)
        parts += [(along, g), (along[:, [1, 0, 2]], g[:, ::-1])]
    v, f = merged(parts)
    return np.round(v, 9), f


def hanging() -> Arrays:
    """Tiles of a waved surface, finer and coarser in turn, whose borders meet without sharing vertices."""
    parts = []
    for i in range(8):
        for j in range(8):
            v, f = sheet(16 if (i + j) % 2 else 10)
            parts.append((np.round((v + np.array([i, j, 0])) / 8, 9), f))
    v, f = merged(parts)
    v[:, 2] = 0.08 * np.sin(6 * v[:, 0]) * np.cos(5 * v[:, 1])
    return v, f


def voxels() -> Arrays:
    """The border of random voxels: edges of four faces, corners where parts touch."""
    rng = np.random.default_rng(4)
    z, y, x = np.mgrid[-1:1:26j, -1:1:26j, -1:1:26j]
    full = np.zeros((28, 28, 28), bool)
    full[1:-1, 1:-1, 1:-1] = (x**2 + y**2 + z**2 + rng.uniform(-0.25, 0.25, x.shape)) < 0.7
    square, f = sheet(1)
    parts = []
    for axis in range(3):
        for step in (1, -1):
            open_side = full & ~np.roll(full, -step, axis)
            place = np.argwhere(open_side)
            side = np.roll(np.column_stack([square[:, :2], square[:, 2]]), axis + 1, axis=1)
            corner = side + np.eye(3)[axis] * (step > 0)
            order = f if step > 0 else f[:, ::-1]
            v = (place[:, None] + corner).reshape(-1, 3)
            parts.append((v, (order + len(square) * np.arange(len(place))[:, None, None]).reshape(-1, 3)))
    return merged(parts)


def annuli() -> Arrays:
    """Six flat rings, one inside the other, with gaps between."""
    rings = []
    for i in range(6):
        inner, outer = 0.2 + 0.3 * i, 0.4 + 0.3 * i
        around = 60 + 50 * i
        radius = np.linspace(outer, inner, 9)
        rings.append(revolved(np.stack([radius, 0 * radius], 1), around))
    return merged(rings)


def wire() -> Arrays:
    """A long thin pipe with many bends, of eight sides."""
    t = np.linspace(0, 1, 3_000)
    curve = np.stack([np.cos(9 * np.pi * t), np.sin(14 * np.pi * t), np.sin(22 * np.pi * t) + 4 * t], 1)
    return pipe(curve, 0.02, 8)


def spring() -> Arrays:
    """A hollow pipe in twelve turns: an outer and an inner wall."""
    t = np.linspace(0, 1, 1_200)
    curve = np.stack([np.cos(24 * np.pi * t), np.sin(24 * np.pi * t), 3 * t], 1)
    outer, inner = pipe(curve, 0.08, 16), pipe(curve, 0.075, 16)
    return merged([outer, (inner[0], inner[1][:, ::-1])])


def gear() -> Arrays:
    """An extruded outline of 48 teeth with a bore, the ends cut into slivers from outline to bore."""
    teeth, per_tooth = 48, 24
    count = teeth * per_tooth
    angle = 2 * np.pi * np.arange(count) / count
    phase = np.arange(count) % per_tooth / per_tooth
    radius = 1 + 0.12 * np.clip(4 * np.minimum(phase, 1 - phase) - 0.6, 0, 0.8)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    loops = [0.3 * circle, radius[:, None] * circle]
    flat = [np.column_stack([p, np.full(count, z)]) for p, z in zip(loops * 2, (0, 0, 0.3, 0.3), strict=True)]
    v = np.concatenate([flat[0], flat[1], flat[3], flat[2]])  # once around the material
    return v, cells(4, count, wrap_rows=True, wrap_columns=True)


def plain_gears() -> Arrays:
    """Twelve gears of different sizes with bores, their ends triangulated by clipping ears."""
    parts = []
    for i in range(12):
        teeth = 16 + 2 * i
        angle = np.repeat(2 * np.pi * np.arange(teeth) / teeth, 4) + np.tile(
            np.array([0, 0.2, 0.5, 0.7]) * 2 * np.pi / teeth, teeth
        )
        radius = np.tile([1.0, 1.12, 1.12, 1.0], teeth)
        outline = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        turn = -2 * np.pi * np.arange(96) / 96
        bore = 0.4 * np.stack([np.cos(turn), np.sin(turn)], 1)
        parts.append(placed(extruded(outline, 0.3, bore), (3 * (i % 4), 3 * (i // 4), 0), 0.4 + 0.07 * i))
    return merged(parts)


def stroke(path: np.ndarray, width: float) -> np.ndarray:
    """The outline of a line of so much width, counter-clockwise."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = 0.5 * width * np.stack([-along[:, 1], along[:, 0]], 1)
    return np.concatenate([path - side, (path + side)[::-1]])


def letters() -> Arrays:
    """240 extruded letters: C, E, I, L, O, S, T and U, with smooth curves and straight bars."""
    turn = 2 * np.pi * np.arange(48) / 48
    circle = np.stack([np.cos(turn), np.sin(turn)], 1)

    def arc(first: float, last: float, center: tuple[float, float], radius: float) -> np.ndarray:
        t = np.linspace(first, last, 32) * np.pi
        return np.stack([np.cos(t), np.sin(t)], 1) * radius + center

    letter_e, letter_i, letter_l, letter_t = (
        np.array(corners) / 10
        for corners in (
            [
                (0, 0),
                (6, 0),
                (6, 2),
                (2, 2),
                (2, 4),
                (5, 4),
                (5, 6),
                (2, 6),
                (2, 8),
                (6, 8),
                (6, 10),
                (0, 10),
            ],
            [(0, 0), (2, 0), (2, 10), (0, 10)],
            [(0, 0), (6, 0), (6, 2), (2, 2), (2, 10), (0, 10)],
            [(3, 0), (5, 0), (5, 8), (8, 8), (8, 10), (0, 10), (0, 8), (3, 8)],
        )
    )
    letter_c = stroke(arc(0.25, 1.75, (0.5, 0.5), 0.4), 0.2)
    bends = [arc(0.2, 1.5, (0.4, 0.72), 0.2), arc(0.5, -0.8, (0.4, 0.28), 0.22)[1:]]
    letter_s = stroke(np.concatenate(bends), 0.12)
    letter_u = stroke(np.concatenate([[(0.1, 1.0)], arc(1.0, 2.0, (0.5, 0.4), 0.4), [(0.9, 1.0)]]), 0.2)
    letter_o = extruded(0.5 + 0.5 * circle, 0.15, 0.5 + 0.3 * circle[::-1])
    others = (letter_c, letter_e, letter_i, letter_l, letter_s, letter_t, letter_u)
    solid = [extruded(outline, 0.15) for outline in others]
    solid.insert(4, letter_o)
    rng = np.random.default_rng(6)
    which = rng.integers(0, len(solid), 240)
    return merged(
        [placed(solid[k], (1.2 * (i % 24), -1.5 * (i // 24), 0)) for i, k in enumerate(which.tolist())]
    )


def noisy_sphere() -> Arrays:
    """A sphere whose vertices are off by a third of an edge, in any direction."""
    v, f = nrs.shapes.icosphere(faces=50_000)
    rng = np.random.default_rng(7)
    return v + rng.normal(0, 0.005, v.shape), f


def far_away() -> Arrays:
    """A sphere with relief a million of its radii away, in float64."""
    v, f = nrs.shapes.displaced_icosphere(faces=40_000, seed=9)
    return placed((v, f), (1e6, -2e6, 5e5))


def spiked() -> Arrays:
    """A sphere with needles: every 61st vertex stands out by half the radius."""
    v, f = nrs.shapes.displaced_icosphere(faces=20_000, seed=8)
    v = np.array(v)
    v[::61] *= 1.5
    return v, f


def graded() -> Arrays:
    """A waved sheet whose cells are a thousand times as wide on one side as on the other, in both directions."""
    v, f = sheet(140)
    v[:, :2] = (1000 ** v[:, :2] - 1) / 999
    v[:, 2] = 0.1 * np.sin(8 * v[:, 0]) * np.cos(6 * v[:, 1])
    return v, f


def crowd_with_floor() -> Arrays:
    """Knots and wheels of 4 thousand triangles each on a floor of two."""
    floor = placed((np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0.0]]), [[0, 1, 2], [0, 2, 3]]))
    parts = [floor]
    for i in range(16):
        each = nrs.shapes.torus_knot(faces=4_000) if i % 2 else nrs.shapes.cad_part(faces=4_000, seed=i)
        parts.append(placed(each[:2], (4 * (i % 4) - 6, 4 * (i // 4) - 6, 1.2), 0.3 + 0.08 * i))
    return merged(parts)


_GENERATED: dict[str, tuple[str, Callable[[], Arrays]]] = {
    "parts of many sizes": ("assembly", parts_of_many_sizes),
    "small box beside large": ("assembly", small_beside_large),
    "36 boxes": ("assembly", lambda: boxes(6, 22)),
    "teapots": ("assembly", teapots),
    "crowd": ("assembly", crowd_with_floor),
    "islands": ("assembly", lambda: nrs.shapes.islands(faces=40_000, count=500, seed=1)),
    "letters": ("assembly", letters),
    "plate 1e-3": ("thin", lambda: plate(1e-3, 100)),
    "plate 1e-5": ("thin", lambda: plate(1e-5, 100)),
    "two sheets": ("thin", two_sheets),
    "both windings": ("thin", both_windings),
    "onion": ("thin", onion),
    "annuli": ("thin", annuli),
    "wire": ("thin", wire),
    "spring": ("thin", spring),
    "leaves": ("foliage", lambda: nrs.shapes.foliage(faces=20_000, seed=1)),
    "sliced cylinder": ("sliver", lambda: sliced(5_000, 2.0)),
    "sliced rod": ("sliver", lambda: sliced(4_000, 1_500.0)),
    "sliced part": ("sliver", sliced_part),
    "fine extrusion": ("sliver", fine_extrusion),
    "cone": ("sliver", lambda: nrs.shapes.fan(faces=10_000)),
    "stretched": (
        "sliver",
        lambda: placed(nrs.shapes.displaced_icosphere(faces=30_000, seed=2), size=(1000, 1, 1)),
    ),
    "graded": ("sliver", graded),
    "gear": ("cad", gear),
    "plain gears": ("cad", plain_gears),
    "wheel": ("cad", lambda: nrs.shapes.cad_part(faces=30_000)),
    "screw": ("cad", lambda: screw(48, 20, 16)),
    "cube": ("cad", lambda: box(48)),
    "noisy terrain": ("terrain", noisy_terrain),
    "terraces": ("terrain", terraces),
    "hills": ("terrain", lambda: nrs.shapes.terrain(faces=80_000, seed=5)),
    "fins": ("nasty", fins),
    "hanging vertices": ("nasty", hanging),
    "voxels": ("nasty", voxels),
    "triangles at random": ("nasty", lambda: nrs.shapes.soup(faces=5_000, seed=6)),
    "spiked": ("nasty", spiked),
    "noisy sphere": ("smooth", noisy_sphere),
    "sphere": ("smooth", lambda: nrs.shapes.displaced_icosphere(faces=60_000, seed=3)),
    "knot": ("smooth", lambda: nrs.shapes.torus_knot(faces=60_000)),
    "gyroid": ("smooth", lambda: nrs.shapes.gyroid_shell(faces=60_000)),
}


def _rounded(make: Callable[[], Arrays]) -> Arrays:
    vertices, faces = make()
    return np.asarray(vertices, np.float32), faces


GENERATED = {
    name: Animal(kind, functools.partial(_rounded, make)) for name, (kind, make) in _GENERATED.items()
}
GENERATED["far away"] = Animal("smooth", far_away)
FILES = _files()
ZOO: dict[str, Animal] = FILES | GENERATED
