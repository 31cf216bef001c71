"""`BuildOptions`: how a mesh is built."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Literal, TypeAlias, get_args, get_origin, get_type_hints

from nanite_rs import _advice, _checks, _core
from nanite_rs.exceptions import ArgumentError, DtypeError

__all__ = ["BuildOptions"]


@_advice.teaching
@dataclass(frozen=True)
class BuildOptions:
    """How a mesh is built. The defaults suit scans, CAD and game assets alike.

    Raises
    ------
    ArgumentError, DtypeError
        For a value out of range or of another type, when the options are made.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=2_000)
    >>> mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(cluster_triangles=64))
    >>> mesh.report.clusters > 30
    True
    """

    cluster_triangles: int = 128
    """Most triangles of a cluster, 16 to 128."""
    cluster_vertices: int = 255
    """Most vertices of a cluster, 32 to 255."""
    group_clusters: int = 16
    """Clusters that are simplified together, 4 to 24."""
    clusterizer: Literal["median", "flex", "metis"] = "median"
    """What splits triangles into clusters: "median" halves them (full clusters, least time), "flex" grows them
    along the surface with meshoptimizer, "metis" cuts the graph of triangles: a quarter to a half fewer edges
    between clusters than "median" and about twice its build time."""
    partition: Literal["meshopt", "metis"] = "meshopt"
    """What gathers clusters into groups, meshoptimizer or METIS: both keep together what shares much border."""
    quality: Literal["fast", "best"] = "best"
    """What simplifies groups: "best" is an edge collapse that goes where the error is cheap; "fast", for hurry, is
    meshoptimizer. It builds in a third to a half of the time and stores two fifths less below a quarter of a
    million triangles, where its levels lie farther apart. Scans have 10 to 30 % more root mean square error at the
    same size, other meshes up to two and a half times as much (docs/quality.md)."""
    error: Literal["quadric", "bound"] = "bound"
    """How the errors that cuts state are found: "bound" proves them for every point of both surfaces, in either
    direction (see docs/numerics.md); "quadric" trusts the simplifier, which is often too low and builds fastest."""
    normal_weight: float = 1.0
    """Weight of a unit of normal deviation against one mean edge length of distance."""
    color_weight: float = 1.0
    """Weight of a unit of colour (0 to 1) against one mean edge length of distance."""
    uv_weight: float = 1.0
    """Weight of a unit of UV against one mean edge length of distance."""
    channel_weight: float = 1.0
    """Weight of the range of a floating-point channel over the mesh, or of a label that is another one, against one
    mean edge length of distance."""
    preserve_area: bool = False
    """For foliage and hair: of small islands such as leaves, those that stay grow until as much is covered as
    before, seen from all directions, where otherwise a crown of leaves thins out. Builds up to twice as long, of
    many small islands and with "quadric" errors four times and more."""
    crease_angle: float | None = None
    """Of meshes without normals: faces that meet at more than so many degrees, 0 to 180, have an edge between them,
    and shading is smooth up to it on either side. ``None`` smooths over everything; 0 makes every face flat. For
    parts from CAD 30 is usual, and what `from_file` takes for STL."""
    face_ids: bool = False
    """Keep the map from full-detail triangles to rows of the caller's ``faces``."""
    rebake: Literal["never", "auto"] = "never"
    """Of textured meshes with many charts, such as scans: what is done where seams are in the way. With "auto"
    levels go on over them, and show images that are sampled from the source (see `rebake`)."""
    texture_size: int = 2048
    """With ``rebake``: most texels of a side of such an image, 16 to 8,192."""
    threads: int = 0
    """Threads; 0 uses all cores. The result does not depend on it."""

    def __post_init__(self) -> None:
        limits = {
            "cluster_triangles": (16, 128),
            "cluster_vertices": (32, 255),
            "group_clusters": (4, 24),
            "threads": (0, _core.MOST_THREADS),
            "texture_size": (16, 8_192),
        }
        checked: dict[str, Any] = {n: _checks.whole(getattr(self, n), n, *of) for n, of in limits.items()}
        for name, alias in get_type_hints(type(self)).items():
            if get_origin(alias) is Literal:
                checked[name] = _checks.choice(getattr(self, name), name, get_args(alias))
        for name in ("normal_weight", "color_weight", "uv_weight", "channel_weight"):
            checked[name] = _checks.not_negative(getattr(self, name), name)
        if self.crease_angle is not None:
            checked["crease_angle"] = _angle(self.crease_angle)
        for name in ("preserve_area", "face_ids"):
            checked[name] = _checks.truth(getattr(self, name), name)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def _core(self) -> dict[str, Any]:
        """Return what the core is told; images are none of its business."""
        return {name: value for name, value in asdict(self).items() if name not in ("rebake", "texture_size")}


def no_options(found: object) -> DtypeError:
    """The error about what is given in the place of options."""
    return DtypeError(
        f"options: expected BuildOptions, not {type(found).__name__}; give BuildOptions(quality=...)"
    )


def _angle(value: float) -> float:
    angle = _checks.number(value, "crease_angle")
    if not 0.0 <= angle <= 180.0:
        raise ArgumentError(f"crease_angle: must be between 0 and 180 degrees, not {value}")
    return angle


# Degrees at which parts of CAD have their edges.
_CREASE: Final = 30.0


VirtualName: TypeAlias = Literal["auto", "always", "never"]

VIRTUAL_FROM: Final = 20_000
"""Triangles of all instances of a mesh from which on levels of detail pay: where they are small in a picture, a
small part of them is drawn."""


def chosen(virtual: VirtualName, options: BuildOptions | None) -> VirtualName:
    """Which meshes get levels of detail: options to build with say that all do."""
    _checks.choice(virtual, "virtual", get_args(VirtualName))
    return "always" if virtual == "auto" and options is not None else virtual


def pays(virtual: VirtualName, triangles: int) -> bool:
    """Whether a mesh whose instances have so many triangles gets levels of detail."""
    return virtual == "always" or (virtual == "auto" and triangles >= VIRTUAL_FROM)


def creased(options: BuildOptions | None, angle: float | None, format: str) -> BuildOptions | None:
    """Options with a crease angle: that given, theirs, or of an STL, which lacks normals, the usual."""
    if not isinstance(options, BuildOptions | None):
        raise no_options(options)
    if angle is None and format.partition(".")[0] == "stl":
        angle = _CREASE if options is None or options.crease_angle is None else options.crease_angle
    return options if angle is None else replace(options or BuildOptions(), crease_angle=angle)
