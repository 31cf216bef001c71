"""The meshes under test by name: scans, procedural shapes, and small solids written out here."""

from __future__ import annotations

import functools

import numpy as np

from . import data
from .data import Mesh


def _mesh(name: str, arrays: tuple[np.ndarray, np.ndarray]) -> Mesh:
    vertices, faces = np.asarray(arrays[0], np.float32), np.asarray(arrays[1], np.int64)
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Mesh(name, vertices, faces)


def grid(columns: int, rows: int, height: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle in the plane y = ``height`` (+Y up) of 2·columns·rows triangles."""
    x, z = np.meshgrid(np.linspace(-1, 1, columns + 1), np.linspace(-1, 1, rows + 1))
    vertices = np.stack([x, np.full_like(x, height), z], axis=-1).reshape(-1, 3)
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    b, c, d = a + columns + 1, a + columns + 2, a + 1
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def cube(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The closed cube [−1, 1]³ of 12·steps² triangles: flat regions, sharp edges."""
    vertices, faces = grid(steps, steps, 1.0)
    sides = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            turned = np.roll(vertices, axis + 1, axis=1) * sign
            order = faces if sign > 0 else faces[:, ::-1]
            sides.append((turned, order))
    offset = np.cumsum([0] + [len(v) for v, _ in sides[:-1]])
    soup = np.concatenate([v for v, _ in sides])
    all_faces = np.concatenate([f + o for (_, f), o in zip(sides, offset, strict=True)])
    unique, inverse = np.unique(np.round(soup, 9), axis=0, return_inverse=True)
    return unique, inverse.ravel()[all_faces]


def soup_of(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same triangles, each with its own three vertices."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def spikes() -> tuple[np.ndarray, np.ndarray]:
    """A sphere of 8,000 triangles with needles: every 61st vertex stands out by half the radius."""
    import nanite_rs as nrs

    vertices, faces = nrs.shapes.displaced_icosphere(faces=8_000, seed=8)
    vertices = np.array(vertices)
    vertices[::61] *= 1.5
    return vertices, faces


def sheets() -> tuple[np.ndarray, np.ndarray]:
    """Two parallel sheets nearer to each other than any sample spacing, and ribs thinner still across them."""
    low, faces = grid(64, 64)
    high, _ = grid(64, 64, 1e-4)
    rib, rib_faces = grid(200, 1)
    ribs = [(rib * [1, 1, 2e-5] + [0, 0, z])[:, [0, 2, 1]] + [0, 0, z] for z in (-0.5, 0.01, 0.4)]
    parts = [(low, faces), (high, faces[:, ::-1]), *((r, rib_faces) for r in ribs)]
    offset = np.cumsum([0] + [len(v) for v, _ in parts[:-1]])
    return np.concatenate([v for v, _ in parts]), np.concatenate(
        [f + o for (_, f), o in zip(parts, offset, strict=True)]
    )


def needles() -> tuple[np.ndarray, np.ndarray]:
    """A floor with 900 needles, each a tenth as tall as the floor is wide and 1e-5 of that thick."""
    floor, faces = grid(60, 60)
    rng = np.random.default_rng(9)
    base = rng.uniform(-0.95, 0.95, (900, 1, 3)) * [1, 0, 1]
    corners = np.array([[1, 0, 0], [-0.5, 0, 0.8], [-0.5, 0, -0.8], [0, 0, 0]]) * 1e-6
    tips = base + corners + np.array([0, 0, 0, 0.2])[:, None] * [0, 1, 0]
    sides = np.array([[0, 3, 1], [1, 3, 2], [2, 3, 0]])
    index = len(floor) + 4 * np.arange(900)[:, None, None] + sides
    return np.concatenate([floor, tips.reshape(-1, 3)]), np.concatenate([faces, index.reshape(-1, 3)])


@functools.cache
def generated(name: str) -> Mesh:
    """A generated mesh by name."""
    import nanite_rs as nrs

    shapes = nrs.shapes
    makers = {
        "sphere": lambda: shapes.displaced_icosphere(faces=60_000, seed=3),
        "fine sphere": lambda: shapes.displaced_icosphere(faces=1_000_000, seed=3),
        "fine knot": lambda: shapes.torus_knot(faces=600_000),
        "fine part": lambda: shapes.cad_part(faces=400_000),
        "small sphere": lambda: shapes.displaced_icosphere(faces=5_000, seed=4),
        "knot": lambda: shapes.torus_knot(faces=60_000),
        "gyroid": lambda: shapes.gyroid_shell(faces=60_000),
        "terrain": lambda: shapes.terrain(faces=50_000, seed=5),
        "part": lambda: shapes.cad_part(faces=30_000),
        "flat sphere": lambda: shapes.flat_shaded(*shapes.displaced_icosphere(faces=20_000, seed=3))[:2],
        "soup": lambda: shapes.soup(faces=5_000, seed=6),
        "cube": lambda: cube(48),
        "cube soup": lambda: soup_of(*cube(32)),
        "plane": lambda: grid(128, 128),
        "ribbon": lambda: grid(4000, 3),
        "spikes": spikes,
        "sheets": sheets,
        "needles": needles,
    }
    return _mesh(name, makers[name]())


CLOSED = ("sphere", "knot", "gyroid", "cube", "part")
"""Generated meshes whose every edge has two opposite halves."""

GENERATED = (*CLOSED, "terrain", "flat sphere", "soup", "cube soup", "plane", "ribbon")
"""All generated meshes that property tests walk."""

THIN = ("spikes", "sheets", "needles")
"""Generated meshes with more detail than any spacing of samples sees."""


def subject(name: str) -> Mesh:
    """A real mesh (a scan by name, any by ``folder/asset``) or a generated one; skips the test if it is absent."""
    if "/" in name:
        return data.model(name)
    return data.scan(name) if name in data.SCANS else generated(name)


@functools.cache
def built(name: str, **options):
    """The built mesh of a subject."""
    import nanite_rs as nrs

    mesh = subject(name)
    return nrs.NaniteMesh.from_arrays(
        mesh.vertices, mesh.faces, options=nrs.BuildOptions(**options), progress=False
    )
