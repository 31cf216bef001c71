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
...     picture = viewer.image()
...     found = viewer.pick(80, 60)
>>> picture.shape, found.pixels <= viewer.pixel_error
((120, 160, 3), True)
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs import _canvas, _images, _picking, _views
from nanite_rs._frozen import Frozen, View, ViewFrame
from nanite_rs._geometry import Shape
from nanite_rs._orbit import Orbit
from nanite_rs._picking import Pick
from nanite_rs._preview import BACKGROUND, CLAY, LIGHTS, UP, framing, look_of, outline, posed
from nanite_rs.assets import LoadedScene
from nanite_rs.exceptions import ArgumentError, DtypeError
from nanite_rs.renderer import POOL_BYTES, Renderer, ShadingName, ShadowsName
from nanite_rs.scene import LightNode, Scene

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from numpy.typing import NDArray

    from nanite_rs._canvas import CanvasName
    from nanite_rs._views import LiveViewName
    from nanite_rs.frame import Frame
    from nanite_rs.material import Material
    from nanite_rs.stats import FrameStats

__all__ = ["SHADOW_VIEWS", "VIEWS", "Orbit", "Pick", "Viewer", "view"]

Shown: TypeAlias = "Shape | Scene | LoadedScene"

SHADOW_VIEWS: Final[tuple[LiveViewName, ...]] = _views.SHADOW_VIEWS
"""What a `Viewer` that draws shadows can show besides."""
VIEWS: Final[tuple[LiveViewName, ...]] = _views.VIEWS
"""What a `Viewer` can show."""


