"""Numerical stability: what a change of units, place, direction or order may change, and what it must not."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import distance, subjects, topology
from oracles.dag import Dag

QUALITIES = ("fast", "best")
ERRORS = ("quadric", "bound")
every_option = pytest.mark.parametrize(
    ("quality", "error"), [(quality, error) for quality in QUALITIES for error in ERRORS]
)

SHAPES = {
    "sphere": lambda: nrs.shapes.displaced_icosphere(faces=8_000, seed=2),
    "knot": lambda: nrs.shapes.torus_knot(faces=8_000),
    "part": lambda: nrs.shapes.cad_part(faces=8_000),
    "foliage": lambda: nrs.shapes.foliage(faces=4_000),
}


@functools.cache
def shape(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices that need float64, but no more than 40 bits, so that much can be added to them without rounding."""
    vertices, faces = SHAPES[name]()
    vertices = np.round(np.asarray(vertices, np.float64) * 2.0**36) * 2.0**-36
    vertices += np.array([1.0, 3.0, 5.0]) * 2.0**-36
    return vertices, np.asarray(faces, np.int64)


def build(vertices: np.ndarray, faces: np.ndarray, **options) -> nrs.NaniteMesh:
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(**options), progress=False)
    mesh.check()
    return mesh


def assert_same(a: nrs.NaniteMesh, b: nrs.NaniteMesh, scale: float, offset: np.ndarray) -> None:
    """The DAG of `b` is that of `a`, bit for bit, but for the frame: object = scale · object + offset."""
    one, two = Dag.of(a), Dag.of(b)
    for column in ("ids", "level", "group", "origin", "triangles"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    np.testing.assert_array_equal(one.error * scale, two.error)
    np.testing.assert_array_equal(one.group_error * scale, two.group_error)
    levels = np.unique(one.group_error[np.isfinite(one.group_error)])
    for error in [0.0, *levels[:: max(len(levels) // 6, 1)], levels[-1]]:
        left, right = a.cut(error=float(error)), b.cut(error=float(error * scale))
        np.testing.assert_array_equal(left.cluster_ids, right.cluster_ids)
        np.testing.assert_array_equal(left.faces, right.faces)
        np.testing.assert_array_equal(left.normals, right.normals)
        np.testing.assert_array_equal(np.asarray(left.vertices, float) * scale + offset, right.vertices)


@every_option
@pytest.mark.parametrize("name", SHAPES)
def test_powers_of_two_change_nothing(name: str, quality: str, error: str) -> None:
    options = {"quality": quality, "error": error, "preserve_area": name == "foliage"}
    vertices, faces = shape(name)
    for dtype, powers in ((np.float64, (-300, 20)), (np.float32, (-60, 100))):
        given = vertices.astype(dtype)
        base = build(given, faces, **options)
        for power in powers:
            scale = dtype(2.0) ** power
            assert_same(base, build(given * scale, faces, **options), float(scale), np.zeros(3))


@every_option
@pytest.mark.parametrize("name", SHAPES)
def test_exact_translations_change_nothing(name: str, quality: str, error: str) -> None:
    options = {"quality": quality, "error": error, "preserve_area": name == "foliage"}
    vertices, faces = shape(name)
    base = build(vertices, faces, **options)
    for offset in ([-4321.0, 1234.5, 2.0**-20], [-(2.0**14), 2.0**14, 3.0]):
        moved = vertices + offset
        np.testing.assert_array_equal(moved - offset, vertices)
        assert_same(base, build(moved, faces, **options), 1.0, np.array(offset))


TURNS = (
    (3, -5, 7, 4),
    (2, 1, -3, 8),
    (9, 2, 4, -1),
    (1, -6, -2, 5),
    (7, 3, -8, 2),
    (4, 9, 1, -7),
    (5, 2, 2, 3),
)
"""Rotations about no axis in particular, as quaternions of whole numbers."""


def turned(vertices: np.ndarray, turn: tuple[int, int, int, int]) -> np.ndarray:
    """The same bits on every machine: no BLAS, whose kernels add in orders of their own."""
    w, x, y, z = turn
    n = w * w + x * x + y * y + z * z
    rows = [
        [n - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), n - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), n - 2 * (x * x + y * y)],
    ]
    return np.stack(
        [(vertices[:, 0] * a + vertices[:, 1] * b + vertices[:, 2] * c) / n for a, b, c in rows], 1
    )


def variants(vertices: np.ndarray, faces: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """The same mesh in other units, places, directions and orders; and the factor that its lengths have."""
    rng = np.random.default_rng(1)
    order = rng.permutation(len(vertices))
    return {
        "scale 1e-6": (vertices * 1e-6, faces, 1e-6),
        "scale 0.37": (vertices * 0.37, faces, 0.37),
        "scale 1e6": (vertices * 1e6, faces, 1e6),
        "translation 1e7": (vertices + np.array([1e7, -1e7, 12345.678]), faces, 1.0),
        "vertex order": (vertices[order], np.argsort(order)[faces], 1.0),
        "face order": (vertices, faces[rng.permutation(len(faces))], 1.0),
        "rotation": (turned(vertices, TURNS[0]), faces, 1.0),
    }


FLOOR = 2e-4
"""Distances below are not told apart: a ten-thousandth of the size, as flat parts have next to none."""
REDUCTIONS = np.array([0.5, 0.75, 0.9])
"""Of the cuts whose stated errors and root mean squares are compared one by one."""
BESIDE = np.array([-0.04, -0.02, 0.0, 0.02, 0.04])
"""Reductions of the base beside each of those: a step of its errors may come so much earlier or later."""


def errors(mesh: nrs.NaniteMesh, scale: float, reductions: np.ndarray) -> np.ndarray:
    """Stated errors and root mean squares of cuts, as two rows."""
    full = mesh.cut(error=0.0)
    source = np.asarray(full.vertices, float) / scale
    center = source.mean(axis=0)
    found = []
    for reduction in reductions.ravel():
        cut = mesh.cut(target_reduction=float(reduction), exact=False)
        surface = (np.asarray(cut.vertices, float) / scale - center, cut.faces)
        rms = np.sqrt(np.mean(distance.one_sided(surface, (source - center, full.faces), 20_000) ** 2))
        found.append((cut.error / scale, rms))
    return np.array(found).T.reshape(2, *reductions.shape) + FLOOR


def means(mesh: nrs.NaniteMesh, scale: float) -> np.ndarray:
    """Triangles of all levels, mean error of groups and of cuts.

    What a cut states is the error of its worst group, and that is chance: means of several say more.
    """
    d = Dag.of(mesh)
    made = d.group_error[np.isfinite(d.group_error)]
    stated = np.array(
        [mesh.cut(target_reduction=reduction, exact=False).error for reduction in np.linspace(0.4, 0.95, 12)]
    )
    mean = [np.exp(np.log(lengths / scale + FLOOR).mean()) for lengths in (made, stated)]
    return np.array([d.triangles.sum(), *mean])


def away(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """By how much the larger of each two exceeds the smaller; the largest of each row."""
    return np.expm1(np.abs(np.log(a / b)).reshape(len(a), -1).max(axis=1))


MOST = {
    ("sphere", "fast"): (0.06, 0.08, 0.26, 0.05),
    ("sphere", "best"): (0.06, 0.04, 0.15, 0.035),
    ("knot", "fast"): (0.04, 0.05, 0.21, 0.045),
    ("knot", "best"): (0.05, 0.09, 0.42, 0.035),
    ("part", "fast"): (0.07, 0.06, 0.23, 0.18),
    ("part", "best"): (0.055, 0.06, 0.3, 0.035),
    ("foliage", "fast"): (0.09, 0.27, 0.55, 0.08),
    ("foliage", "best"): (0.095, 0.16, 1.0, 0.65),
}
"""How far the mean error of groups, that of cuts, stated errors and root mean squares of cuts may differ.

One group of leaves that goes sooner or later is most of what a cut of the foliage states. So these show where the
steps are; `MOST_BESIDE` holds how high they are."""
MOST_TURNED = (0.36, 0.58, 1.6, 0.55)
"""The same of the part, built fast and turned, in the mean of `TURNS`. Faces along axes are flat to the last bit:
their edges cost nothing, and go in the order of the faces. Turned they cost what rounding leaves, and others go
first: what one turn finds is chance, 14 to 76 % in stated errors of cuts. A quarter turn, which is exact, stays
within `MOST`."""
MOST_BESIDE = {"sphere": (0.18, 0.035), "knot": (0.18, 0.035), "part": (0.12, 0.035), "foliage": (0.3, 0.035)}
"""How far stated errors and root mean squares may be outside of what the base has at the reductions beside."""


@every_option
@pytest.mark.parametrize("name", SHAPES)
def test_units_place_direction_and_order_matter_little(name: str, quality: str, error: str) -> None:
    options = {"quality": quality, "error": error, "preserve_area": name == "foliage"}
    vertices, faces = shape(name)
    base = build(vertices, faces, **options)
    base_means = means(base, 1.0)
    base_errors = errors(base, 1.0, REDUCTIONS[:, None] + BESIDE)
    whats = ("groups", "cuts", "stated", "rms", "stated beside", "rms beside")

    def differences(mesh: nrs.NaniteMesh, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of ratios, of means and of errors of cuts; and how far these are from the base's beside."""
        found = errors(mesh, scale, REDUCTIONS)
        nearest = np.clip(found, base_errors.min(axis=2), base_errors.max(axis=2))
        log = np.log(np.concatenate([means(mesh, scale), (found / base_errors[..., 2]).ravel()]))
        log[:3] -= np.log(base_means)
        return log, away(found, nearest)

    def check(variant: str, log: np.ndarray, beside: np.ndarray, most: tuple[float, ...]) -> None:
        groups = (log[:1], log[1:2], log[2:3], *log[3:].reshape(2, -1))
        same = np.expm1([np.abs(group).max() for group in groups])
        print(
            f"{name} {quality} {error} {variant}:", *(f"{r:.2%}" for r in same), *(f"{r:.2%}" for r in beside)
        )
        # Levels follow what collapses cost, which rounding changes, and not counts.
        assert same[0] < 0.008, (variant, "triangles", same)
        for r, limit, what in zip((*same[1:], *beside), (*most, *MOST_BESIDE[name]), whats, strict=True):
            assert r < limit, (variant, what, same, beside)
        if variant == "vertex order":
            assert max(same) == 0.0

    for variant, (v, f, scale) in variants(vertices, faces).items():
        if (name, quality, variant) == ("part", "fast", "rotation"):
            turns = [differences(build(turned(vertices, turn), f, **options), scale) for turn in TURNS]
            log, beside = (np.array(rows) for rows in zip(*turns, strict=True))
            check(variant, log.mean(axis=0), beside.max(axis=0), MOST_TURNED)
        else:
            check(variant, *differences(build(v, f, **options), scale), MOST[name, quality])


def with_copies(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A sphere whose every triangle has its own vertices, apart from its neighbours' by about `gap`."""
    vertices, faces = subjects.soup_of(*nrs.shapes.displaced_icosphere(faces=2_000))
    rng = np.random.default_rng(4)
    return vertices + gap * rng.uniform(-1, 1, vertices.shape), faces


def welded_nearly(gap: float) -> tuple[np.ndarray, np.ndarray]:
    """A surface with vertices `gap` beside each other: edges of that length, triangles with next to no area."""
    vertices, faces = nrs.shapes.torus_knot(faces=3_000)
    vertices, faces = np.array(vertices, float), np.array(faces, np.int64)
    for f in range(0, len(faces), 7):
        a, b, c = faces[f]
        middle = vertices[a] + gap
        vertices = np.concatenate([vertices, middle[None]])
        n = len(vertices) - 1
        faces[f] = (n, b, c)
        faces = np.concatenate([faces, [[a, b, n], [a, n, c]]])
    return vertices, faces


def slivers(aspect: float, count: int = 3000) -> tuple[np.ndarray, np.ndarray]:
    """A rippled sheet of triangles that are `aspect` times as long as wide."""
    vertices, faces = subjects.grid(count, 1)
    vertices = vertices * [count / aspect, 1.0, 1.0]
    vertices[:, 1] = 1e-3 * np.sin(np.arange(len(vertices)))
    return vertices, faces


def mixed(size: float) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1 with one of radius `size` beside it."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=3_000)
    vertices = np.asarray(vertices, float)
    return np.concatenate([vertices, vertices * size + 1.5]), np.concatenate(
        [faces, faces + np.uint32(len(vertices))]
    )


def scaled(factor: float, dtype: type) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = nrs.shapes.cad_part(faces=3_000)
    with np.errstate(under="ignore"):
        return (np.asarray(vertices, np.float64) * factor).astype(dtype), faces


EXTREMES = {
    "copies 1e-9 apart": lambda: with_copies(1e-9),
    "copies 1e-7 apart": lambda: with_copies(1e-7),
    "copies 1e-5 apart": lambda: with_copies(1e-5),
    "edges of 1e-9": lambda: welded_nearly(1e-9),
    "edges of 1e-6": lambda: welded_nearly(1e-6),
    "slivers of 1e4": lambda: slivers(1e4),
    "slivers of 1e6": lambda: slivers(1e6),
    "features of 1e-4": lambda: mixed(1e-4),
    "features of 1e-6": lambda: mixed(1e-6),
    "float32 denormals": lambda: scaled(1e-40, np.float32),
    "float32 near its limit": lambda: scaled(1e38, np.float32),
    "float64 denormals": lambda: scaled(1e-310, np.float64),
    "float64 1e-200": lambda: scaled(1e-200, np.float64),
    "float64 near the largest allowed": lambda: scaled(1e300, np.float64),
}


@every_option
@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_are_built_with_errors_that_hold(name: str, quality: str, error: str) -> None:
    vertices, faces = EXTREMES[name]()
    mesh = build(vertices, faces, quality=quality, error=error)
    full = mesh.cut(error=0.0)
    root = mesh.cut(error=float("inf"))
    assert len(root.faces) <= max(0.01 * len(full.faces), 8)
    assert not mesh.report.stuck
    # Powers of two bring the numbers to where libigl can take them.
    largest = np.abs(np.asarray(full.vertices, float)).max()
    unit = 2.0 ** np.clip(-np.floor(np.log2(largest)), -1000, 1000)
    source = (np.asarray(full.vertices, float) * unit, full.faces)
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        assert np.isfinite(cut.vertices).all()
        assert np.isfinite(cut.normals).all()
        assert np.isfinite(cut.error)
        if not len(cut.faces) or error == "quadric":
            continue
        given = (np.asarray(cut.vertices, float) * unit, cut.faces)
        far = max(
            distance.one_sided(given, source, 5_000).max(), distance.one_sided(source, given, 5_000).max()
        )
        # libigl's own rounding on slivers
        assert far <= cut.error * unit + 1e-9, (reduction, far / (cut.error * unit))


@pytest.mark.parametrize("quality", QUALITIES)
def test_slivers_of_1e8_are_built(quality: str) -> None:
    """Beyond what single precision can tell: the bound holds, and what stays a root has its reason."""
    vertices, faces = slivers(1e8, 400)
    mesh = build(vertices, faces, quality=quality, error="bound")
    print(mesh.report.stuck)
    assert all(group.reason == "border_changed" for group in mesh.report.stuck)
    cut = mesh.cut(target_reduction=0.5)
    given = (np.asarray(cut.vertices, float), cut.faces)
    far = max(
        distance.one_sided(given, (vertices, faces)).max(), distance.one_sided((vertices, faces), given).max()
    )
    assert far <= cut.error + 1e-9


def test_coordinates_that_leave_no_room_for_lengths_are_refused() -> None:
    for factor, dtype, limit in ((4e307, np.float64, 1000), (3e38, np.float32, 127)):
        vertices, faces = scaled(factor, dtype)
        with pytest.raises(nrs.MeshError, match=rf"vertices\[\d+\].*2\^{limit}"):
            build(vertices, faces)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-6])
def test_small_features_stay_as_long_as_their_size_is_asked_for(size: float, quality: str) -> None:
    vertices, faces = mixed(size)
    mesh = build(vertices, faces, quality=quality, error="bound")
    cut = mesh.cut(error=0.3 * size)
    near = np.abs(cut.vertices[cut.faces] - 1.5).max(axis=(1, 2)) < 4 * size
    # Rounded to float32 beside a mesh of size 1, the smallest touches itself already.
    kept = topology.by_position(cut.vertices, cut.faces[near])
    assert topology.unbalanced_edges(kept) == 0
    assert topology.edge_valence(kept)[0] == 0
    assert near.sum() >= 4
    alone = nrs.measure.surface_distance(
        (cut.vertices, cut.faces[near]), (vertices, faces[len(faces) // 2 :])
    )
    assert alone.max <= 0.3 * size
