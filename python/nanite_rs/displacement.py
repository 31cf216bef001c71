"""`displace`: height maps on meshes, with a proven bound."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs._arrays import as_array
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning
from nanite_rs.mesh import NaniteMesh
from nanite_rs.texture import Image, Texture, Wrap, both_ways

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._progress import Progress
    from nanite_rs.material import Look
    from nanite_rs.options import BuildOptions

__all__ = ["DisplacedMesh", "displace"]

# From (u, v, 1), v up, to places on an image, v down.
_UPRIGHT = [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]]


@dataclass(frozen=True)
class DisplacedMesh:
    """What `displace` returns: a mesh, and how far it is from the surface that was asked for.

    ``len(mesh)`` is the number of triangles.
    """

    vertices: NDArray[np.float64]
    """Points of the exact surface, (N, 3). Where texture coordinates or normals differ, there are several."""
    faces: NDArray[np.uint32]
    """Triangles, (M, 3), turned as those of the source."""
    uvs: NDArray[np.float64]
    """Texture coordinates, (N, 2)."""
    normals: NDArray[np.float64]
    """Unit normals of this mesh, (N, 3), weighted by angle; apart where those of the source are."""
    face_ids: NDArray[np.uint32]
    """Row of the source's faces that each face is a part of, (M,)."""
    error: float
    """No point of this mesh or of the exact surface is farther from the other one: proven, rounded up. Where the
    surface is torn, of the surface as it is defined there."""
    tear: float
    """A bound of how far that surface is from what faces at seams and creases say by themselves; 0 without any."""
    dropped_faces: int
    """Faces of the source with two corners at one place, left out."""

    def __len__(self) -> int:
        return len(self.faces)

    def build(
        self,
        *,
        face_materials: ArrayLike | None = None,
        face_channels: Mapping[str, ArrayLike] | None = None,
        materials: Look | None = None,
        options: BuildOptions | None = None,
        progress: Progress = None,
    ) -> NaniteMesh:
        """Build a `NaniteMesh` with the normals and texture coordinates.

        Its errors include that of this mesh: no point of a cut or of the exact surface is farther from the
        other one than `Cut.error`, in files, too. Full detail has the error of this mesh.

        Parameters
        ----------
        face_materials : (F,) array of any integer type, optional
            Of the faces of the source.
        face_channels : mapping of names to (F,) or (F, K) arrays, optional
            Of the faces of the source, as in `NaniteMesh.from_arrays`; each face has those of the one that it is a
            part of.
        materials, options, progress
            As in `NaniteMesh.from_arrays`.

        Raises
        ------
        MeshError, ArgumentError, DtypeError
            As in `NaniteMesh.from_arrays`.

        Examples
        --------
        >>> corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
        >>> heights = np.random.default_rng(0).random((16, 16))
        >>> made = nrs.displace(
        ...     corners, [[0, 1, 2], [0, 2, 3]], uvs=corners[:, :2], height=heights, tolerance=0.1, scale=0.1
        ... )
        >>> mesh = made.build(face_channels={"side": np.uint8([7, 9])})
        >>> np.unique(mesh.cut(error=0).face_channels["side"]).tolist()
        [7, 9]
        """
        if face_materials is not None:
            face_materials = self._of_faces(face_materials, "face_materials")
            if face_materials.ndim != 1:
                raise ArgumentError(f"face_materials: expected (F,), found shape {face_materials.shape}")
        if face_channels is not None:
            if not isinstance(face_channels, Mapping):
                raise DtypeError(
                    f"face_channels: expected a mapping of names to arrays, not {type(face_channels).__name__}"
                )
            face_channels = {
                name: self._of_faces(rows, f"face_channels[{name!r}]") for name, rows in face_channels.items()
            }
        mesh = NaniteMesh.from_arrays(
            self.vertices,
            self.faces,
            normals=self.normals,
            uvs=self.uvs,
            face_materials=face_materials,
            face_channels=face_channels,
            materials=materials,
            options=options,
            progress=progress,
        )
        mesh._core = mesh._core.with_source_error(self.error)
        return mesh

    def _of_faces(self, value: ArrayLike, name: str) -> NDArray[Any]:
        """Rows of the source's faces as rows of these."""
        rows = np.asarray(value)
        if rows.ndim == 0 or len(rows) <= int(self.face_ids.max(initial=0)):
            raise ArgumentError(f"{name}: expected one for each face of the source, found shape {rows.shape}")
        return rows[self.face_ids]


def _texels(height: Texture | Image | ArrayLike | str | os.PathLike[str]) -> NDArray[Any]:
    """Numbers of a map, (H, W) or (H, W, 3), of a type that the core takes."""
    picture = isinstance(height, Texture | Image | str | os.PathLike)
    if isinstance(height, Texture):
        array = height.image.pixels
    else:
        array = Image._of(height).pixels if picture else np.asarray(height)
    if array.dtype == np.float16:
        array = array.astype(np.float32)
    if not isinstance(height, np.ndarray) and not picture and array.dtype.kind in "iu":
        array = array.astype(np.float64)
    if array.dtype.name not in ("uint8", "uint16", "float32", "float64"):
        raise DtypeError(f"height: must be uint8, uint16 or floating-point, not {array.dtype}")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    if picture and array.ndim == 3 and array.shape[2] == 3 and (array == array[:, :, :1]).all():
        array = array[:, :, 0]
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] != 3):
        raise ArgumentError(f"height: expected (H, W), or (H, W, 3) of vectors, found shape {array.shape}")
    if array.size == 0:
        raise ArgumentError(f"height: the map is empty, of shape {array.shape}")
    return np.ascontiguousarray(array)


