"""A live view of a mesh or a scene: `view` opens it in a notebook or a window, `Viewer` is what both show.

A `Viewer` has a camera that turns about a point, one of the `VIEWS`, the pixel error, a cut that may be frozen, and
what was picked; it draws pictures as arrays and needs no canvas. `view` puts it on one of rendercanvas, which
``pip install rendercanvas glfw wgpu jupyter_rfb ipywidgets`` installs, with ipywidgets in Jupyter and a line of
help in a window.

Examples
--------
>>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
>>> with nrs.Viewer(mesh, width=160, height=120) as viewer:
...     viewer.view = "clusters"
...     viewer.orbit.turn(0.2, 0.0)
...     picture = viewer.picture()
...     found = viewer.pick(80, 60)
>>> picture.shape, found.pixels <= viewer.pixel_error
((120, 160, 3), True)
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias, get_args

import numpy as np

from nanite_rs import _core, _images, _paint
from nanite_rs._frozen import Frozen, Ids, View, ids_of
from nanite_rs._preview import BACKGROUND, CLAY, LIGHTS, UP, _outline, framing, posed
from nanite_rs.assets import LoadedScene
from nanite_rs.camera import PerspectiveCamera
from nanite_rs.exceptions import ArgumentError, DtypeError, InternalError, StaleHandleError
from nanite_rs.mesh import NaniteMesh
from nanite_rs.renderer import POOL_BYTES, Renderer, ShadingName
from nanite_rs.scene import LightNode, MeshNode, Scene

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from numpy.typing import NDArray

    from nanite_rs.frame import Frame, OutputName
    from nanite_rs.material import Material
    from nanite_rs.stats import FrameStats

__all__ = ["VIEWS", "Orbit", "Pick", "Viewer", "view"]

Shown: TypeAlias = "NaniteMesh | Scene | LoadedScene"
CanvasName: TypeAlias = Literal["auto", "jupyter", "glfw", "qt", "wx", "offscreen"]
LiveViewName: TypeAlias = Literal[
    "shaded",
    "normals",
    "triangles",
    "clusters",
    "groups",
    "levels",
    "pages",
    "instances",
    "sizes",
    "rasterizers",
    "overdraw",
]

VIEWS: Final[tuple[LiveViewName, ...]] = get_args(LiveViewName)
"""What a `Viewer` can show."""

_OF_FRAMES: Final = ("triangles", "clusters", "groups", "levels", "rasterizers", "overdraw")
"""Views that frames have themselves."""

_OF_DRAWING: Final = ("rasterizers", "overdraw")
"""Those of how the frame itself was drawn: they show nothing of a frozen cut."""

_UNSEEN: Final = np.array((28.0, 40.0, 64.0), np.float32)
"""What is added to the grey of clusters that a frozen camera did not see: a dark blue."""

_NEAREST: Final = 1e-3
"""Distance of the near plane, of that of the pivot."""


@dataclass
class Orbit:
    """A camera that looks at a point and turns about it; assign to its fields to move it.

    Examples
    --------
    >>> orbit = nrs.viewer.Orbit(pivot=np.zeros(3), distance=2.0, azimuth=0.0, elevation=0.0)
    >>> orbit.pose[:3, 3]
    array([0., 0., 2.])
    >>> orbit.turn(np.pi / 2, 0.0)
    >>> orbit.pose[:3, 3].round(9) + 0.0
    array([2., 0., 0.])
    """

    pivot: NDArray[np.float64]
    """The point in the middle of the picture, (3,) float64 in the world."""
    distance: float
    """From the pivot to the camera, world units."""
    azimuth: float
    """Radians around the axis that points up; at 0 the camera stands on the positive Z axis, or, with Z up, on
    the negative Y axis."""
    elevation: float
    """Radians above the horizon, −π/2 to π/2."""
    yfov: float = math.radians(45.0)
    """Vertical field of view, radians."""
    up: str = "y"
    """Which axis of the world points up, ``"y"`` or ``"z"``."""

    @property
    def axes(self) -> NDArray[np.float64]:
        """Right, up and back of the camera as columns, (3, 3) float64."""
        (ca, sa), (ce, se) = ((math.cos(a), math.sin(a)) for a in (self.azimuth, self.elevation))
        local = np.array([[ca, -sa * se, sa * ce], [0.0, ce, se], [-sa, -ca * se, ca * ce]])
        axes: NDArray[np.float64] = UP[self.up] @ local
        return axes

    @property
    def pose(self) -> NDArray[np.float64]:
        """Camera-to-world matrix, (4, 4) float64."""
        axes = self.axes
        return posed(axes, self.pivot + axes[:, 2] * self.distance)

    @property
    def camera(self) -> PerspectiveCamera:
        """The camera, with a near plane that follows the distance."""
        return PerspectiveCamera(yfov=self.yfov, znear=self.distance * _NEAREST)

    def turn(self, right: float, upward: float) -> None:
        """Move the camera around the pivot.

        Parameters
        ----------
        right, upward : float
            Radians around the axis that points up, and above the horizon, where it ends at the poles.
        """
        self.azimuth = (self.azimuth + right + math.pi) % (2.0 * math.pi) - math.pi
        self.elevation = min(max(self.elevation + upward, -math.pi / 2), math.pi / 2)

    def pan(self, right: float, upward: float) -> None:
        """Move camera and pivot sideways.

        Parameters
        ----------
        right, upward : float
            As parts of the height of the picture: with 1 the pivot moves by what is seen from bottom to top.
        """
        height = 2.0 * self.distance * math.tan(self.yfov / 2.0)
        axes = self.axes
        self.pivot = self.pivot + height * (right * axes[:, 0] + upward * axes[:, 1])

    def zoom(self, factor: float) -> None:
        """Move the camera towards the pivot.

        Parameters
        ----------
        factor : float
            What the distance is divided by.
        """
        self.distance = min(max(self.distance / factor, 1e-30), 1e30)


@dataclass(frozen=True)
class Pick:
    """What a pixel shows; ``print`` it for a table."""

    x: int
    """Column of the pixel."""
    y: int
    """Row of the pixel, 0 on top."""
    instance_id: int
    """`MeshNode.instance_id` of the instance."""
    cluster_id: int
    """Address of the cluster inside its mesh."""
    triangle_id: int
    """Number of the triangle inside its cluster."""
    face_id: int
    """Row of the source ``faces``, or −1 as for `Frame.face_id`; −1 while the cut is frozen."""
    level: int
    """Level of detail of the cluster: times its surface was simplified, 0 for the source."""
    group: int
    """Number of the group that the cluster is simplified with; −1 for a root."""
    page: int
    """Number of the page that the cluster lies in."""
    error: float
    """What the rule of the cut compares: how far the cluster is from the source at most, in shape and in what it
    carries, in units of the mesh; 0 at level 0."""
    pixels: float
    """The same in pixels, as this view projects it: a bound for all of the cluster."""
    position: tuple[float, float, float]
    """The point of the surface, in the world."""
    depth: float
    """Its distance along the view axis, world units."""

    def __str__(self) -> str:
        return self.table(self.pixels)

    def table(self, pixels: float) -> str:
        """Return it in four lines.

        Parameters
        ----------
        pixels : float
            What the error is in pixels: `pixels`, or what `Viewer.pixels_now` returns.
        """
        x, y, z = self.position
        return (
            f"instance {self.instance_id}, cluster {self.cluster_id}, triangle {self.triangle_id}\n"
            f"level {self.level}, group {self.group}, page {self.page}\n"
            f"error {self.error:.4g} units = {pixels:.3g} pixels\n"
            f"at ({x:.6g}, {y:.6g}, {z:.6g})"
        )


class _Shot:
    """A frame, where it was taken from, and what its pixels show, found when it is needed."""

    def __init__(self, frame: Frame, view: View, state: tuple[Any, ...], frozen: Frozen | None) -> None:
        self.frame, self.view, self.state, self.frozen = frame, view, state, frozen

    @cached_property
    def ids(self) -> Ids:
        """What pixels show of the instances, frozen or not."""
        return ids_of(self.frame) if self.frozen is None else self._of_frozen[0]

    @property
    def rows(self) -> NDArray[np.int64]:
        """Rows of the frozen cut's clusters."""
        return self._of_frozen[1]

    @property
    def cut(self) -> Frozen:
        """The frozen cut, where there is one."""
        if self.frozen is None:
            raise InternalError("viewer: there is no frozen cut")
        return self.frozen

    @cached_property
    def _of_frozen(self) -> tuple[Ids, NDArray[np.int64]]:
        return self.cut.ids(self.frame)


