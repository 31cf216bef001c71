"""Distances between triangle meshes: sampled, or bounded with proof.

`surface_distance` says how far two surfaces are apart, `closest_points` where points lie nearest to a mesh. Meshes
are ``(vertices, faces)`` tuples, `trimesh.Trimesh`, `Cut` or `NaniteMesh` (its full detail). Everything is computed
in float64, also for float32 input, and does not depend on the number of threads.

Examples
--------
>>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
>>> cut = mesh.cut(target_faces=2_000)
>>> found = nrs.measure.surface_distance(mesh, cut, mode="bounded")
>>> found.lower <= found.upper <= 1.02 * found.lower
True
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from nanite_rs import _checks, _core
from nanite_rs._arrays import as_array
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.mesh import NaniteMesh

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs.cut import Cut

__all__ = [
    "ClosestPoints",
    "Deviation",
    "MeshLike",
    "OneSidedDistance",
    "SurfaceDistance",
    "closest_points",
    "surface_distance",
]

MeshLike: TypeAlias = "tuple[ArrayLike, ArrayLike] | trimesh.Trimesh | Cut | NaniteMesh"
"""What is measured: ``(vertices, faces)``, (N, 3) and (M, 3), or an object that has them."""


@dataclass(frozen=True)
class Deviation:
    """Mean, root mean square and maximum of some values; NaN where there were none."""

    mean: float
    rms: float
    max: float


@dataclass(frozen=True)
class OneSidedDistance:
    """How far the points of one surface are from another, in the units of the meshes."""

    mean: float
    """Mean distance of the samples."""
    rms: float
    """Root mean square of the distances of the samples."""
    max: float
    """Largest distance of a sample, or of a vertex that a face refers to."""
    per_vertex: NDArray[np.float64]
    """Distance of every vertex to the other surface: (N,) float64."""
    normals: Deviation
    """Angles in degrees, 0 to 180, between the normal of a sample's face and that of the face nearest to it. Faces
    without area are left out."""
    area: float
    """Area of the surface."""
    samples: int
    """Number of samples."""
    lower: float | None = None
    """Bounded mode: the largest distance of a point is at least this, because it was found at one."""
    upper: float | None = None
    """Bounded mode: no point of the surface, between the samples either, is farther from the other one."""
    converged: bool | None = None
    """Bounded mode: the bounds came as near to each other as was asked. They hold in any case."""

    def __repr__(self) -> str:
        """Everything but the arrays."""
        bound = "" if self.upper is None else f", {self.lower:.6g} to {self.upper:.6g}"
        return f"OneSidedDistance(mean {self.mean:.4g}, rms {self.rms:.4g}, max {self.max:.4g}{bound})"


@dataclass(frozen=True)
class SurfaceDistance:
    """How far two surfaces are apart. Made by `surface_distance`.

    Two-sided means weigh both surfaces by their areas; two-sided maxima and bounds are those of the worse
    direction, the Hausdorff distance.
    """

    a_to_b: OneSidedDistance
    """From points of the first surface to the second."""
    b_to_a: OneSidedDistance
    """From points of the second surface to the first."""
    mean: float
    """Mean distance over both surfaces."""
    rms: float
    """Root mean square over both surfaces."""
    max: float
    """Largest distance found at a sample or vertex, in either direction."""
    normals: Deviation
    """Angles between normals in degrees, over both surfaces."""
    mode: Literal["sampled", "bounded"]
    """How it was measured."""
    lower: float | None = None
    """Bounded mode: the Hausdorff distance is at least this."""
    upper: float | None = None
    """Bounded mode: the Hausdorff distance is at most this."""
    converged: bool | None = None
    """Bounded mode: the bounds came as near to each other as was asked. They hold in any case."""

    def __repr__(self) -> str:
        """Both-sided figures."""
        bound = "" if self.upper is None else f", {self.lower:.6g} to {self.upper:.6g}"
        return f"SurfaceDistance(mean {self.mean:.4g}, rms {self.rms:.4g}, max {self.max:.4g}{bound})"


@dataclass(frozen=True)
class ClosestPoints:
    """The points of a mesh nearest to some points. Made by `closest_points`."""

    distances: NDArray[np.float64]
    """Distances: (N,) float64."""
    faces: NDArray[np.uint32]
    """Rows of the faces that the nearest points lie on: (N,) uint32."""
    points: NDArray[np.float64]
    """The nearest points: (N, 3) float64."""


def _mesh_arrays(mesh: MeshLike, name: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices and faces of anything that is a mesh."""
    vertices: object
    faces: object
    if isinstance(mesh, NaniteMesh):
        mesh = mesh.cut(error=0.0)
    if isinstance(mesh, tuple):
        if len(mesh) != 2:
            raise ArgumentError(f"{name}: expected (vertices, faces), found a tuple of {len(mesh)}")
        vertices, faces = mesh
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    else:
        raise DtypeError(
            f"{name}: expected (vertices, faces), trimesh.Trimesh, Cut or NaniteMesh, not {type(mesh).__name__}"
        )
    return as_array(vertices, f"{name}.vertices"), as_array(faces, "faces")