def _rows_of(value: ArrayLike, name: str, columns: int, count: int) -> NDArray[np.float64]:
    """Finite floating-point rows, one for each vertex."""
    array = as_array(value, name)
    if array.dtype.kind != "f":
        raise DtypeError(f"{name}: expected a floating-point dtype, not {array.dtype}")
    if array.shape != (count, columns):
        raise ArgumentError(f"{name}: expected shape ({count}, {columns}), found {array.shape}")
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ArgumentError(f"{name}[{row}] is not finite: {array[row].tolist()}")
    return array.astype(np.float64)


def displace(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    uvs: ArrayLike,
    normals: ArrayLike | None = None,
    height: Texture | Image | ArrayLike | str | os.PathLike[str],
    scale: float = 1.0,
    midlevel: float = 0.0,
    tolerance: float,
    wrap: Wrap | tuple[Wrap, Wrap] = "repeat",
    max_triangles: int = 20_000_000,
) -> DisplacedMesh:
    """Put a height map on a mesh, with triangles where it has detail, within a tolerance of the exact surface.

    **The exact surface.** The point at the place b of a triangle moves to
    ``p(b) + scale * (h(uv(b)) - midlevel) * n(b) / |n(b)|``, with positions, texture coordinates and normals
    linear over the triangle, and texels blended bilinearly. Of a map of vectors it is
    ``p(b) + scale * (h(uv(b)) - midlevel)``, in the space of the mesh.

    **Seams and creases.** Where faces that meet have different texture coordinates or normals, that surface
    is torn. There it has the mean height along the normalised mean normal of both sides, and the difference
    fades out across the faces at the seam. `DisplacedMesh.tear` bounds that difference. Faces meet where they
    have corners at the same position.

    **Refinement.** Longest edges are halved (Rivara 1984) until every triangle is proven to be within the
    tolerance: heights are compared texel by texel over its footprint, and what normals add is bounded. Edges
    are split alike for all faces at them, so that no crack opens. The result does not depend on the number of
    threads.

    Parameters
    ----------
    vertices : (N, 3) float32 or float64 array
        Positions.
    faces : (M, 3) array of any integer type
        Triangles.
    uvs : (N, 2) floating-point array
        Texture coordinates; (0, 0) is the lower left corner of the map.
    normals : (N, 3) floating-point array, optional
        Normals of any length; when missing, computed over all faces at a position, weighted by angle.
    height : (H, W) or (H, W, 3) array, Texture, Image or path
        Heights, or vectors, in rows from the top: uint8 and uint16, which stand for 0 to 1, or floating-point
        numbers. `Texture` brings its own wrap and transform. Pictures of three equal channels are heights.
    scale : float
        Times the heights.
    midlevel : float
        The height that stays where it is.
    tolerance : float
        How far the result may be from the exact surface, in the units of the mesh.
    wrap : {"repeat", "mirror", "clamp"} or two of them
        What is beyond the edges of the map, along both axes or along u and v.
    max_triangles : int
        Where more would be needed, those that are farthest off are refined, and a `UsageWarning` says what
        was reached.

    Returns
    -------
    DisplacedMesh

    Raises
    ------
    MeshError
        Not finite, an index out of range (with its row), or nothing left.
    ArgumentError, DtypeError
        An argument has the wrong shape, dtype or range, or a texel is not finite.
    MissingFileError, FileError, FormatError, DependencyError
        As by `Image.open`.

    Examples
    --------
    >>> vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    >>> bump = np.zeros((64, 64))
    >>> bump[20:28, 20:28] = 1.0
    >>> uvs = vertices[:, :2]
    >>> made = nrs.displace(vertices, [[0, 1, 2], [0, 2, 3]], uvs=uvs, height=bump, scale=0.1, tolerance=0.001)
    >>> made.error <= 0.001 and len(made) < 3_000
    True
    >>> mesh = made.build()
    >>> mesh.cut(error=0).error >= made.error
    True
    """
    vertices, faces = as_array(vertices, "vertices"), as_array(faces, "faces")
    count = len(vertices) if vertices.ndim else 0
    scale, midlevel = _checks.finite(scale, "scale"), _checks.finite(midlevel, "midlevel")
    if not _checks.not_negative(tolerance, "tolerance") > 0.0:
        raise ArgumentError(f"tolerance: must be above 0, not {tolerance}")
    max_triangles = _checks.whole(max_triangles, "max_triangles", 1)
    rows = _UPRIGHT
    if isinstance(height, Texture):
        if height.filter != "linear":
            raise ArgumentError('height: a texture with filter="nearest" has steps; give filter="linear"')
        wrap, rows = height.wrap, height._rows()
    wraps = both_ways(wrap)
    of_vertices = _rows_of(uvs, "uvs", 2, count)
    directions = None if normals is None else _rows_of(normals, "normals", 3, count)
    made = _core.displace(
        (vertices, faces, of_vertices, directions),
        _texels(height),
        wraps=tuple(get_args(Wrap).index(way) for way in wraps),
        rows=rows,
        scale=scale,
        midlevel=midlevel,
        tolerance=float(tolerance),
        max_triangles=max_triangles,
    )
    if made["error"] > tolerance:
        _advice.warn(
            f"displace: the error is {made['error']:.4g}, above the tolerance of {tolerance:g}, with "
            f"{len(made['faces']):,} triangles",
            UsageWarning,
        )
    return DisplacedMesh(**made)