class Viewer:
    """What a live view shows, without its canvas: assign, then ask for a `picture`.

    Parameters
    ----------
    shown : NaniteMesh, Scene or LoadedScene
        What to show. Where nothing lights it, two lights are added that follow the camera; they are taken away, and
        frozen cuts are thawed, by `close`.
    width, height : int
        Size of the pictures, pixels; `resize` changes it.
    view : str
        One of `VIEWS`, see there.
    pixel_error : float
        Threshold of the cut in pixels; 0 is full detail.
    yfov : float
        Vertical field of view, degrees.
    azimuth, elevation : float
        Where the camera stands at first, degrees, as for `Orbit`; everything is in sight.
    up : str
        Which axis of the world points up, ``"y"`` or ``"z"``.
    material : Material, optional
        The look of a mesh; by default those that it has, or one that shows both sides.
    shading : str, optional
        As for `Renderer.render`: by default ``"gltf"`` for a `LoadedScene`, otherwise ``"pyrender"``.
    samples : int
        Samples of each pixel in pictures that stay, 1, 4 or 16. Those of a moving camera have one.
    backend : str
        What renders, ``"auto"``, ``"cpu"`` or ``"gpu"``, as for `Renderer`.
    pool_bytes : int
        Bytes of memory for the pages of meshes in files, as for `Renderer`.

    Raises
    ------
    ArgumentError, DtypeError
        An argument is none of these.
    BackendError
        The backend is not there.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    >>> with nrs.Viewer(mesh, width=160, height=120, view="levels", pixel_error=4.0) as viewer:
    ...     viewer.freeze()
    ...     viewer.orbit.zoom(4.0)
    ...     near = viewer.picture()
    ...     viewer.pick(80, 60).pixels > viewer.pixel_error
    True
    """

    def __init__(
        self,
        shown: Shown,
        *,
        width: int = 960,
        height: int = 640,
        view: LiveViewName = "shaded",
        pixel_error: float = 1.0,
        yfov: float = 45.0,
        azimuth: float = 30.0,
        elevation: float = 20.0,
        up: Literal["y", "z"] = "y",
        material: Material | None = None,
        shading: ShadingName | None = None,
        samples: Literal[1, 4, 16] = 4,
        backend: Literal["auto", "cpu", "gpu"] = "auto",
        pool_bytes: int = POOL_BYTES,
    ) -> None:
        if up not in UP:
            raise ArgumentError(f'up: must be "y" or "z", not {up!r}')
        self._scene, points = _scene_of(shown, material)
        self._shading: ShadingName = shading or ("gltf" if isinstance(shown, LoadedScene) else "pyrender")
        self._options: dict[str, Any] = {"backend": backend, "streaming": True, "pool_bytes": pool_bytes}
        self._renderers: dict[tuple[int, int], Renderer] = {}
        self._size = 0, 0
        self._samples: Literal[1, 4, 16] = samples
        self._tables: dict[int, dict[str, NDArray[Any]]] = {}
        self._frozen: Frozen | None = None
        self._shot: _Shot | None = None
        self.changed: list[Callable[[], object]] = []
        """Called without arguments whenever something else is to be shown: see `redraw`."""
        self.selected: Pick | None = None
        """What was picked last with ``select=True``: its cluster is tinted."""
        self.selected_pixels = 0
        """Pixels of the last picture that show the selected cluster; 0 where it is turned away or hidden, or where
        another level is drawn in its place."""
        self.canvas: Any = None
        """The canvas of rendercanvas that `nanite_rs.view` put this on, or None."""
        self.widget: Any = None
        """In Jupyter, the widget with the canvas in it, or None."""
        self.stats: FrameStats | None = None
        """What the last frame cost and skipped, or None before the first."""
        self._view: LiveViewName = "shaded"
        self._pixel_error = 1.0
        self.resize(width, height)
        self.view = view
        self.pixel_error = pixel_error

        center = (points.min(axis=0) + points.max(axis=0)) / 2.0
        self.orbit = Orbit(
            center, 1.0, math.radians(azimuth), math.radians(elevation), math.radians(yfov), up
        )
        """The camera."""
        self._lights: list[tuple[LightNode, NDArray[np.float64]]] = []
        self._ambient = self._scene.ambient_light
        if self._scene._core.light_count == 0 and self._scene.environment is None:
            self._lights = [(self._scene.add(light), turned) for light, turned in LIGHTS]
            # Metals show nothing but what they reflect, which is not much of two lights.
            least = 0.25 if self._shading == "gltf" else 0.06
            self._scene.ambient_light = np.maximum(self._ambient, least)
        self._points = points - center
        self._home = center, math.radians(azimuth), math.radians(elevation)
        self.reset()
        self._renderer(self._size)  # errors of the backend come now

    # ------------------------------------------------------------------------------------------ state

    @property
    def scene(self) -> Scene:
        """The scene that is drawn: the one given, or one around the mesh given."""
        return self._scene

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures, pixels."""
        return self._size

    @property
    def backend(self) -> str:
        """What renders: ``"cpu"`` or ``"gpu"``."""
        return self._renderer(self._size).backend

    @property
    def view(self) -> LiveViewName:
        """What is shown; assign one of `VIEWS`.

        ``"shaded"``, ``"triangles"``, ``"clusters"``, ``"groups"``, ``"levels"``, ``"rasterizers"`` and
        ``"overdraw"`` as for `Frame.view`; ``"normals"``; ``"pages"`` and ``"instances"``, a colour for each; and
        ``"sizes"``, pixels of the picture that show the same triangle: red for one, blue for 1,024 or more.
        """
        return self._view

    @view.setter
    def view(self, name: LiveViewName) -> None:
        if name not in VIEWS:
            raise ArgumentError(f"view: must be one of {', '.join(VIEWS)}, not {name!r}")
        self._view = name
        self._notify()

    @property
    def pixel_error(self) -> float:
        """Threshold of the cut in pixels; assign to change it. A frozen cut is made anew for its camera."""
        return self._pixel_error

    @pixel_error.setter
    def pixel_error(self, value: float) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise DtypeError(f"pixel_error: expected a number, not {type(value).__name__}")
        if not value >= 0.0:
            raise ArgumentError(f"pixel_error: must be 0 or more, not {value}")
        if value == self._pixel_error:
            return
        self._pixel_error = float(value)
        if self._frozen is not None:
            view = self._frozen.view
            self.thaw()
            self._freeze(view)
        self._notify()

    @property
    def frozen(self) -> bool:
        """Whether the cut is frozen; assign to `freeze` or `thaw`."""
        return self._frozen is not None

    @frozen.setter
    def frozen(self, value: bool) -> None:
        if value:
            self.freeze()
        else:
            self.thaw()

    @property
    def frozen_clusters(self) -> NDArray[np.int64]:
        """Instance and address of each cluster of the frozen cut, (C, 2) int64; no rows where none is frozen."""
        if self._frozen is None:
            return np.zeros((0, 2), np.int64)
        return np.stack([self._frozen.instance.astype(np.int64), self._frozen.cluster], axis=1)

    @property
    def frozen_triangles(self) -> int:
        """Triangles of the frozen cut; 0 where none is frozen."""
        return 0 if self._frozen is None else self._frozen.triangles

    def resize(self, width: int, height: int) -> None:
        """Change the size of the pictures.

        Parameters
        ----------
        width, height : int
            Pixels, 1 to 8192.
        """
        size = int(width), int(height)
        if not all(1 <= side <= 8192 for side in size):
            raise ArgumentError(f"width, height: must be between 1 and 8192, not {width} and {height}")
        if size != self._size:
            self._size = size
            self._close_renderers()

    def reset(self) -> None:
        """Put the camera where everything is in sight."""
        self.orbit.pivot, self.orbit.azimuth, self.orbit.elevation = self._home
        width, height = self._size
        self.orbit.distance, _ = framing(self._points, self.orbit.axes, self.orbit.yfov, width / height)
        self._notify()

    def redraw(self) -> None:
        """Show what has changed in `orbit` or in the scene. Everything else shows itself.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000))
        >>> with nrs.Viewer(mesh, width=64, height=64) as viewer:
        ...     before = viewer.picture()
        ...     viewer.scene.instances[0].visible = False
        ...     viewer.redraw()
        ...     bool((viewer.picture() == before).all())
        False
        """
        self._shot = None
        self._notify()

    # -------------------------------------------------------------------------------------- pictures

    def frame(self, *, scale: float = 1.0, samples: Literal[1, 4, 16] = 1, wait: bool = True) -> Frame:
        """Render what the camera sees: `Frame` with all its arrays. A frozen cut has ids of its own there.

        Parameters
        ----------
        scale : float
            Part of width and height, up to 1.
        samples : int
            Of each pixel, as for `Renderer.render`.
        wait : bool
            Wait for pages that have to be read, as for `Renderer.render`.
        """
        return self._take(scale, samples, wait).frame

    def picture(self, *, moving: bool = False, scale: float = 1.0) -> NDArray[np.uint8]:
        """Draw what the camera sees, in the present `view`: (H, W, 3) uint8.

        Parameters
        ----------
        moving : bool
            Draw at once, with one sample for each pixel and without waiting for pages.
        scale : float
            Part of width and height that the picture has, up to 1.
        """
        samples: Literal[1, 4, 16] = 1 if moving or self._view != "shaded" else self._samples
        shot = self._take(scale, samples, not moving)
        picture = self._painted(shot)
        if self._frozen is not None:
            unseen = np.append(~self._frozen.seen, False)[shot.rows]
            grey = picture[unseen].astype(np.float32).mean(axis=-1, keepdims=True)
            picture[unseen] = (0.45 * grey + _UNSEEN).astype(np.uint8)
            self._draw_outline(picture, shot, self._frozen)
        self.selected_pixels = self._tint(picture, shot.ids, self.selected) if self.selected else 0
        return picture

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture as PNG.

        Parameters
        ----------
        path : path
            File to write, ``.png``.

        Raises
        ------
        FormatError, FileError
            The name ends otherwise, or the file cannot be written.
        """
        name = os.fsdecode(path)
        if _images.suffix(name) != ".png":
            raise ArgumentError("path: the viewer writes .png; frame() has arrays for an .exr")
        camera = {"pose": self.orbit.pose.tolist(), "yfov": self.orbit.yfov, "pixel_error": self._pixel_error}
        texts = {f"nanite_rs:{k}": str(v) for k, v in camera.items()} | {"nanite_rs:view": self._view}
        _images.write_png(name, self.picture(), texts)

    # --------------------------------------------------------------------------------------- picking

    def pick(self, x: float, y: float, *, select: bool = False) -> Pick | None:
        """Say what a pixel shows.

        The level, the group and the error are looked up in a table of the mesh's clusters, which is made when first
        needed; of a mesh in a file that reads all of it.

        Parameters
        ----------
        x, y : float
            Place in the picture, pixels from its left and upper edge.
        select : bool
            Keep it as `selected`, which tints its cluster; nothing where nothing is shown.

        Returns
        -------
        Pick or None
            None where nothing is shown.
        """
        found = self._pick(x, y)
        if select:
            self.selected = found
            self._notify()
        return found

    def pixels_now(self, picked: Pick) -> float:
        """Project the error of what was picked as the camera sees it now: grows as one nears a frozen cut.

        Parameters
        ----------
        picked : Pick
            What `pick` returned.

        Raises
        ------
        StaleHandleError
            The instance was removed from the scene.

        Examples
        --------
        >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
        >>> with nrs.Viewer(mesh, width=160, height=120, pixel_error=4.0) as viewer:
        ...     found = viewer.pick(80, 60)
        ...     viewer.pixels_now(found) == found.pixels
        ...     viewer.orbit.zoom(2.0)
        ...     viewer.pixels_now(found) > 2.0 * found.pixels
        True
        True
        """
        node = self._node(picked.instance_id)
        table = self._table(node)
        sphere = table["sphere"][np.searchsorted(table["id"], picked.cluster_id)]
        return projected(self._at_full_size(), node, sphere, picked.error)

    def center_on(self, x: float, y: float) -> bool:
        """Make what a pixel shows the pivot, at the distance that it has; False where nothing is shown.

        Parameters
        ----------
        x, y : float
            Place in the picture, as for `pick`.
        """
        shot = self._take(1.0, None, True)
        column, row, depth = self._at(shot, x, y)
        if depth == 0.0:
            return False
        self.orbit.pivot = self._point(shot, column, row, depth)
        self.orbit.distance = depth
        self._notify()
        return True

    # -------------------------------------------------------------------------------------- freezing

    def freeze(self) -> None:
        """Keep the cut of the present camera while the camera moves on.

        The cut of each instance that is in sight is made for this camera and built into a mesh of its own, which
        stands in for the instance in the scene until `thaw`; that takes some two seconds for a million triangles.
        Pictures then show these clusters from everywhere, in bluish grey those of which this camera saw nothing; so
        there are more of them than it drew.
        Where an instance is scaled differently along its axes, its frozen cut may be finer than what was drawn.
        """
        if self._frozen is None:
            self._freeze(self._at_full_size())
            self._notify()

    def thaw(self) -> None:
        """Let the cut follow the camera again."""
        if self._frozen is not None:
            self._frozen.thaw()
            self._frozen, self._shot = None, None
            self._notify()

    def _freeze(self, view: View) -> None:
        self._light(view.pose)
        renderer = self._renderer(view.size)
        frame = renderer.render(
            self._scene, view.camera, view.pose, pixel_error=self._pixel_error, outputs=_IDS
        )
        self._frozen, self._shot = Frozen(self._scene, frame, view, self._pixel_error), None

    # ----------------------------------------------------------------------------------------- ending

    def close(self) -> None:
        """Thaw, take away lights that were added, close the canvas, and give the memory back."""
        self.thaw()
        for light, _ in self._lights:
            light.remove()
        if self._lights:
            self._scene.ambient_light = self._ambient
        self._lights = []
        self._close_renderers()
        if self.canvas is not None and not self.canvas.get_closed():
            self.canvas.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        frozen = ", frozen" if self.frozen else ""
        width, height = self._size
        return f"<Viewer {width}×{height} of {self._scene!r}: {self._view}, {self._pixel_error:g} pixels{frozen}>"

    def _repr_mimebundle_(self, **options: Any) -> Any:
        """Show the widget in notebooks, and a picture where there is none."""
        if self.widget is not None:
            return self.widget._repr_mimebundle_(**options)
        return {"image/png": _images.png(self.picture()), "text/plain": repr(self)}

    # ---------------------------------------------------------------------------------------- drawing

    def _notify(self) -> None:
        for call in self.changed:
            call()

    def _at_full_size(self) -> View:
        return View(self.orbit.camera, self.orbit.pose, self._size)

    def _close_renderers(self) -> None:
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers = {}
        self._shot = None

    def _renderer(self, size: tuple[int, int]) -> Renderer:
        """The renderer of a size; those of the full size and of one other are kept."""
        if size not in self._renderers:
            for other in [s for s in self._renderers if s != self._size]:
                self._renderers.pop(other).close()
            self._renderers[size] = Renderer(*size, **self._options)
        return self._renderers[size]

    def _light(self, pose: NDArray[np.float64]) -> None:
        for light, turned in self._lights:
            light.pose = posed(pose[:3, :3] @ turned, pose[:3, 3])

    def _take(self, scale: float, samples: Literal[1, 4, 16] | None, wait: bool) -> _Shot:
        """A frame for the present state: the last one where it is still right. Samples of None: whatever it has."""
        if not 0.0 < scale <= 1.0:
            raise ArgumentError(f"scale: must be above 0 and 1 at most, not {scale}")
        size = max(round(self._size[0] * scale), 1), max(round(self._size[1] * scale), 1)
        view = View(self.orbit.camera, self.orbit.pose, size)
        # What a frame has ready depends on the view for a GPU alone: everything else is made when asked for.
        state = (view.camera, view.pose.tobytes(), size, self._pixel_error, self._view)
        last = self._shot
        if last is not None and last.state == state and samples in (None, last.frame.stats.samples):
            return last
        self._light(view.pose)
        frame = self._renderer(size).render(
            self._scene,
            view.camera,
            view.pose,
            pixel_error=0.0 if self._frozen else self._pixel_error,
            outputs=self._outputs(),
            samples=samples or 1,
            shading=self._shading,
            wait=wait,
        )
        self.stats = frame.stats
        shot = _Shot(frame, view, state, self._frozen)
        # One that did not wait may lack pages: it is not kept.
        self._shot = shot if wait else None
        return shot

    def _outputs(self) -> list[OutputName]:
        """What the picture is made of, which a GPU makes with the frame."""
        name = self._view
        made: list[OutputName] = ["color", "depth"] if name == "shaded" else ["depth"]
        if name == "rasterizers":
            # Made from what comes with any frame.
            return made
        if name in _OF_FRAMES and (self._frozen is None or name in _OF_DRAWING):
            made.append(name)
        elif name != "shaded" or self._frozen is not None or self.selected is not None:
            made += _IDS
        return made

    def _painted(self, shot: _Shot) -> NDArray[np.uint8]:
        """The present view of a shot."""
        name, frame = self._view, shot.frame
        if name == "shaded":
            return frame.color.copy()
        covered = frame.depth > 0.0
        picture = np.empty((*covered.shape, 3), np.uint8)
        picture[:] = np.rint(np.array(self._scene.bg_color) * 255.0)
        if name in _OF_DRAWING or (name in _OF_FRAMES and self._frozen is None):
            picture[covered] = frame.view(name)[covered]
        elif name == "normals":
            picture[covered] = np.rint(frame.normal[covered] * 127.5 + 127.5)
        else:
            facing = frame.normal[covered] @ shot.view.pose[:3, 2].astype(np.float32)
            picture[covered] = _paint.faced(self._colors(name, shot, covered), facing)
        return picture

    def _colors(self, name: str, shot: _Shot, covered: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Colours of covered pixels by what they show, (N, 3)."""
        instance = shot.ids.instance[covered].view(np.uint32)
        cluster = shot.ids.cluster[covered]
        triangle = shot.ids.triangle[covered].view(np.uint32)
        if name == "sizes":
            return _paint.sizes(instance, cluster, triangle)
        if name == "triangles":
            return _paint.hues(instance, cluster, triangle)
        if name == "clusters":
            return _paint.hues(instance, cluster, _paint.CLUSTERS)
        if name == "pages":
            return _paint.hues(instance, cluster >> np.uint32(_paint.PAGE_BITS), _paint.PAGES)
        if name == "instances":
            return _paint.hues(instance, instance, _paint.INSTANCES)
        # What is left are levels and groups of a frozen cut.
        frozen, rows = shot.cut, shot.rows[covered]
        if name == "levels":
            return _paint.levels(frozen.level)[rows]
        return _paint.hues(instance, self._groups(frozen)[rows], _paint.GROUPS)

    def _groups(self, frozen: Frozen) -> NDArray[np.uint32]:
        """The group of each cluster of a frozen cut; that of roots is 0xFFFFFFFF."""
        groups = np.zeros(len(frozen.cluster), np.uint32)
        for node in self._scene.instances:
            own = frozen.instance == node.instance_id
            if own.any():
                table = self._table(node)
                rows = np.searchsorted(table["id"], frozen.cluster[own])
                groups[own] = table["group"][rows].astype(np.uint32)
        return groups

    def _draw_outline(self, picture: NDArray[np.uint8], shot: _Shot, frozen: Frozen) -> None:
        """Draw what bounds the frozen camera's sight, where nothing is before it."""
        view, (height, width) = shot.view, picture.shape[:2]
        eye = frozen.view.pose[:3, 3]
        far = 1.5 * float(np.linalg.norm(self._home[0] - eye))
        t = np.linspace(0.0, 1.0, 2 * (width + height))[:, None]
        points = np.concatenate([a + (b - a) * t for a, b in frozen.outline(far)])
        local = (points - view.pose[:3, 3]) @ view.pose[:3, :3]
        away = -local[:, 2]
        before = away > view.camera.znear
        focal = height / (2.0 * math.tan(view.camera.yfov / 2.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = width / 2.0 + focal * local[:, 0] / away, height / 2.0 - focal * local[:, 1] / away
        inside = before & (x >= 0.0) & (x < width - 1) & (y >= 0.0) & (y < height - 1)
        x, y, away = x[inside].astype(np.intp), y[inside].astype(np.intp), away[inside]
        depth = shot.frame.depth[y, x]
        free = (depth == 0.0) | (away < depth)
        for dx, dy in ((0, 0), (1, 0), (0, 1)):
            picture[y[free] + dy, x[free] + dx] = (214, 69, 38)

    @staticmethod
    def _tint(picture: NDArray[np.uint8], ids: Ids, picked: Pick) -> int:
        """Tint a cluster, more so its triangle, draw a line around it, and return how many pixels it has."""
        cluster = (ids.instance == picked.instance_id) & (ids.cluster == picked.cluster_id)
        triangle = cluster & (ids.triangle == picked.triangle_id)
        inner = _shrunk(cluster)
        # One of the two lines is seen on any colour.
        edges = (cluster & ~inner, _YELLOW, 1.0), (inner & ~_shrunk(inner), _DARK, 1.0)
        for where, color, part in ((cluster, _YELLOW, 0.35), (triangle, _YELLOW, 0.8), *edges):
            mixed = picture[where] * (1.0 - part) + np.array(color) * part
            picture[where] = mixed.astype(np.uint8)
        return int(cluster.sum())

    # ----------------------------------------------------------------------------------------- asking

    def _at(self, shot: _Shot, x: float, y: float) -> tuple[int, int, float]:
        width, height = self._size
        if not (0 <= x < width and 0 <= y < height):
            raise ArgumentError(f"x, y: ({x}, {y}) lies outside of {width} × {height} pixels")
        column, row = int(x), int(y)
        return column, row, float(shot.frame.depth[row, column])

    def _point(self, shot: _Shot, column: int, row: int, depth: float) -> NDArray[np.float64]:
        width, height = shot.view.size
        per_pixel = 2.0 * math.tan(shot.view.camera.yfov / 2.0) / height
        local = depth * np.array(
            [(column + 0.5 - width / 2.0) * per_pixel, (height / 2.0 - row - 0.5) * per_pixel, -1.0]
        )
        point: NDArray[np.float64] = shot.view.pose[:3, :3] @ local + shot.view.pose[:3, 3]
        return point

    def _pick(self, x: float, y: float) -> Pick | None:
        shot = self._take(1.0, None, True)
        column, row, depth = self._at(shot, x, y)
        instance = int(shot.ids.instance[row, column])
        if instance < 0:
            return None
        node = self._node(instance)
        cluster = int(shot.ids.cluster[row, column])
        table = self._table(node)
        at = int(np.searchsorted(table["id"], cluster))
        error = max(float(table["error"][at]), 0.0)
        px, py, pz = (float(c) for c in self._point(shot, column, row, depth))
        return Pick(
            x=column,
            y=row,
            instance_id=instance,
            cluster_id=cluster,
            triangle_id=int(shot.ids.triangle[row, column]),
            face_id=-1 if self._frozen else int(shot.frame.face_id[row, column]),
            level=int(table["level"][at]),
            group=int(table["group"][at]),
            page=cluster >> _paint.PAGE_BITS,
            error=error,
            pixels=projected(shot.view, node, table["sphere"][at], error),
            position=(px, py, pz),
            depth=depth,
        )

    def _node(self, instance: int) -> MeshNode:
        for at, (mesh, _) in self._scene._shown.items():
            if at[0] == instance:
                return MeshNode(self._scene, at, mesh)
        raise StaleHandleError(f"instance {instance} was removed from the scene")

    def _table(self, node: MeshNode) -> dict[str, NDArray[Any]]:
        """The clusters of an instance's mesh, by address."""
        key = id(node.mesh._core)
        if key not in self._tables:
            self._tables[key] = _core.cluster_table(node.mesh._core)
        return self._tables[key]


_IDS: Final[tuple[OutputName, ...]] = ("instance_id", "cluster_id", "triangle_id")
_YELLOW: Final = (255, 224, 30)
_DARK: Final = (25, 25, 30)


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask without the pixels at its rim, which the rim of the picture is not."""
    padded = np.pad(mask, 1, mode="edge")
    return mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]


def projected(view: View, node: MeshNode, sphere: NDArray[np.float64], error: float) -> float:
    """An error in units of a mesh, on a sphere, in pixels of a view: the bound of ``src/math/project.rs``."""
    if error <= 0.0:
        return 0.0
    pose, projection = node.pose, view.camera.projection_matrix(*view.size)
    scale = float(np.linalg.svd(pose[:3, :3], compute_uv=False)[0])
    center = pose[:3, :3] @ sphere[:3] + pose[:3, 3]
    x, y, z = (center - view.pose[:3, 3]) @ view.pose[:3, :3]
    moved = error * scale
    radius = sphere[3] * scale + moved
    distance = math.sqrt(x * x + y * y + z * z) - radius
    widest = 1.0 + 1.0 / projection[0, 0] ** 2 + 1.0 / projection[1, 1] ** 2
    depth = -z - radius
    if depth > 0.0:
        widest = min(widest, 1.0 + ((math.hypot(x, y) + radius) / depth) ** 2)
    focal = max(projection[0, 0] * view.size[0], projection[1, 1] * view.size[1]) / 2.0
    return float(moved * focal * widest / max(distance, view.camera.znear))


def _scene_of(shown: Shown, material: Material | None) -> tuple[Scene, NDArray[np.float64]]:
    """A scene, and points around all of it."""
    if isinstance(shown, NaniteMesh):
        scene = Scene(bg_color=BACKGROUND)
        scene.add(shown, material=material or shown.materials or replace(CLAY, double_sided=True))
        return scene, _outline(shown)
    if material is not None:
        raise ArgumentError("material: goes with a mesh; instances of a scene have their own")
    scene = shown.scene if isinstance(shown, LoadedScene) else shown
    if not isinstance(scene, Scene):
        raise DtypeError(
            f"shown: expected a NaniteMesh, a Scene or a LoadedScene, not {type(shown).__name__}; "
            "NaniteMesh.from_trimesh, from_file and load_scene make one"
        )
    if not len(scene):
        raise ArgumentError("shown: the scene has no instance of a mesh")
    low, high = scene.bounds
    return scene, np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)


def view(
    shown: Shown | Viewer,
    *,
    canvas: CanvasName = "auto",
    block: bool = True,
    **options: Any,
) -> Viewer:
    """Show a mesh or a scene live: in the cell of a notebook, or in a window.

    Left drag turns, right drag or shift and drag moves, the wheel zooms, a double click makes a point the one that
    the camera turns about, a click says what is there. Keys: F freezes the cut, R resets the camera, S saves a PNG
    in the working directory, V and shift V change the view, [ and ] the pixel error, 0 shows full detail, H hides
    the help, Escape forgets what was picked. In a notebook there are a menu, a slider and buttons besides.

    While the camera moves, the CPU draws pictures at a lower resolution where the full one takes too long.

    Parameters
    ----------
    shown : NaniteMesh, Scene, LoadedScene or Viewer
        What to show.
    canvas : str
        Where: ``"jupyter"``, ``"glfw"``, ``"qt"``, ``"wx"``, or ``"offscreen"`` for tests; ``"auto"`` takes Jupyter
        in a notebook and otherwise a window of glfw. glfw draws by wgpu, which wants a device of Vulkan, Metal or
        DX12, in software if need be; Qt and wx do without, and are packages of their own.
    block : bool
        Return when the window is closed. Otherwise at once; then ``viewer.canvas`` draws while an event loop runs.
    options
        As for `Viewer`: ``width``, ``height``, ``view``, ``pixel_error`` and more.

    Returns
    -------
    Viewer
        What is shown: assign to its ``view``, ``pixel_error``, ``frozen``. The last line of a cell shows it.

    Raises
    ------
    ArgumentError, DtypeError
        An argument is none of these.
    DependencyError
        A package is missing; the message says which.
    BackendError
        No window can be opened here.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    >>> viewer = nrs.view(mesh, canvas="offscreen", width=160, height=120)
    >>> viewer.canvas.draw().shape
    (120, 160, 4)
    >>> viewer.close()
    """
    from nanite_rs import _canvas

    if isinstance(shown, Viewer) and options:
        raise ArgumentError(f"{', '.join(options)}: assign to the viewer that is shown")
    name = _canvas.chosen(canvas)
    viewer = shown if isinstance(shown, Viewer) else Viewer(shown, **options)
    _canvas.attach(viewer, name, block=block)
    return viewer
