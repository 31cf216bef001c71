"""What a scene may show: what shapes of all kinds share, and what meshes do."""

from __future__ import annotations

import math
import operator
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from nanite_rs import _advice, _checks, _face_data, _notebook
from nanite_rs._channels import Channel
from nanite_rs._core import check_pose
from nanite_rs.camera import Camera
from nanite_rs.cut import Cut
from nanite_rs.exceptions import ArgumentError, DtypeError, UsageWarning
from nanite_rs.material import default_material, raw_materials

if TYPE_CHECKING:
    import weakref
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray
    from typing_extensions import Self

    from nanite_rs._core import Mesh as CoreMesh
    from nanite_rs.material import Look, Material
    from nanite_rs.scene import Scene

__all__ = ["Geometry", "Moving", "Shape"]

_OUTLINE: Final = 0.01
"""Error of the cut that a picture is framed by, of the diagonal: what may stick out of it fits the margin."""


class Shape(_advice.Teaching):
    """What instances show, as the core has it."""

    __slots__ = ("__weakref__", "_core", "_materials")

    _ELEMENTS: ClassVar[str] = "triangles"
    """What it consists of, in messages."""
    _core: CoreMesh
    _materials: tuple[Material, ...]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Smallest and largest corner of the source: (2, 3) float64."""
        return np.array(self._core.bounds)

    @property
    def nbytes(self) -> int:
        """Bytes in memory."""
        return self._core.nbytes

    def __len__(self) -> int:
        """Return how many of them there are."""
        return self._core.source_faces

    def _default_look(self) -> Look:
        """The look of instances that are given none."""
        return self._materials or default_material(colored=self._core.colors is not None)

    def _outline(self) -> NDArray[np.floating[Any]]:
        """Points that all of it lies about, (N, 3)."""
        raise NotImplementedError

    def _repr_png_(self) -> bytes | None:
        """Return a picture for notebooks; None, so that they show the text, where the file is damaged."""
        return _notebook.png(self)

    def _looks(self, material: Look) -> list[dict[str, Any]]:
        """Looks as the core takes them: one, or one for each of its numbers."""
        layout, _ = _face_data.layout(name for name, _, _ in self._core.channels)
        raw = raw_materials(material)
        return raw if layout is None else layout.spread(raw)


class Moving(Shape):
    """A shape whose vertices move: scenes that show it follow."""

    __slots__ = ("_scenes",)

    _scenes: weakref.WeakSet[Scene]

    def _move(self, core: CoreMesh) -> None:
        """Show another shape in all scenes."""
        for scene in self._scenes:
            scene._core.set_mesh([*scene._moving[self]], core)
        self._core = core

    def __copy__(self) -> Self:
        """Return one of its own, in the same shape."""
        make, arguments = self._parts()
        copied: Self = make(*arguments)
        return copied

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return one of its own, in the same shape."""
        memo[id(self)] = other = self.__copy__()
        return other

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """Pickle as arrays."""
        return self._parts()

    def _parts(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        """A function, and what it makes an equal one of."""
        raise NotImplementedError


class Geometry(Shape):
    """Triangles with their looks."""

    __slots__ = ()

    @_advice.teaches(
        **dict.fromkeys(("faces", "count", "target_count", "n_faces"), "target_faces=5000 keeps so many"),
        **dict.fromkeys(("ratio", "reduction"), "target_reduction=0.9 removes 90 %"),
        otherwise="say of what: cut(error=0.1), target_faces=5000, target_reduction=0.9, or camera=",
    )
    def cut(
        self,
        *,
        error: float | None = None,
        target_faces: int | None = None,
        target_reduction: float | None = None,
        camera: Camera | None = None,
        pose: ArrayLike | None = None,
        viewport: tuple[int, int] | None = None,
        pixel_error: float = 1.0,
        exact: bool | None = None,
    ) -> Cut:
        """Pick the clusters of one threshold. Give exactly one of the first four.

        The hierarchy is walked, so the cost follows the cut and not the mesh.

        Parameters
        ----------
        error : float
            Largest error in the units of the mesh, of the shape (`Cut.error`) and of what it carries
            (`Cut.attribute_error`); 0 is full detail, infinity the coarsest cut.
        target_faces : int
            So many triangles, or up to 0.5 % or two fewer, and never more; below `min_faces` the coarsest cut there
            is. Groups are compared by the simplifier's estimate, which says more about the mean than a bound does;
            what the cut states is the bound as always.
        target_reduction : float
            Fraction of the triangles to remove, 0 to 1, as in fast-simplification; met as ``target_faces`` is.
        camera : PerspectiveCamera, IntrinsicsCamera or OrthographicCamera
            With ``pose`` and ``viewport``: the cut for this view.
        pose : (4, 4) array
            Camera-to-mesh transform, OpenGL axes (the camera looks along −Z, Y up).
        viewport : (int, int)
            Width and height in pixels.
        pixel_error : float
            Largest error in pixels, anywhere on the screen; 0 is full detail.
        exact : bool, optional
            Whether to meet a budget, True where it is left out: between two cuts of whole groups a few groups are
            simplified for it. With False the cut is the finest of whole groups with at most so many triangles,
            which is a few milliseconds cheaper.

        Returns
        -------
        Cut

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=30_000))
        >>> fine, coarse = mesh.cut(error=0.01), mesh.cut(error=0.05)
        >>> len(mesh) > len(fine) > len(coarse)
        True
        >>> fine.error <= 0.01
        True
        >>> 998 <= len(mesh.cut(target_faces=1_000)) <= 1_000
        True
        """
        selectors = {
            "error": error,
            "target_faces": target_faces,
            "target_reduction": target_reduction,
            "camera": camera,
        }
        given = [name for name, value in selectors.items() if value is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ArgumentError(f"cut: expected exactly one of {', '.join(selectors)}, found {found}")
        if exact is not None and (error is not None or camera is not None):
            raise ArgumentError("exact: goes with target_faces= and target_reduction=")
        exact = True if exact is None else _checks.truth(exact, "exact")
        if camera is not None:
            return self._cut_view(camera, pose, viewport, pixel_error)
        if pose is not None or viewport is not None:
            raise ArgumentError("pose, viewport: these go with camera=")
        if pixel_error != 1.0:
            raise ArgumentError("pixel_error: goes with camera=; error= is in units of the mesh")
        if error is not None:
            error = _checks.number(error, "error")
            if not error >= 0.0:
                raise ArgumentError(f"error: must be 0 or more, not {error}")
            return Cut(self._core.cut_error(error), self._materials)
        if target_faces is None:
            reduction = _checks.reduction(target_reduction)
            # A fraction such as 0.9 is not exact: the integer beside it is meant.
            target_faces = math.floor((1.0 - reduction) * len(self) + 1e-6)
        elif isinstance(target_faces, bool) or not isinstance(target_faces, int | np.integer):
            raise DtypeError(
                f"target_faces: expected an integer, not {type(target_faces).__name__}; "
                "target_reduction takes a fraction to remove"
            )
        elif target_faces < 1:
            raise ArgumentError(f"target_faces: must be 1 or more, not {target_faces}")
        return Cut(self._core.cut_faces(min(int(target_faces), len(self)), exact), self._materials)

    @property
    def materials(self) -> tuple[Material, ...]:
        """The looks that came with the mesh: that of face material n is the n-th, or the last if there are fewer.

        `Scene.add` draws it with them where it is given no other, and cuts have them too. Empty where there were
        none. Pickles and ``.nanite`` files keep them. Images of an opened file are read when they are looked at.

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
    def info(self) -> dict[str, Any]:
        """Sizes and bounds as a dictionary of plain values.

        Examples
        --------
        >>> info = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20)).info
        >>> info["faces"], info["levels"], info["clusters"]
        (20, 3, 3)
        """
        core = self._core
        return {
            "faces": core.source_faces,
            "vertices": core.source_vertices,
            "levels": core.level_count,
            "clusters": core.cluster_count,
            "groups": core.group_count,
            "nodes": core.node_count,
            "pages": core.page_count,
            "bytes": core.nbytes,
            "colors": core.colors,
            "uv_sets": core.uv_sets,
            "materials": core.has_materials,
            "channels": [_face_data.plain(name) for name, _, _ in core.channels],
            "bounds": [list(corner) for corner in core.bounds],
            "origin": list(core.origin),
            "precision": core.precision,
            "rounding": core.rounding,
            "normal_rounding": core.normal_rounding,
            "uv_rounding": core.uv_rounding,
        }

    @property
    def min_faces(self) -> int:
        """Triangles of the coarsest cut: a smaller budget gets these.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
        >>> len(mesh.cut(target_faces=1)) == mesh.min_faces
        True
        """
        return self._core.min_faces()

    @property
    def channels(self) -> dict[str, Channel]:
        """The dtype and width of each named channel; `Cut.channels` has the values.

        Examples
        --------
        >>> vertices, faces = nrs.shapes.icosphere(faces=20)
        >>> nrs.NaniteMesh.from_arrays(vertices, faces, channels={"x": vertices[:, :2]}).channels
        {'x': Channel(dtype=dtype('float32'), width=2)}
        """
        return {
            _face_data.plain(name): Channel(np.dtype(dtype), 1 if columns is None else columns)
            for name, dtype, columns in self._core.channels
        }

    @property
    def face_channels(self) -> dict[str, Channel]:
        """The dtype and width of what faces carry; `Cut.face_channels` has the values.

        Examples
        --------
        >>> vertices, faces = nrs.shapes.icosphere(faces=80)
        >>> nrs.NaniteMesh.from_arrays(vertices, faces, face_channels={"part": np.arange(80) % 3}).face_channels
        {'part': Channel(dtype=dtype('int64'), width=1)}
        """
        names = _face_data.layout(name for name, _, _ in self._core.channels)[1]
        return {name: channel for name, channel in self.channels.items() if name in names}

    def __len__(self) -> int:
        """Return the number of source triangles, after mending."""
        return self._core.source_faces

    def _outline(self) -> NDArray[np.floating[Any]]:
        """Vertices of a coarse cut: one for an error, since of a mesh in a file that reads few pages."""
        low, high = self.bounds
        return self.cut(error=_OUTLINE * float(np.linalg.norm(high - low))).vertices

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
