"""One level at once: `decimate`, and `simplify` in the place of fast-simplification's."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _core, _exchange, io
from nanite_rs._arrays import as_array, core_arrays
from nanite_rs._progress import Progress, reporter
from nanite_rs.cut import Cut
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.measure import surface_distance
from nanite_rs.mesh import NaniteMesh
from nanite_rs.options import BuildOptions

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import ArrayLike, NDArray

__all__ = ["decimate", "simplify"]

Decimable: TypeAlias = (
    "tuple[ArrayLike, ArrayLike] | trimesh.Trimesh | trimesh.Scene | Cut | str | os.PathLike[str]"
)

_ATTRIBUTES = ("normals", "colors", "uvs", "channels", "face_materials", "face_channels")
# Of the distance that is proven.
_TOLERANCE = 0.05
_SAMPLES = 20_000


@_advice.teaches(
    **dict.fromkeys(("faces", "count", "target_count", "n_faces"), "target_faces=5000 keeps so many"),
    **dict.fromkeys(("ratio", "reduction"), "target_reduction=0.9 removes 90 %"),
    error="of an error, NaniteMesh.from_arrays(vertices, faces).cut(error=0.1) picks a level",
    options="give quality=, normal_weight= and so on one by one",
    otherwise="give decimate((vertices, faces), 5000), or decimate(mesh, target_reduction=0.9)",
)
def decimate(
    mesh: Decimable,
    target_faces: int | None = None,
    *,
    target_reduction: float | None = None,
    quality: Literal["fast", "best"] = "best",
    lossless: bool = False,
    preserve_border: bool = False,
    proof: bool = False,
    normals: ArrayLike | None = None,
    colors: ArrayLike | None = None,
    uvs: ArrayLike | Sequence[ArrayLike] | None = None,
    channels: Mapping[str, ArrayLike] | None = None,
    face_materials: ArrayLike | None = None,
    face_channels: Mapping[str, ArrayLike] | None = None,
    normal_weight: float = 1.0,
    color_weight: float = 1.0,
    uv_weight: float = 1.0,
    channel_weight: float = 1.0,
    threads: int = 0,
    progress: Progress = None,
) -> Cut:
    """Simplify a mesh to one number of triangles, on all cores, and keep no other level.

    Takes two fifths of the time of building a `NaniteMesh`, which is worth its time from the second level on. The
    interpreter lock is released, Ctrl-C works, and the same input gives the same result on any number of threads.
    Do not modify the arrays while this runs.

    Parameters
    ----------
    mesh : tuple of two arrays, trimesh.Trimesh, trimesh.Scene, Cut or path
        Arrays as in `NaniteMesh.from_arrays`, or what has them: also meshes of PyVista, Open3D and meshio, and
        files that `NaniteMesh.from_file` reads. What they carry comes along.
    target_faces : int, optional
        So many triangles, or up to 0.5 % or two fewer, and never more where the topology allows: collapses end
        where nothing is left that may collapse, and what there is then is returned. Where that is already so, the
        mesh comes back mended.
    target_reduction : float, optional
        Fraction of the faces given to remove, 0 to 1, instead of ``target_faces``.
    quality : "best" or "fast"
        "best" collapses edges by exact costs, as if all were in one queue, and lets small parts go as a whole where
        that costs less. "fast" is meshoptimizer: half the time or less, a third to a half more error, and sheets
        may touch.
    lossless : bool
        Without a target: only what changes neither the shape nor what it carries, but for rounding, goes. Always of
        the best quality.
    preserve_border : bool
        Vertices at edges of one face stay as they are.
    proof : bool
        Measure `Cut.error`, a bound of the distance of all points of both surfaces; infinite otherwise. That mostly
        takes longer than decimating.
    normals, colors, uvs, channels, face_materials, face_channels
        What arrays carry, as in `NaniteMesh.from_arrays`. Other meshes bring their own.
    normal_weight, color_weight, uv_weight, channel_weight : float
        As in `BuildOptions`.
    threads : int
        Threads; 0 uses all cores.
    progress
        As in `NaniteMesh.from_arrays`.

    Returns
    -------
    Cut
        Of no cluster: `Cut.cluster_ids` has a row of 2³² − 1 for each material. `Cut.vertex_ids` count vertices,
        and `Cut.attribute_error` is infinite.

    Raises
    ------
    MeshError
        Not finite, an index out of range (with its row), or nothing left.
    ArgumentError, DtypeError
        An argument has the wrong shape, dtype or range.
    MissingFileError, FileError, FormatError, DependencyError
        As in `NaniteMesh.from_file`.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000)
    >>> small = nrs.decimate((vertices, faces), target_reduction=0.9, colors=np.abs(vertices) / 2)
    >>> 4_975 <= len(small) <= 5_000 and small.colors.shape == (len(small.vertices), 4)
    True
    >>> small.to_trimesh().is_watertight
    True
    """
    if lossless is True:
        if target_faces is not None or target_reduction is not None:
            raise ArgumentError("lossless: goes without target_faces and target_reduction")
    elif (target_faces is None) == (target_reduction is None):
        raise ArgumentError("decimate: expected exactly one of target_faces and target_reduction")
    # They say what is wrong with an option.
    options = BuildOptions(
        quality=quality,
        normal_weight=normal_weight,
        color_weight=color_weight,
        uv_weight=uv_weight,
        channel_weight=channel_weight,
        threads=threads,
    )
    flags = {"lossless": lossless, "preserve_border": preserve_border}
    flags = {name: _checks.truth(value, name) for name, value in flags.items()}
    proof = _checks.truth(proof, "proof")
    given: dict[str, Any] = dict(
        zip(_ATTRIBUTES, (normals, colors, uvs, channels, face_materials, face_channels), strict=True)
    )
    vertices, faces, given = _taken(mesh, given)
    looks = given.pop("materials", ())
    target = _target(target_faces, target_reduction, len(faces), "target_faces")
    cut = _decimated(vertices, faces, given, target, options, progress, **flags)
    cut.materials = looks
    if proof:
        found = surface_distance(
            (vertices, faces),
            (cut.vertices, cut.faces),
            samples=_SAMPLES,
            mode="bounded",
            tolerance=_TOLERANCE,
        )
        cut.error = math.inf if found.upper is None else found.upper
    return cut


def _decimated(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    given: Mapping[str, Any],
    target: int,
    options: BuildOptions,
    progress: Progress,
    *,
    lossless: bool,
    preserve_border: bool,
) -> Cut:
    try:
        arrays = core_arrays(vertices, faces, given, given["channels"])
        with reporter(progress, "decimating") as report:
            core = _core.decimate(
                arrays,
                target=target,
                options=options._core(),
                preserve_border=preserve_border,
                lossless=lossless,
                progress=report,
            )
    except ArgumentError as error:
        more = _advice.for_arrays(
            str(error),
            vertices,
            faces,
            {name: given[name] for name in given if not name.endswith("channels")},
        )
        raise (_advice.advised(error, more) if more else _advice.near(error)) from None
    return Cut(core)


def _target(count: int | None, reduction: float | None, faces: int, name: str) -> int:
    """Triangles to keep; as few as possible where there is no target."""
    if reduction is not None:
        reduction = _checks.reduction(reduction)
        # A fraction such as 0.9 is not exact: the integer beside it is meant.
        return max(math.floor((1.0 - reduction) * faces + 1e-6), 1)
    if count is None:
        return 1
    if isinstance(count, bool) or not isinstance(count, int | np.integer):
        raise DtypeError(
            f"{name}: expected an integer, not {type(count).__name__}; target_reduction takes a fraction to remove"
        )
    if count < 1:
        raise ArgumentError(f"{name}: must be 1 or more, not {count}")
    return min(int(count), max(faces, 1))


def _taken(mesh: Any, given: dict[str, Any]) -> tuple[NDArray[Any], NDArray[Any], dict[str, Any]]:
    """Vertices, faces and what they carry."""
    if isinstance(mesh, tuple | list) and len(mesh) == 2:
        return as_array(mesh[0], "vertices"), as_array(mesh[1], "faces"), given
    extra = [name for name, value in given.items() if value is not None]
    source = _source(mesh)
    if extra:
        raise ArgumentError(
            f"{extra[0]}: goes with (vertices, faces); {_advice.name_of_type(mesh)} brings its own"
        )
    arrays = source.arrays()
    vertices, faces = arrays.pop("vertices"), arrays.pop("faces")
    return as_array(vertices, "vertices"), as_array(faces, "faces"), arrays


def _source(mesh: Any) -> io.Source:
    if isinstance(mesh, NaniteMesh):
        raise DtypeError(
            "mesh: a NaniteMesh holds all levels of detail; mesh.cut(target_faces=5000) picks one of them"
        )
    if isinstance(mesh, Cut):
        own = (mesh.normals, mesh.fine_colors, mesh.uvs, mesh._vertex_channels, mesh.face_materials)
        of_faces = dict(mesh.face_channels)
        return io.Source(mesh.vertices, mesh.faces, *own, of_faces, mesh.materials)  # type: ignore[arg-type]
    package = type(mesh).__module__.split(".")[0]
    if package in ("pyvista", "open3d", "meshio"):
        source: io.Source = getattr(_exchange, f"from_{package}")(mesh)
        return source
    if package == "trimesh":
        return io.from_trimesh(mesh)
    if isinstance(mesh, str | bytes | bytearray | memoryview | os.PathLike) or hasattr(mesh, "read"):
        file = io.given_file(mesh, name="mesh")
        if "." + file.format == io.NANITE_SUFFIX:
            raise ArgumentError(
                f"mesh: {file.name} holds all levels of detail; "
                "NaniteMesh.open(path).cut(target_faces=5000) picks one of them"
            )
        return io.from_file(file)
    raise DtypeError(
        f"mesh: expected (vertices, faces), a mesh of trimesh, PyVista, Open3D or meshio, a Cut or a path, "
        f"not {_advice.name_of_type(mesh)}"
    )


@_advice.teaches(otherwise="give simplify(points, triangles, 0.9)")
def simplify(
    points: ArrayLike,
    triangles: ArrayLike,
    target_reduction: float | None = None,
    target_count: int | None = None,
    agg: float = 7.0,
    verbose: bool = False,
    return_collapses: bool = False,
    lossless: bool = False,
    preserve_border: bool = False,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Simplify a mesh once: the call of `fast_simplification.simplify`, with arguments and arrays of the same kind.

    It is `decimate` with the best quality, which takes more kinds of meshes and brings along what they carry.

    Parameters
    ----------
    points : (N, 3) array
        Positions.
    triangles : (M, 3) integer array
        Triangles.
    target_reduction : float, optional
        Fraction of the triangles to remove, 0 to 1. Give this or ``target_count``; both are met as
        `decimate` meets its targets.
    target_count : int, optional
        Triangles to keep, or up to 0.5 % or two fewer.
    agg : float
        Accepted for compatibility; ``decimate(quality="fast")`` is what takes less time.
    verbose : bool
        Show a progress bar.
    return_collapses : bool
        Not available; True raises. A `NaniteMesh` keeps all levels, and its cuts name the vertices that they share.
    lossless : bool
        Only what changes nothing goes, whatever the target, which may be left out.
    preserve_border : bool
        Vertices at edges of one face stay as they are.

    Returns
    -------
    points : (N', 3) float64 array
    triangles : (M', 3) int32 array

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=20_000)
    >>> points, triangles = nrs.simplify(vertices, faces, 0.9)
    >>> 0.995 * 2_048 <= len(triangles) <= 2_048
    True
    """
    del agg
    if _checks.truth(return_collapses, "return_collapses"):
        raise ArgumentError(
            "return_collapses: vertices move to new places, which no list of pairs says; a NaniteMesh keeps all "
            "levels, and mesh.cut(...).vertex_ids names the vertices that its cuts share"
        )
    if not isinstance(points, np.ndarray | Sequence):
        raise DtypeError(
            f"points: expected an array, not {_advice.name_of_type(points)}; give vertices and faces"
        )
    flags = {
        "lossless": _checks.truth(lossless, "lossless"),
        "preserve_border": _checks.truth(preserve_border, "preserve_border"),
    }
    if (target_reduction is None) == (target_count is None) and not flags["lossless"]:
        raise ArgumentError("simplify: expected exactly one of target_reduction and target_count")
    vertices = as_array(points, "points")
    if vertices.dtype.kind != "f":
        vertices = vertices.astype(np.float64)
    # By the name by which lists of whole numbers stay what they are.
    faces = as_array(triangles, "faces")
    target = 1
    if not flags["lossless"]:
        if target_count is not None and np.issubdtype(type(target_count), np.integer):
            if not 0 <= target_count <= len(faces):
                raise ArgumentError(f"target_count: must be between 0 and {len(faces)}, not {target_count}")
            target_count = max(int(target_count), 1)
        target = _target(target_count, target_reduction, len(faces), "target_count")
    given = dict.fromkeys(_ATTRIBUTES)
    cut = _decimated(vertices, faces, given, target, BuildOptions(quality="best"), verbose, **flags)
    return cut.vertices.astype(np.float64), cut.faces
