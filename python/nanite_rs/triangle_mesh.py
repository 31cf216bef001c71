"""`TriangleMesh`: an ordinary mesh, drawn as it is, whose vertices may move."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from nanite_rs import _advice, io
from nanite_rs._arrays import as_array, core_arrays, own_copy, vertex_floats
from nanite_rs._core import TriangleMesh as CoreTriangleMesh
from nanite_rs._geometry import Geometry, Moving
from nanite_rs.exceptions import ArgumentError
from nanite_rs.material import several

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs.material import Look

__all__ = ["TriangleMesh"]

NewNormals: TypeAlias = "ArrayLike | Literal['recompute'] | None"


class TriangleMesh(Geometry, Moving):
    """An ordinary triangle mesh: drawn at once and as it is, with no levels of detail, and free to move.

    It takes some 40 milliseconds per 100,000 triangles instead of building a DAG, and is drawn, culled, lit and
    picked as a `NaniteMesh` is. That pays for small meshes, and for meshes whose vertices are new in every frame.
    Nothing is welded or mended: ``frame.face_id`` has rows of ``faces``, and vertices are those of ``vertices``.
    Triangles without area are not seen. Every cut is the whole mesh as it lies now.

    Parameters
    ----------
    vertices : (N, 3) float32 or float64 array
        Positions. float64 values that are no float32 are kept about a float64 origin.
    faces : (M, 3) array of any integer type
        Triangles, counter-clockwise seen from the front.
    normals : (N, 3) floating-point array, optional
        Vertex normals of any length; computed, weighted by angle, when missing.
    colors : (N, 3) or (N, 4) array, optional
        Linear vertex colours: uint8, uint16, or floating-point from 0 to 1.
    uvs : (N, 2) floating-point array or a sequence of up to four, optional
        Texture coordinates.
    face_materials : (M,) array of any integer type, optional
        The number of each face's material, within the range of int32.
    materials : Material or sequence of Material, optional
        The look of the mesh, or one for each number of ``face_materials``, of which the last stands for all from
        there on.

    Raises
    ------
    MeshError
        Not finite, an index out of range (with its row), no faces, or too large.
    ArgumentError, DtypeError
        An array has the wrong shape, dtype or range.

    Examples
    --------
    >>> vertices, faces = nrs.shapes.icosphere(faces=1_000)
    >>> body = nrs.TriangleMesh(vertices, faces)
    >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
    >>> node = scene.add(body)
    >>> camera = nrs.PerspectiveCamera(yfov=1.0)
    >>> with nrs.Renderer(64, 64) as renderer:
    ...     before = renderer.render(scene, camera, nrs.look_at((0, 0, 3), (0, 0, 0)))
    ...     body.update(2.0 * vertices)
    ...     after = renderer.render(scene, camera, nrs.look_at((0, 0, 5), (0, 0, 0)))
    >>> bool((after.depth > 0).sum() > (before.depth > 0).sum() > 1_000)
    True
    """

    __slots__ = ("_carried", "_faces", "_normals", "_topology", "_vertices")

    _topology: CoreTriangleMesh
    # What does not change: colours, texture coordinates and face materials.
    _carried: dict[str, Any]
    _vertices: NDArray[np.floating[Any]]
    _faces: NDArray[np.integer[Any]]
    _normals: NDArray[np.float32] | None

    @_advice.teaches(
        vertex_colors="give colors=",
        channels="an ordinary mesh carries none; NaniteMesh.from_arrays does",
        otherwise="give TriangleMesh(vertices, faces), or TriangleMesh.from_trimesh(mesh)",
    )
    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        uvs: ArrayLike | Sequence[ArrayLike] | None = None,
        face_materials: ArrayLike | None = None,
        materials: Look | None = None,
    ) -> None:
        vertices, faces = as_array(vertices, "vertices"), as_array(faces, "faces")
        given = {"normals": normals, "colors": colors, "uvs": uvs, "face_materials": face_materials}
        self._materials = () if materials is None else several(materials, "materials")
        try:
            arrays = core_arrays(vertices, faces, given, None)
            self._topology = CoreTriangleMesh(arrays)
            self._core = self._topology.shape(vertices, arrays["normals"])
        except ArgumentError as error:
            more = _advice.for_arrays(str(error), vertices, faces, given)
            raise (_advice.advised(error, more) if more else _advice.near(error)) from None
        self._vertices, self._faces, self._normals = own_copy(vertices), own_copy(faces), arrays["normals"]
        self._carried = {
            "colors": None if arrays["colors"] is None else own_copy(arrays["colors"]),
            "uvs": [own_copy(array) for array in arrays["uvs"]],
            "face_materials": None if face_materials is None else own_copy(arrays["face_materials"]),
        }
        self._scenes = weakref.WeakSet()

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh) -> TriangleMesh:
        """Make one of a `trimesh.Trimesh`, with its normals, colours, texture coordinates and materials.

        ``scene.add(mesh)`` does so, too.

        Examples
        --------
        >>> import trimesh
        >>> len(nrs.TriangleMesh.from_trimesh(trimesh.creation.box()))
        12
        """
        arrays = io.from_trimesh(mesh).arrays()
        return cls(**{name: value for name, value in arrays.items() if "channels" not in name})

    def update(self, vertices: ArrayLike, *, normals: NewNormals = None) -> None:
        """Move the vertices: all instances in all scenes show the new shape from now on.

        Frames that were rendered before keep theirs.

        Parameters
        ----------
        vertices : (N, 3) float32 or float64 array
            New positions, as many as before.
        normals : (N, 3) floating-point array or "recompute", optional
            New normals of any length. By default those of the faces as they lie now, or, where normals were given
            before, these.

        Raises
        ------
        MeshError
            Not finite, with the row. The mesh stays as it was.
        ArgumentError, DtypeError
            An array has the wrong shape or dtype.
        """
        vertices = as_array(vertices, "vertices")
        if normals is None:
            given = self._normals
        elif not isinstance(normals, str):
            given = vertex_floats(normals, "normals")
        elif normals == "recompute":
            given = None
        else:
            raise ArgumentError(f'normals: expected an array or "recompute", not {normals!r}')
        core = self._topology.shape(vertices, given)
        self._move(core)
        self._vertices, self._normals = own_copy(vertices), given

    @property
    def vertices(self) -> NDArray[np.floating[Any]]:
        """Positions as they are now, (N, 3), read-only; `update` moves them."""
        return self._vertices

    @property
    def faces(self) -> NDArray[np.integer[Any]]:
        """Triangles as they were given, (M, 3), read-only."""
        return self._faces

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        arrays = {**self._carried, "normals": self._normals, "materials": self._materials or None}
        return _from_arrays, (self._vertices, self._faces, arrays)

    def __repr__(self) -> str:
        """Sizes."""
        return f"TriangleMesh({len(self.faces):,} faces, {len(self.vertices):,} vertices)"


def _from_arrays(vertices: NDArray[Any], faces: NDArray[Any], arrays: dict[str, Any]) -> TriangleMesh:
    return TriangleMesh(vertices, faces, **arrays)
