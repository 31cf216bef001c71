"""Procedural meshes of any size: for trying things out, for tests and for benchmarks.

Every function returns ``(vertices, faces)``: float32 of shape (N, 3) and uint32 of shape (M, 3),
counter-clockwise seen from outside, Y up where there is an up, about 2 units across. ``faces`` is the number
of triangles aimed at; what comes back is the nearest that the construction allows. The same arguments give
the same bytes on every machine: only correctly rounded operations are used, so no sine or power of a library
takes part.

Examples
--------
>>> import nanite_rs as nrs
>>> vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000, seed=1)
>>> vertices.dtype, faces.dtype, len(faces)
(dtype('float32'), dtype('uint32'), 20480)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from nanite_rs.exceptions import ArgumentError

__all__ = [
    "SHAPES",
    "cad_part",
    "displaced_icosphere",
    "fan",
    "flat_shaded",
    "foliage",
    "gyroid_shell",
    "icosphere",
    "islands",
    "soup",
    "terrain",
    "torus_knot",
]

Float32: TypeAlias = NDArray[np.float32]
UInt32: TypeAlias = NDArray[np.uint32]
Mesh: TypeAlias = tuple[Float32, UInt32]

#: Rows worked on at a time, so that temporaries stay in the cache.
_CHUNK: Final = 1 << 16
_TAU: Final = 2.0 * np.pi
#: Most vertices a mesh may have: indices are 32 bits wide.
_MOST_FACES: Final = 1 << 31


def _check_faces(faces: int, least: int) -> int:
    if not least <= faces <= _MOST_FACES:
        raise ArgumentError(f"faces: must be between {least} and {_MOST_FACES}, not {faces}")
    return int(faces)


def _sine(turns: NDArray[Any]) -> NDArray[Any]:
    """Sine of an angle in turns, to about 1e-7, from additions and multiplications alone."""
    angle = turns - np.rint(turns)
    size = np.abs(angle)
    size = 0.25 - np.abs(0.25 - size)
    size *= angle.dtype.type(_TAU)
    square = size * size
    series = np.full_like(size, -1.0 / 39916800.0)
    for coefficient in (1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0):
        series *= square
        series += coefficient
    series *= size
    out: NDArray[Any] = np.copysign(series, angle)
    return out


def _cosine(turns: NDArray[Any]) -> NDArray[Any]:
    return _sine(turns + 0.25)


def _length(v: NDArray[Any]) -> NDArray[Any]:
    out: NDArray[Any] = np.sqrt(v[..., 0] * v[..., 0] + v[..., 1] * v[..., 1] + v[..., 2] * v[..., 2])
    return out


def _cross(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def _waves(points: Float32, seed: int, octaves: int, frequency: float, per_octave: int = 4) -> Float32:
    """Fractal sum of plane waves at points, about -1 to 1: smooth, cheap and the same on every machine."""
    rng = np.random.default_rng(seed)
    directions = rng.random((octaves * per_octave, 3)) * 2.0 - 1.0
    directions /= _length(directions)[:, None] + 1e-3
    phases = rng.random(octaves * per_octave).astype(np.float32)
    octave = np.arange(octaves * per_octave) // per_octave
    waves = (directions * (frequency * 2.0**octave)[:, None]).astype(np.float32)
    amplitudes = (0.5 ** (octave + 1.0)).astype(np.float32)
    out = np.empty(len(points), np.float32)
    for start in range(0, len(points), _CHUNK):
        x, y, z = np.ascontiguousarray(points[start : start + _CHUNK].T)
        total = np.zeros(len(x), np.float32)
        for wave, phase, amplitude in zip(waves, phases, amplitudes, strict=True):
            total += amplitude * _sine(wave[0] * x + wave[1] * y + wave[2] * z + phase)
        out[start : start + _CHUNK] = total / np.float32(np.sqrt(per_octave))
    return out


def _grid_faces(rows: int, columns: int, *, wrap_rows: bool, wrap_columns: bool) -> UInt32:
    """Two triangles for each quad of a grid of vertices; rows and columns may close on themselves."""
    a = np.arange(rows if wrap_rows else rows - 1, dtype=np.uint32)
    b = np.arange(columns if wrap_columns else columns - 1, dtype=np.uint32)
    row0, row1 = (a * np.uint32(columns))[:, None], ((a + 1) % rows * np.uint32(columns))[:, None]
    column0, column1 = b[None, :], ((b + 1) % columns)[None, :]
    quads = np.stack([row0 + column0, row1 + column0, row1 + column1, row0 + column1], axis=-1).astype(
        np.uint32
    )
    return quads[..., [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


# ---------------------------------------------------------------------------------------------------- spheres


def _icosahedron() -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    corners = np.array(
        [
            [-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0],
            [0, -1, golden], [0, 1, golden], [0, -1, -golden], [0, 1, -golden],
            [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1],
        ]
    )  # fmt: skip
    triangles = np.array(
        [
            [0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
            [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
            [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1],
        ]
    )  # fmt: skip
    return corners / _length(corners)[:, None], triangles


def icosphere(*, faces: int) -> Mesh:
    """Unit sphere: an icosahedron whose faces are divided into n² triangles each. Closed.

    Parameters
    ----------
    faces : int
        At least so many triangles; 20·n² come back for the smallest n that suffices.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=20)
    >>> vertices.shape, faces.shape
    ((12, 3), (20, 3))
    """
    faces = _check_faces(faces, 1)
    n = int(np.ceil(np.sqrt(faces / 20.0)))
    corners, triangles = _icosahedron()
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(edges, axis=0)
    edge_number = {(int(a), int(b)): i for i, (a, b) in enumerate(edges)}
    inner = max((n - 1) * (n - 2) // 2, 0)
    first_edge, first_inner = 12, 12 + 30 * (n - 1)
    points = np.empty((first_inner + 20 * inner, 3), np.float32)
    points[:12] = corners
    step = np.arange(1, n) / n
    for number, (a, b) in enumerate(edges):
        at = first_edge + number * (n - 1)
        points[at : at + n - 1] = corners[a] + step[:, None] * (corners[b] - corners[a])

    # Lattice of a face: row i has i + 1 points; point (i, j) is corner0 + i·(corner1 − corner0)/n + j·(…)/n.
    i = np.repeat(np.arange(n + 1), np.arange(1, n + 2))
    first_of_row = np.arange(n + 2) * np.arange(1, n + 3) // 2
    j = np.arange(len(i)) - first_of_row[i]
    is_inner = (j > 0) & (j < i) & (i < n)
    up = np.flatnonzero(i < n)
    upward = np.stack([up, first_of_row[i[up] + 1] + j[up], first_of_row[i[up] + 1] + j[up] + 1], axis=1)
    down = np.flatnonzero((i < n) & (j < i))
    downward = np.stack([down, first_of_row[i[down] + 1] + j[down] + 1, down + 1], axis=1)
    lattice_faces = np.concatenate([upward, downward])

    out = np.empty((20 * n * n, 3), np.uint32)
    for number, (a, b, c) in enumerate(triangles):
        at = first_inner + number * inner
        ii, jj = i[is_inner][:, None] / n, j[is_inner][:, None] / n
        points[at : at + inner] = corners[a] + ii * (corners[b] - corners[a]) + jj * (corners[c] - corners[b])
        index = np.empty(len(i), np.int64)
        index[is_inner] = at + np.arange(inner)
        for side, (p, q) in (((j == 0), (a, b)), ((i == n), (b, c)), ((j == i), (a, c))):
            along = np.flatnonzero(side)
            key = (int(p), int(q)) if p < q else (int(q), int(p))
            run = first_edge + edge_number[key] * (n - 1) + np.arange(n - 1)
            index[along] = np.concatenate([[p], run if p < q else run[::-1], [q]])
        out[number * n * n : (number + 1) * n * n] = index[lattice_faces]
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK]
        chunk /= _length(chunk)[:, None]
    return points, out


def displaced_icosphere(*, faces: int, seed: int = 0, amplitude: float = 0.15, octaves: int = 6) -> Mesh:
    """Sphere with fractal bumps of every size: a stand-in for a scan. Closed.

    Parameters
    ----------
    faces : int
        At least so many triangles.
    seed : int
        Chooses the bumps.
    amplitude : float
        Height of the largest bumps, in radii.
    octaves : int
        Number of sizes of bumps, each half the one before.
    """
    points, out = icosphere(faces=faces)
    height = _waves(points, seed, octaves, 0.7)
    height *= np.float32(amplitude)
    height += np.float32(1.0)
    points *= height[:, None]
    return points, out


# ------------------------------------------------------------------------------------------------ open sheets


def terrain(*, faces: int, seed: int = 0, height: float = 0.35, octaves: int = 10) -> Mesh:
    """Fractal landscape over the square [-1, 1]² of x and z, Y up: one sheet with a border.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at; 2·n² come back.
    seed : int
        Chooses the landscape.
    height : float
        Height of the largest features.
    octaves : int
        Number of sizes of features, each half the one before.
    """
    n = max(int(np.rint(np.sqrt(_check_faces(faces, 2) / 2.0))), 1)
    rng = np.random.default_rng(seed)
    at = np.linspace(0.0, 1.0, n + 1)
    total: Float32 = np.zeros((n + 1, n + 1), np.float32)
    for octave in range(octaves):
        cells = 3 << octave
        lattice = (rng.random((cells + 2, cells + 2)) * 2.0 - 1.0).astype(np.float32)
        cell = np.minimum((at * cells).astype(np.int64), cells - 1)
        t: Float32 = (at * cells - cell).astype(np.float32)
        t *= t * t * (t * (t * np.float32(6.0) - np.float32(15.0)) + np.float32(10.0))
        rest = np.float32(1.0) - t
        rows = lattice[cell] * rest[:, None] + lattice[cell + 1] * t[:, None]
        layer: Float32 = rows[:, cell] * rest + rows[:, cell + 1] * t
        if octave < 3:
            np.abs(layer, out=layer)  # ridges
            np.subtract(np.float32(0.5), layer, out=layer)
        layer *= np.float32(height * 0.5**octave)
        total += layer
    points = np.empty((n + 1, n + 1, 3), np.float32)
    points[..., 0] = (2.0 * at - 1.0)[None, :]
    points[..., 1] = total
    points[..., 2] = (2.0 * at - 1.0)[:, None]
    return points.reshape(-1, 3), _grid_faces(n + 1, n + 1, wrap_rows=False, wrap_columns=False)


def fan(*, faces: int, height: float = 0.5) -> Mesh:
    """Cone whose triangles all meet in one vertex: the worst valence there can be. Open below.

    Parameters
    ----------
    faces : int
        Number of triangles, which is the valence of the tip.
    height : float
        Height of the tip over the rim of radius 1.
    """
    n = _check_faces(faces, 3)
    turns = np.arange(n) / n
    points = np.zeros((n + 1, 3), np.float32)
    points[0, 1] = height
    points[1:, 0] = _cosine(turns)
    points[1:, 2] = -_sine(turns)
    rim = np.arange(n, dtype=np.uint32)
    return points, np.stack([np.zeros_like(rim), rim + 1, (rim + 1) % n + 1], axis=1).astype(np.uint32)


def soup(*, faces: int, seed: int = 0, size: float = 0.05) -> Mesh:
    """Random triangles in the cube [-1, 1]³ that share nothing: three vertices each.

    Parameters
    ----------
    faces : int
        Number of triangles.
    seed : int
        Chooses them.
    size : float
        Largest offset of a corner from the triangle's place, along each axis.
    """
    n = _check_faces(faces, 1)
    rng = np.random.default_rng(seed)
    centers = rng.random((n, 1, 3)) * 2.0 - 1.0
    corners = centers + (rng.random((n, 3, 3)) * 2.0 - 1.0) * size
    return corners.astype(np.float32).reshape(-1, 3), np.arange(3 * n, dtype=np.uint32).reshape(-1, 3)


# -------------------------------------------------------------------------------------------- closed surfaces


def torus_knot(
    *, faces: int, seed: int = 0, p: int = 2, q: int = 3, radius: float = 0.22, amplitude: float = 0.02
) -> Mesh:
    """Tube along a (p, q) torus knot with a fine relief. Closed, genus 1.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at.
    seed : int
        Chooses the relief.
    p, q : int
        Times the knot winds about the axis, and through the hole.
    radius : float
        Radius of the tube.
    amplitude : float
        Height of the relief.
    """
    around = max(int(np.rint(np.sqrt(_check_faces(faces, 18) / 2.0 / 12.0))), 3)
    along = max(int(np.rint(faces / 2.0 / around)), 3)
    turns = np.arange(along) / along

    def curve(at: NDArray[np.float64]) -> NDArray[np.float64]:
        ring = 0.7 + 0.3 * _cosine(q * at)
        return np.stack([ring * _cosine(p * at), 0.3 * _sine(q * at), ring * _sine(p * at)], axis=1)

    center = curve(turns)
    tangent = curve(turns + 1e-4) - curve(turns - 1e-4)
    tangent /= _length(tangent)[:, None]
    ring = np.stack([0.7 * _cosine(p * turns), np.zeros(along), 0.7 * _sine(p * turns)], axis=1)
    outward = center - ring  # the torus' own normal: it closes on itself after one round
    outward -= tangent * (outward * tangent).sum(axis=1)[:, None]
    outward /= _length(outward)[:, None]
    sideways = _cross(outward, tangent)

    angle = np.arange(around) / around
    direction = (
        _cosine(angle)[None, :, None] * outward[:, None, :]
        + _sine(angle)[None, :, None] * sideways[:, None, :]
    )
    points = (center[:, None, :] + radius * direction).astype(np.float32).reshape(-1, 3)
    if amplitude > 0.0:
        relief = _waves(points, seed, 4, 4.0) * np.float32(amplitude)
        points += relief[:, None] * direction.astype(np.float32).reshape(-1, 3)
    return points, _grid_faces(along, around, wrap_rows=True, wrap_columns=True)


def cad_part(*, faces: int, seed: int = 0) -> Mesh:
    """Machined part: a toothed wheel with hub, bore, chamfers and recess. Closed, genus 1.

    Flat faces, sharp creases and triangles far longer than wide, as CAD kernels tessellate them.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at.
    seed : int
        Chooses the number of teeth and the proportions.
    """
    rng = np.random.default_rng(seed)
    teeth = int(rng.integers(16, 48))
    bore, hub, recess = 0.12 + 0.08 * rng.random(), 0.32 + 0.06 * rng.random(), 0.72 + 0.05 * rng.random()
    # The outline in (radius, y), once around the material: bore, hub, recess, rim, teeth, and back below.
    outline = [
        (bore, -0.28), (bore, 0.28), (bore + 0.02, 0.30), (hub - 0.02, 0.30), (hub, 0.28),
        (hub, 0.06), (recess, 0.06), (recess, 0.16), (0.88, 0.16), (None, 0.16), (None, -0.16),
        (0.88, -0.16), (recess, -0.16), (recess, -0.06), (hub, -0.06), (hub, -0.28), (hub - 0.02, -0.30),
        (bore + 0.02, -0.30),
    ]  # fmt: skip
    around = max(int(np.rint(_check_faces(faces, 144) / (2.0 * len(outline)))), 4)
    turns = np.arange(around) / around
    phase = turns * teeth % 1.0
    tooth = np.clip(np.minimum(phase, 1.0 - phase) * 6.0 - 1.0, 0.0, 1.0)  # trapezoid: land, flank, root
    toothed = 0.92 + 0.08 * tooth
    points = np.empty((len(outline), around, 3), np.float32)
    for row, (radius, y) in enumerate(outline):
        r = toothed if radius is None else np.full(around, radius)
        points[row, :, 0] = r * _cosine(turns)
        points[row, :, 1] = y
        points[row, :, 2] = -r * _sine(turns)
    return points.reshape(-1, 3), _grid_faces(len(outline), around, wrap_rows=True, wrap_columns=True)


def islands(*, faces: int, count: int = 1000, seed: int = 0) -> Mesh:
    """Many separate small pieces scattered in a cube: spheres, or single triangles where there is one each.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at, over all pieces.
    count : int
        Number of pieces.
    seed : int
        Chooses places and sizes.
    """
    if not 1 <= count <= _check_faces(faces, 1):
        raise ArgumentError(f"count: must be between 1 and faces ({faces}), not {count}")
    if faces // count < 4:
        points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
        corners = np.array([[0, 1, 2]], np.uint32)
    elif faces // count < 20:
        points = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float32)
        corners = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.uint32)
    else:
        n = max(int(np.rint(np.sqrt(faces / count / 20.0))), 1)
        points, corners = icosphere(faces=20 * n * n)
    rng = np.random.default_rng(seed)
    cells = int(np.ceil(np.cbrt(count) - 1e-9))
    cell = np.arange(count)
    lattice = np.stack([cell % cells, cell // cells % cells, cell // cells**2], axis=1)
    place = (lattice + 0.5) / cells * 2.0 - 1.0
    size = (0.3 + 0.6 * rng.random(count)) / cells / np.sqrt(3.0)
    out = (place[:, None, :] + size[:, None, None] * points[None, :, :]).astype(np.float32)
    index = corners[None, :, :] + (np.arange(count, dtype=np.uint32) * np.uint32(len(points)))[:, None, None]
    return out.reshape(-1, 3), index.reshape(-1, 3).astype(np.uint32)


def foliage(*, faces: int, seed: int = 0) -> Mesh:
    """A tree: leaves of two triangles each in a crown of several balls, and a trunk that is open at both ends.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at. One in twenty goes to the trunk.
    seed : int
        Chooses places, directions and sizes of the leaves.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.foliage(faces=2_000)
    >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(preserve_area=True))
    """
    count = max((_check_faces(faces, 40) - faces // 20) // 2, 1)
    rng = np.random.default_rng(seed)

    def directions(rows: int) -> NDArray[np.float64]:
        points = 2.0 * rng.random((rows, 3)) - 1.0
        points /= np.maximum(_length(points), 1e-3)[:, None]
        return points

    balls = directions(12) * [0.5, 0.35, 0.5] + [0.0, 0.35, 0.0]
    ball = rng.integers(0, len(balls), count)
    # The square root of a number of 0 to 1 prefers the outside of a ball, where the light is.
    place = balls[ball] + directions(count) * (0.3 * np.sqrt(rng.random(count)))[:, None]
    normal, other = directions(count), directions(count)
    right = _cross(normal, other)
    right /= np.maximum(_length(right), 1e-3)[:, None]
    up = _cross(normal, right)
    size = (0.6 + 0.8 * rng.random(count)) * np.sqrt(3.0 / count)
    right, up = right * (0.5 * size)[:, None], up * size[:, None]
    leaves = np.stack([place, place + up + right, place + 2.0 * up, place + up - right], axis=1).reshape(
        -1, 3
    )
    leaf = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]
    # Twice as many rings as sides.
    sides = max(int(np.rint(np.sqrt(faces / 80.0))), 3)
    rings = max(int(np.rint(faces / 40.0 / sides)), 1)
    ring, side = np.divmod(np.arange((rings + 1) * sides), sides)
    turns, height = side / sides, ring / rings
    radius = 0.09 - 0.05 * height
    trunk = np.stack([radius * _cosine(turns), 1.3 * height - 0.95, -radius * _sine(turns)], axis=1)
    tube = _grid_faces(rings + 1, sides, wrap_rows=False, wrap_columns=True)
    vertices = np.concatenate([trunk, leaves]).astype(np.float32)
    return vertices, np.concatenate([tube, leaf.reshape(-1, 3) + len(trunk)]).astype(np.uint32)


def flat_shaded(vertices: NDArray[Any], faces: NDArray[Any]) -> tuple[Float32, UInt32, Float32]:
    """Give every triangle its own three vertices and its own normal.

    Parameters
    ----------
    vertices : (N, 3) array
        Positions.
    faces : (M, 3) integer array
        Triangles.

    Returns
    -------
    vertices : (3·M, 3) float32
    faces : (M, 3) uint32
    normals : (3·M, 3) float32
        Unit normals; pass them on as ``normals=``, or welding would smooth the mesh again.

    Examples
    --------
    >>> v, f, n = nrs.shapes.flat_shaded(*nrs.shapes.icosphere(faces=20))
    >>> len(v), len(f), len(n)
    (60, 20, 60)
    """
    corners = np.asarray(vertices, np.float32)[np.asarray(faces)]
    normal = _cross(
        corners[:, 1].astype(np.float64) - corners[:, 0], corners[:, 2].astype(np.float64) - corners[:, 0]
    )
    length = _length(normal)
    normal /= np.where(length > 0.0, length, 1.0)[:, None]
    normal[length == 0.0] = (0.0, 1.0, 0.0)
    normals = np.repeat(normal.astype(np.float32), 3, axis=0)
    return corners.reshape(-1, 3), np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3), normals


# ------------------------------------------------------------------------------------------ implicit surfaces

#: Corners of a grid cell as offsets (x, y, z), and its six tetrahedra about the diagonal from corner 0 to
#: corner 7, all of positive volume. Neighbouring cells divide their common face alike.
_CORNERS: Final = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
_TETRAHEDRA: Final = ((0, 1, 3, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 6, 4, 7), (0, 4, 5, 7), (0, 5, 1, 7))


_Edge: TypeAlias = tuple[int, int]
_EdgeTriangle: TypeAlias = tuple[_Edge, _Edge, _Edge]


def _tetrahedron_cases() -> list[list[_EdgeTriangle]]:
    """Triangles of each of the 16 sign patterns of a positive tetrahedron, as triples of its edges.

    Bit k of the pattern is set when corner k is inside; an edge is (inside corner, outside corner). Normals
    point out of the inside.
    """
    cases: list[list[_EdgeTriangle]] = [[] for _ in range(16)]
    for pattern in range(1, 15):
        order = sorted(range(4), key=lambda k: pattern >> k & 1 == 0)  # inside corners first
        a, b, c, d = order
        inside = bin(pattern).count("1")
        triangles: list[_EdgeTriangle]
        if inside == 1:
            triangles = [((a, b), (a, c), (a, d))]
        elif inside == 2:
            triangles = [((a, c), (a, d), (b, d)), ((a, c), (b, d), (b, c))]
        else:
            triangles = [((a, d), (b, d), (c, d))]
        if sum(order[x] > order[y] for x in range(4) for y in range(x + 1, 4)) % 2:
            triangles = [(t[0], t[2], t[1]) for t in triangles]
        cases[pattern] = triangles
    return cases


_Field: TypeAlias = Callable[[Float32, Float32, Float32], Float32]


def _polygonize(field: _Field, cells: int) -> Mesh:
    """Surface ``field = 0`` in the cube [-1, 1]³ by marching tetrahedra over ``cells``³ cells.

    Closed and manifold by construction, as long as the field is positive on the cube's border: every vertex
    lies strictly inside an edge of the grid. After Doi and Koide, IEICE Transactions E74 (1991).
    """
    side = cells + 1
    axis = np.linspace(-1.0, 1.0, side).astype(np.float32)
    cases = _tetrahedron_cases()

    def layer(z: int) -> Float32:
        values = field(axis[None, :], axis[:, None], axis[z])
        return np.where(np.abs(values) < 1e-6, np.float32(1e-6), values)

    keys: list[NDArray[np.int64]] = []
    weights: list[Float32] = []
    triangles: list[NDArray[np.int64]] = []
    below = layer(0)
    for z in range(cells):
        above = layer(z + 1)
        slab = np.stack([below, above])
        corner = [slab[c[2], c[1] : c[1] + cells, c[0] : c[0] + cells] for c in _CORNERS]
        sign = np.zeros((cells, cells), np.uint8)
        for c in range(8):
            sign |= (corner[c] < 0).astype(np.uint8) << np.uint8(c)
        active = np.flatnonzero((sign != 0) & (sign != 255))
        row, column = active // cells, active % cells
        values = np.stack([c.ravel()[active] for c in corner])
        number = ((z * side + row) * side + column).astype(np.int64)
        ids = np.stack([number + (c[2] * side + c[1]) * side + c[0] for c in _CORNERS])
        signs = sign.ravel()[active]
        for tetrahedron in _TETRAHEDRA:
            pattern = np.zeros(len(active), np.uint8)
            for k, c in enumerate(tetrahedron):
                pattern |= (signs >> np.uint8(c) & np.uint8(1)) << np.uint8(k)
            for code in range(1, 15):
                here = np.flatnonzero(pattern == code)
                if len(here) == 0:
                    continue
                for triangle in cases[code]:
                    corners = []
                    for inner, outer in triangle:
                        # inner < 0 < outer; the key names the edge by its lower end and its direction
                        a, b = tetrahedron[inner], tetrahedron[outer]
                        low, high = min(a, b), max(a, b)
                        corners.append(ids[low][here] * 8 + (low ^ high))
                        f, g = values[low][here], values[high][here]
                        weights.append(f / (f - g))
                    triangles.append(np.stack(corners, axis=1))
                    keys.extend(corners)
        below = above
    if not keys:
        return np.empty((0, 3), np.float32), np.empty((0, 3), np.uint32)
    edges, first = np.unique(np.concatenate(keys), return_index=True)
    weight = np.clip(np.concatenate(weights)[first], 0.05, 0.95)
    start, direction = edges >> 3, edges & 7
    points = np.empty((len(edges), 3), np.float32)
    steps = np.float32(2.0 / cells)
    for k, index in enumerate((start % side, start // side % side, start // side**2)):
        points[:, k] = axis[index] + steps * weight * (direction >> k & 1)
    faces = np.searchsorted(edges, np.concatenate(triangles)).astype(np.uint32)
    return points, faces


def gyroid_shell(*, faces: int, seed: int = 0, periods: float = 2.0, thickness: float = 0.5) -> Mesh:
    """Gyroid wall cut out of a ball: closed, of high genus, thin everywhere.

    Parameters
    ----------
    faces : int
        Number of triangles aimed at.
    seed : int
        Shifts the gyroid inside the ball.
    periods : float
        Periods of the gyroid across the ball.
    thickness : float
        Half thickness of the wall, in values of the gyroid's function (0 to 1.4).
    """
    _check_faces(faces, 1000)
    shift = np.random.default_rng(seed).random(3).astype(np.float32)
    scale = np.float32(periods / 2.0)

    def field(x: Float32, y: Float32, z: Float32) -> Float32:
        a, b, c = x * scale + shift[0], y * scale + shift[1], z * scale + shift[2]
        gyroid = _sine(a) * _cosine(b) + _sine(b) * _cosine(c) + _sine(c) * _cosine(a)
        ball = np.sqrt(x * x + y * y + z * z) - np.float32(0.95)
        wall: Float32 = np.maximum(np.abs(gyroid) - np.float32(thickness), ball * np.float32(8.0))
        return wall

    probe = 64
    found = max(len(_polygonize(field, probe)[1]), 1)
    cells = max(int(np.rint(probe * np.sqrt(faces / found))), 12)
    return _polygonize(field, cells)


#: The shapes that take nothing but ``faces`` and ``seed``, by name.
SHAPES: Final[dict[str, Callable[..., Mesh]]] = {
    "cad_part": cad_part,
    "displaced_icosphere": displaced_icosphere,
    "foliage": foliage,
    "gyroid_shell": gyroid_shell,
    "islands": islands,
    "soup": soup,
    "terrain": terrain,
    "torus_knot": torus_knot,
}
