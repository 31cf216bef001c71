"""What a scene may show: the part of it that meshes of all kinds share."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any

import numpy as np

from nanite_rs import _advice, _checks, _face_data, _notebook
from nanite_rs._core import check_pose
from nanite_rs.camera import Camera
from nanite_rs.cut import Cut
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning
from nanite_rs.material import raw_materials

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from nanite_rs._core import Mesh as CoreMesh
    from nanite_rs.material import Look, Material

__all__ = ["Geometry"]


class Geometry(_advice.Teaching):
    """Triangles with their looks, as the core has them."""

    __slots__ = ("__weakref__", "_core", "_materials")

    _core: CoreMesh
    _materials: tuple[Material, ...]

    @property
    def materials(self) -> tuple[Material, ...]:
        """The looks that came with the mesh: that of face material n is the n-th, or the last if there are fewer.

        `Scene.add` draws it with them where it is given no other, and cuts have them too. Empty where there were
        none. Pickles keep them, ``.nanite`` files do not, of which `save` warns.

        Examples
        --------
        >>> red, blue = nrs.Material(base_color=(1, 0, 0)), nrs.Material(base_color=(0, 0, 1))
        >>> vertices, faces = nrs.shapes.icosphere(faces=20)
        >>> mesh = nrs.NaniteMesh.from_arrays(
        ...     vertices, faces, face_materials=np.arange(20) % 2, materials=[red, blue]
        ... )
        >>> mesh.materials == mesh.cut(error=0).materials == (red, blue)
        True
        """
        return self._materials

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest corner of the source: (2, 3) float64."""
        return np.array(self._core.bounds)

    @property
    def nbytes(self) -> int:
        """Bytes in memory."""
        return self._core.nbytes

    def __len__(self) -> int:
        """Return the number of source triangles, after mending."""
        return self._core.source_faces

    def _repr_png_(self) -> bytes | None:
        """Return a picture for notebooks; None, so that they show the text, where the file is damaged."""
        return _notebook.png(self)

    def _looks(self, material: Look) -> list[dict[str, Any]]:
        """Looks as the core takes them: one, or one for each of its numbers."""
        layout, _ = _face_data.layout(name for name, _, _ in self._core.channels)
        raw = raw_materials(material)
        return raw if layout is None else layout.spread(raw)

    def _cut_view(
        self, camera: Camera, pose: ArrayLike | None, viewport: tuple[int, int] | None, pixel_error: float
    ) -> Cut:
        if pose is None or viewport is None:
            raise ArgumentError("camera: pose= and viewport= are needed with it")
        try:
            width, height = (operator.index(side) for side in viewport)
        except (TypeError, ValueError):
            raise ArgumentError(
                f"viewport: expected (width, height) in whole pixels, not {viewport!r}"
            ) from None
        if min(width, height) < 1:
            raise ArgumentError(f"viewport: sides must be positive, not {width} × {height}")
        pixel_error = _checks.number(pixel_error, "pixel_error")
        if not pixel_error >= 0.0:
            raise ArgumentError(f"pixel_error: must be 0 or more, not {pixel_error}")
        if not isinstance(camera, Camera):
            raise DtypeError(f"camera: expected a camera of nanite_rs, not {type(camera).__name__}")
        try:
            core = self._core.cut_view(camera._spec(), pose, (width, height), pixel_error)
        except ArgumentError as error:
            of_pose = str(error).startswith("pose")
            raise _advice.advised(error, _advice.for_pose(pose) if of_pose else "") from None
        if note := _advice.of_rounded_pose(check_pose(pose)):
            _advice.warn(note, UsageWarning)
        return Cut(core, self._materials)

    def _cut_error(self, error: float) -> Cut:
        return Cut(self._core.cut_error(error), self._materials)