class Viewer:
    """What a live view shows, without its canvas: assign, then ask for an `image`.

    Parameters
    ----------
    shown : NaniteMesh, TriangleMesh, Points, Lines, Scene or LoadedScene
        What to show. Where nothing lights it, two lights are added that follow the camera; they are taken away, and
        frozen cuts are thawed, by `close`.
    width, height : int
        Size of the pictures, pixels; `resize` changes it.
    view : str
        One of `VIEWS` or, with `shadows`, of `SHADOW_VIEWS`.
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
    shadows : bool or str
        Lights cast shadows, as for `Renderer.render`: True, ``"virtual"`` or ``"cascaded"``.
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
    ...     near = viewer.image()
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
        shadows: bool | ShadowsName = False,
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
        self._shadows = shadows
        self._tables = _picking.ClusterTables()
        self._frozen: Frozen | None = None
        self._last: ViewFrame | None = None
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
            # Metals only show reflections, and two lights give few.
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
    def views(self) -> tuple[LiveViewName, ...]:
        """What can be shown: `VIEWS` and, with ``shadows=True``, `SHADOW_VIEWS`."""
        return (*VIEWS, *SHADOW_VIEWS) if self._shadows else VIEWS

    @property
    def view(self) -> LiveViewName:
        """What is shown; assign one of `views`.

        ``"shaded"``, ``"triangles"``, ``"clusters"``, ``"groups"``, ``"levels"``, ``"rasterizers"`` and
        ``"overdraw"`` as for `Frame.view`; ``"normals"``; ``"pages"`` and ``"instances"``, a colour for each; and
        ``"sizes"``, pixels of the picture that show the same triangle: red for one, blue for 1,024 or more. With
        ``shadows=True`` also ``"shadow_pages"``, ``"shadow_levels"``, ``"shadow_kept"`` and ``"shadow_cut"``, as
        for `Frame.view`.
        """
        return self._view

    @view.setter
    def view(self, name: LiveViewName) -> None:
        if name in SHADOW_VIEWS and not self._shadows:
            raise ArgumentError(f"view: {name!r} needs Viewer(shadows=True)")
        if name not in self.views:
            raise ArgumentError(f"view: must be one of {', '.join(self.views)}, not {name!r}")
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
        ...     before = viewer.image()
        ...     viewer.scene.instances[0].visible = False
        ...     viewer.redraw()
        ...     bool((viewer.image() == before).all())
        False
        """
        self._last = None
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

    def image(self, *, moving: bool = False, scale: float = 1.0) -> NDArray[np.uint8]:
        """Draw what the camera sees, in the present `view`: (H, W, 3) uint8.

        Parameters
        ----------
        moving : bool
            Draw at once, with one sample for each pixel and without waiting for pages.
        scale : float
            Part of width and height that the picture has, up to 1.
        """
        samples: Literal[1, 4, 16] = 1 if moving or self._view != "shaded" else self._samples
        shown = self._take(scale, samples, not moving)
        picture = _views.painted(self._view, shown, self._scene, self._tables)
        if self._frozen is not None:
            _views.draw_frozen(picture, shown, self._home[0])
        self.selected_pixels = _views.tint(picture, shown.ids, self.selected) if self.selected else 0
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
        _images.write_png(name, self.image(), texts)

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
        found = _picking.picked(self._take(1.0, None, True), self._scene, self._tables, x, y)
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
        node = _picking.node_of(self._scene, picked.instance_id)
        table = self._tables.of(node)
        sphere = table["sphere"][np.searchsorted(table["id"], picked.cluster_id)]
        return _picking.projected(self._at_full_size(), node, sphere, picked.error)

    def center_on(self, x: float, y: float) -> bool:
        """Make what a pixel shows the pivot, at the distance that it has; False where nothing is shown.

        Parameters
        ----------
        x, y : float
            Place in the picture, as for `pick`.
        """
        shown = self._take(1.0, None, True)
        column, row, depth = _picking.pixel_at(shown, x, y)
        if depth == 0.0:
            return False
        self.orbit.pivot = _picking.point_at(shown.view, column, row, depth)
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
            self._frozen, self._last = None, None
            self._notify()

    def _freeze(self, view: View) -> None:
        self._light(view.pose)
        renderer = self._renderer(view.size)
        frame = renderer.render(
            self._scene, view.camera, view.pose, pixel_error=self._pixel_error, outputs=_views.IDS
        )
        self._frozen, self._last = Frozen(self._scene, frame, view, self._pixel_error), None

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
        return {"image/png": _images.png(self.image()), "text/plain": repr(self)}

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
        self._last = None

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

    def _take(self, scale: float, samples: Literal[1, 4, 16] | None, wait: bool) -> ViewFrame:
        """A frame for the present state: the last one where it is still right. Samples of None: whatever it has."""
        if not 0.0 < scale <= 1.0:
            raise ArgumentError(f"scale: must be above 0 and 1 at most, not {scale}")
        size = max(round(self._size[0] * scale), 1), max(round(self._size[1] * scale), 1)
        view = View(self.orbit.camera, self.orbit.pose, size)
        # Only on a GPU does the view decide which arrays come with a frame: everything else is made when asked for.
        state = (view.camera, view.pose.tobytes(), size, self._pixel_error, self._view)
        last = self._last
        if last is not None and last.state == state and samples in (None, last.frame.stats.samples):
            return last
        self._light(view.pose)
        frame = self._renderer(size).render(
            self._scene,
            view.camera,
            view.pose,
            pixel_error=0.0 if self._frozen else self._pixel_error,
            outputs=_views.outputs_of(
                self._view, frozen=self._frozen is not None, selected=self.selected is not None
            ),
            samples=samples or 1,
            shading=self._shading,
            shadows=self._shadows,
            wait=wait,
        )
        self.stats = frame.stats
        shown = ViewFrame(frame, view, state, self._frozen)
        # A frame that did not wait may lack pages, so it is not kept.
        self._last = shown if wait else None
        return shown


def _scene_of(shown: Shown, material: Material | None) -> tuple[Scene, NDArray[np.float64]]:
    """A scene, and points around all of it."""
    if isinstance(shown, Shape):
        scene = Scene(bg_color=BACKGROUND)
        scene.add(shown, material=material or look_of(shown, replace(CLAY, double_sided=True)))
        return scene, outline(shown)
    if material is not None:
        raise ArgumentError("material: goes with a mesh; instances of a scene have their own")
    scene = shown.scene if isinstance(shown, LoadedScene) else shown
    if not isinstance(scene, Scene):
        raise DtypeError(
            f"shown: expected a mesh, points, lines or a scene of nanite_rs, not {type(shown).__name__}; "
            "NaniteMesh.from_trimesh, from_file, Points.from_trimesh and load_scene make one"
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
    shown : NaniteMesh, TriangleMesh, Points, Lines, Scene, LoadedScene or Viewer
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
    if isinstance(shown, Viewer) and options:
        raise ArgumentError(f"{', '.join(options)}: assign to the viewer that is shown")
    name = _canvas.chosen(canvas)
    viewer = shown if isinstance(shown, Viewer) else Viewer(shown, **options)
    _canvas.attach(viewer, name, block=block)
    return viewer