def _count(value: object, name: str, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise DtypeError(f"{name}: expected an integer, not {type(value).__name__}")
    if not least <= value < 2**63:
        raise ArgumentError(f"{name}: must be {least} or more and fit 63 bits, not {value}")
    return int(value)


def _both(a: tuple[Deviation, float], b: tuple[Deviation, float]) -> Deviation:
    """Over both surfaces, weighed by area; of the one that has a value where the other has none."""
    present = [(d, w) for d, w in (a, b) if not np.isnan(d.mean)]
    if not present:
        return Deviation(np.nan, np.nan, np.nan)
    # By the largest weight, so that areas near the ends of the range neither vanish nor overflow.
    largest = max(w for _, w in present)
    weights = [w / largest if 0.0 < largest < np.inf else 1.0 for _, w in present]
    mean = sum(d.mean * w for (d, _), w in zip(present, weights, strict=True)) / sum(weights)
    peak = max(d.rms for d, _ in present)
    square = (
        sum((d.rms / peak) ** 2 * w for (d, _), w in zip(present, weights, strict=True))
        if peak > 0.0
        else 0.0
    )
    return Deviation(mean, peak * float(np.sqrt(square / sum(weights))), max(d.max for d, _ in present))


def _converged(lower: float, upper: float, tolerance: float, rounding: float) -> bool:
    return upper - lower <= max(tolerance * upper, rounding)


def surface_distance(
    a: MeshLike,
    b: MeshLike,
    *,
    samples: int = 200_000,
    seed: int = 0,
    mode: Literal["sampled", "bounded"] = "sampled",
    tolerance: float = 0.01,
    budget: int = 20_000_000,
) -> SurfaceDistance:
    """Measure how far two surfaces are apart.

    Points are spread evenly over the area of either surface, and the exact distance of each to the other surface is
    taken. Between them the surfaces may be farther apart: the maximum found is a lower bound. With
    ``mode="bounded"`` every triangle is then overlaid with the other surface, which gives an upper bound for all
    its points (``docs/numerics.md`` has the proof; after Guthe, Borodin and Klein 2005, and Tang, Lee and Kim
    2009).

    The interpreter lock is released and Ctrl-C works. Do not modify the arrays while this runs.

    Parameters
    ----------
    a, b : tuple of two arrays, trimesh.Trimesh, Cut or NaniteMesh
        The meshes: vertices (N, 3) float32 or float64, faces (M, 3) of any integer type. Faces may be degenerate.
    samples : int
        Points per direction.
    seed : int
        Other seeds give other points; the same seed gives the same points on every machine.
    mode : "sampled" or "bounded"
        Whether to bound the distance as well.
    tolerance : float
        Bounded mode: ``upper - lower`` should not exceed ``tolerance * upper``, or what rounding makes of 0.
    budget : int
        Bounded mode: where overlaying a triangle is not enough, pieces of it are looked at one by one; about so
        many per direction, after which the bounds are what they are and ``converged`` is False.

    Returns
    -------
    SurfaceDistance

    Raises
    ------
    MeshError
        Vertices are not finite (with the row), a face refers to none, or there are no faces.
    ArgumentError, DtypeError
        An argument has the wrong shape, dtype or range.

    Examples
    --------
    >>> fine, coarse = nrs.shapes.icosphere(faces=80_000), nrs.shapes.icosphere(faces=320)
    >>> found = nrs.measure.surface_distance(fine, coarse, mode="bounded")
    >>> found.converged
    True
    >>> found.max <= found.upper <= 1.02 * found.lower
    True
    >>> found.b_to_a.per_vertex.shape == (len(coarse[0]),)
    True
    """
    if mode not in ("sampled", "bounded"):
        raise ArgumentError(f'mode: must be "sampled" or "bounded", not {mode!r}')
    tolerance = _checks.number(tolerance, "tolerance")
    if not 0.0 < tolerance < 1.0:
        raise ArgumentError(f"tolerance: must be between 0 and 1, not {tolerance}")
    budget = _count(budget, "budget", 0)
    samples = _count(samples, "samples", 1)
    a_vertices, a_faces = _mesh_arrays(a, "a")
    b_vertices, b_faces = _mesh_arrays(b, "b")
    *raw, rounding = _core.surface_distance(
        a_vertices,
        a_faces,
        b_vertices,
        b_faces,
        samples=samples,
        seed=_count(seed, "seed", 0),
        bounded=(tolerance, budget) if mode == "bounded" else None,
    )
    sides = []
    for side in raw:
        lower, upper, converged = None, None, None
        if side["bound"] is not None:
            lower, upper, _ = side["bound"]
            converged = _converged(lower, upper, tolerance, rounding)
        mean, rms, largest = side["distance"]
        sides.append(
            OneSidedDistance(
                mean=mean,
                rms=rms,
                max=largest,
                per_vertex=side["per_vertex"],
                normals=Deviation(*side["normals"]),
                area=side["area"],
                samples=samples,
                lower=lower,
                upper=upper,
                converged=converged,
            )
        )
    first, second = sides
    both = _both(*((Deviation(s.mean, s.rms, s.max), s.area) for s in sides))
    lower, upper, converged = None, None, None
    bounds = [(s.lower, s.upper) for s in sides if s.lower is not None and s.upper is not None]
    if bounds:
        lower, upper = max(low for low, _ in bounds), max(high for _, high in bounds)
        converged = _converged(lower, upper, tolerance, rounding)
    return SurfaceDistance(
        a_to_b=first,
        b_to_a=second,
        mean=both.mean,
        rms=both.rms,
        max=both.max,
        normals=_both((first.normals, first.area), (second.normals, second.area)),
        mode=mode,
        lower=lower,
        upper=upper,
        converged=converged,
    )


def closest_points(points: ArrayLike, mesh: MeshLike) -> ClosestPoints:
    """Find the point of a mesh nearest to each of some points.

    Parameters
    ----------
    points : (N, 3) float32 or float64 array
        The points.
    mesh : tuple of two arrays, trimesh.Trimesh, Cut or NaniteMesh
        The mesh, as in `surface_distance`.

    Returns
    -------
    ClosestPoints

    Raises
    ------
    MeshError
        Points or vertices are not finite (with the row), a face refers to none, or there are no faces.
    ArgumentError, DtypeError
        An argument has the wrong shape or dtype.

    Examples
    --------
    >>> found = nrs.measure.closest_points([[0.0, 0.0, 3.0]], nrs.shapes.icosphere(faces=80_000))
    >>> bool(abs(found.distances[0] - 2.0) < 1e-3)
    True
    """
    vertices, faces = _mesh_arrays(mesh, "mesh")
    return ClosestPoints(*_core.closest_points(as_array(points, "points"), vertices, faces))
