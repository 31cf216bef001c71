"""The renderer: scenes into frames."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _batch, _checks, _core, _unseen
from nanite_rs._geometry import Geometry
from nanite_rs.assembly import Assembly
from nanite_rs.camera import Camera, IntrinsicsCamera
from nanite_rs.exceptions import ArgumentError, DtypeError, NaniteError, UsageWarning
from nanite_rs.frame import Frame
from nanite_rs.material import several
from nanite_rs.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

    from nanite_rs.frame import OutputName

__all__ = ["Calibration", "Renderer", "StreamWarning", "TextureWarning", "View"]

POOL_BYTES = 512 << 20
"""Bytes of a renderer's pool with ``streaming=True``, unless asked for otherwise."""

RasterName: TypeAlias = Literal["auto", "compute", "hybrid", "hardware", "measured"]
TransferName: TypeAlias = Literal["gamma22", "srgb", "linear"]
ShadingName: TypeAlias = Literal["gltf", "pyrender", "flat", "normals"]
ShadowsName: TypeAlias = Literal["virtual", "cascaded"]

SHADOW_BYTES = 256 << 20
"""Bytes of pages of shadow maps at most, unless asked for otherwise."""
SHADOW_SAMPLES = 32
"""Rays to a light with a size, unless asked for otherwise."""


class TextureWarning(UserWarning):
    """A GPU has no room for all textures: some are shown from smaller versions of their images."""


class StreamWarning(UserWarning):
    """Part of a streamed mesh could not be read: it is shown with less detail until it can be."""


@dataclass(frozen=True)
class Calibration:
    """Which rasterizers of a device are the fastest, by a short measurement."""

    raster: str
    """What ``raster="measured"`` takes: ``"compute"``, ``"hybrid"`` or ``"hardware"``."""
    reason: str
    """Why."""
    times_ms: dict[str, float]
    """Milliseconds that each form takes for 512 clusters of small triangles and 512 of large ones. Absent are those
    that the device lacks, and those whose pixels were not exactly those of ``"compute"``."""


@dataclass(frozen=True)
class View:
    """A view of a scene for `Renderer.render_views`: a camera, where it is, and what it has of its own.

    What is None is as the call has it.

    Examples
    --------
    A picture, and a map of depths from above, in one call:

    >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
    >>> node = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000)))
    >>> camera = nrs.PerspectiveCamera(yfov=0.8)
    >>> views = [
    ...     nrs.View(camera, nrs.look_at((0, 0, 4), (0, 0, 0))),
    ...     nrs.View(camera, nrs.look_at((0, 4, 0.1), (0, 0, 0)), id=7, size=(32, 32), depth_only=True),
    ... ]
    >>> with nrs.Renderer(64, 48) as renderer:
    ...     picture, above = renderer.render_views(scene, views)
    >>> picture.color.shape, above.depth.shape
    ((48, 64, 3), (32, 32))
    """

    camera: Camera
    """How to project the scene."""
    pose: ArrayLike
    """(4, 4) camera-to-world matrix, as for `Renderer.render`."""
    id: int | None = None
    """Identity, 0 to 2^63 - 1: a frame starts from what the frame before of the same identity showed, whatever else
    is drawn with it and in whatever order. By default the place among the views of the call."""
    size: tuple[int, int] | None = None
    """Width and height of the picture, pixels; by default those of the renderer."""
    pixel_error: float | None = None
    """Threshold of the cut, pixels."""
    outputs: Sequence[OutputName] | None = None
    """What to make right away."""
    depth_only: bool | None = None
    """Draw depth and nothing else."""


@dataclass(frozen=True)
class _Options:
    """How frames are rendered, see `Renderer.render`."""

    pixel_error: float
    occlusion: bool
    raster: RasterName
    outputs: Sequence[OutputName] | None
    depth_only: bool
    samples: int
    shading: ShadingName
    transfer: TransferName
    wait: bool
    shadows: bool | ShadowsName
    shadow_memory: int
    shadow_samples: int
    max_layers: int
    transparent_ids: bool = False
    motion: bool = False

    def raw(self) -> dict[str, Any]:
        """What the core takes."""
        if not isinstance(self.pixel_error, int | float | np.integer | np.floating):
            raise DtypeError(f"pixel_error: expected a number, not {type(self.pixel_error).__name__}")
        return {
            "pixel_error": float(self.pixel_error),
            "occlusion": bool(self.occlusion),
            "raster": str(self.raster),
            "outputs": _names(self.outputs),
            "depth_only": bool(self.depth_only),
            "samples": _whole(self.samples, "samples", 1 << 32, "1 and 16"),
            "shading": str(self.shading),
            "transfer": str(self.transfer),
            "wait": bool(self.wait),
            "shadows": _shadows(self.shadows),
            "shadow_memory": _whole(self.shadow_memory, "shadow_memory", 1 << 63, "0 and 2^63"),
            "shadow_samples": _whole(self.shadow_samples, "shadow_samples", 1 << 32, "1 and 256"),
            "max_layers": _whole(self.max_layers, "max_layers", 1 << 32, "0 and 256"),
            "transparent_ids": bool(self.transparent_ids),
            "motion": bool(self.motion),
        }


class Renderer(_advice.Teaching):
    """Renders scenes into pictures of one size.

    Memory is kept between frames; use it in a ``with`` block, or call `close`, to give it back at once. Pickles and
    copies are new renderers with the same settings.

    Parameters
    ----------
    width, height : int
        Size of the pictures in pixels, 1 to 8192.
    backend : str
        ``"cpu"``; ``"gpu"``, the best Vulkan, Metal or DX12 device; or ``"auto"``, such a device unless it is
        software, else ``"cpu"``, also from the first frame on that the device cannot draw. Pictures are the same,
        but for a few colours that a device rounds the other way, by one step; see `render` for what its own
        rasterizer may change.
    streaming : bool
        Of meshes that `NaniteMesh.open` opened, keep in memory what the pictures need, in a pool of `pool_bytes`,
        and read the rest from their files when it is needed, on threads of its own. Otherwise the first frame reads
        all.
    pool_bytes : int
        Bytes of the pool. What always stays in it, of most meshes 32 KiB at most, has to fit. On a GPU every other
        page counts as 128 KiB, and the first frame takes memory for the pool, at most for twice the pages of the
        scene. Frames that are kept hold the pages that they show, beyond this.

    threads : int
        Threads that each picture is drawn with on the CPU; 0 for as many as `get_num_threads` says.

    Raises
    ------
    ArgumentError
        For a size out of range or an unknown backend.
    BackendError
        If the backend is not available; the message names what is missing.

    Examples
    --------
    >>> mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000))
    >>> scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    >>> node = scene.add(mesh)
    >>> sun = scene.add(nrs.DirectionalLight(intensity=3.0))
    >>> pose = np.eye(4)
    >>> pose[2, 3] = 4.0
    >>> with nrs.Renderer(128, 72) as renderer:
    ...     frame = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), pose)
    >>> frame.stats.triangles < len(mesh)
    True
    """

    @_advice.teaches(otherwise="give Renderer(width, height)")
    def __init__(
        self,
        width: int,
        height: int,
        *,
        backend: Literal["auto", "cpu", "gpu"] = "auto",
        streaming: bool = False,
        pool_bytes: int = POOL_BYTES,
        threads: int = 0,
    ) -> None:
        self._size = _pixels(width, "width"), _pixels(height, "height")
        pool = _whole(pool_bytes, "pool_bytes", 1 << 63, "0 and 2^63")
        count = _checks.whole(threads, "threads", 0, _core.MOST_THREADS)
        self._settings = {"backend": backend, "streaming": streaming, "pool_bytes": pool, "threads": count}
        if not isinstance(backend, str):
            raise DtypeError(f'backend: expected "auto", "cpu" or "gpu", not {backend!r}')
        if not streaming and pool != POOL_BYTES:
            _advice.warn("pool_bytes: counts with streaming=True alone", UsageWarning)
        try:
            core = _core.Renderer(*self._size, backend, pool if streaming else None, count)
        except ArgumentError as error:
            raise _advice.near(error) from None
        self._core: _core.Renderer | None = core
        # Empty pictures are explained until one shows something.
        self._blank = True
        # Whether there was a warning of a pose that mirrors, or is off a rotation.
        self._mirrors = False
        self._inexact = False
        self._backend = self._core.backend
        # Images whose largest mip levels the last frame lacked.
        self._smaller = 0

    @property
    def width(self) -> int:
        """Width of the pictures, pixels."""
        return self._size[0]

    @property
    def height(self) -> int:
        """Height of the pictures, pixels."""
        return self._size[1]

    @property
    def backend(self) -> str:
        """The backend in use."""
        return self._backend[0]

    @property
    def backend_reason(self) -> str:
        """Why that backend, and on a GPU which device."""
        return self._backend[1]

    @property
    def calibration(self) -> Calibration | None:
        """How ``raster="measured"`` chose on the device; None on the CPU, and before its first frame."""
        found = None if self._core is None else self._core.calibration
        if found is None:
            return None
        raster, reason, times = found
        return Calibration(raster, reason, dict(times))

    @_advice.teaches(
        error="give pixel_error=",
        flags="give shading=, outputs= or depth_only=",
        otherwise="give render(scene, camera, pose); orbit and look_at make poses",
    )
    def render(
        self,
        scene: Scene,
        camera: Camera,
        pose: ArrayLike,
        *,
        pixel_error: float = 1.0,
        occlusion: bool = True,
        raster: RasterName = "auto",
        outputs: Sequence[OutputName] | None = None,
        depth_only: bool = False,
        samples: Literal[1, 4, 16] = 1,
        shading: ShadingName = "pyrender",
        transfer: TransferName = "gamma22",
        wait: bool = True,
        shadows: bool | ShadowsName = False,
        shadow_memory: int = SHADOW_BYTES,
        shadow_samples: int = SHADOW_SAMPLES,
        max_layers: int = 8,
        transparent_ids: bool = False,
        motion: bool = False,
    ) -> Frame:
        """Render a frame.

        Parameters
        ----------
        scene : Scene
            What to draw.
        camera : PerspectiveCamera, IntrinsicsCamera or OrthographicCamera
            How to project it.
        pose : (4, 4) array
            Camera-to-world matrix: a rotation and a translation. The camera looks along its −Z, +Y is up. Of one
            whose numbers are off a rotation by up to 0.01 the nearest rotation is taken.
        pixel_error : float
            Threshold of the cut: the error of no cluster projects above so many pixels. 0 is full detail.
        occlusion : bool
            Skip what nearer surfaces hide, where that pays. The picture is the same bit for bit. The GPU backend
            starts from what the frame before hid, and a first frame from its nearest instances.
        raster : str
            What draws triangles on a GPU: ``"compute"`` shaders, whose pictures are those of the CPU;
            ``"hardware"``, the device's own rasterizer, for all that need not be clipped; ``"hybrid"``, shaders
            for small triangles and the device's rasterizer for large ones; ``"measured"``, the fastest of these by
            a short measurement on the device, see `calibration`; or ``"auto"``, which chooses by the adapter alone
            and so is reproducible: ``"compute"``, the fastest on every GPU that was measured. All cover the same
            pixels, which ``"measured"`` makes sure of; ties in depth and the last bits of depths may differ. The
            CPU has one form, ``"compute"``.
        outputs : sequence of str
            What to make right away, on a GPU with the frame: ``"color"``, ``"linear"``, ``"depth"``, ``"normal"``,
            ``"instance_id"``, ``"cluster_id"``, ``"triangle_id"``, ``"overdraw"``, ``"base_color"``,
            ``"shading_normal"``, ``"orm"``, ``"emissive"``, and of the pictures of `Frame.view` ``"triangles"``,
            ``"clusters"``, ``"groups"`` and ``"levels"``. Everything else is made when first asked for, on the CPU.
            By default colour and depth; with `depth_only`, depth.
        depth_only : bool
            Draw depth and nothing else, for shadows and sensors of depth: the same `Frame.depth` bit for bit, for
            less time and memory. The frame has `Frame.depth` and `Frame.stats`; its other arrays and views raise
            `ArgumentError`.
        samples : int
            Samples of the colour of each pixel, against jagged edges: 1, at the pixel's centre; or 4 or 16 about
            it, in the standard patterns of Direct3D and Vulkan, with their mean taken in linear light. The frame is
            drawn once through the centres, where depth, normals, ids and all views but ``"shaded"`` are taken, and
            once more for each sample, with the same cut.
        shading : str
            What colours are. ``"pyrender"``: light reflected by the metallic-roughness model as pyrender 0.1.45 has
            it, peculiarities included: colours of textures are filtered as they are encoded, only the first UV set
            counts and textures are not transformed, occlusion dims all light, vertex colours multiply what was lit,
            back faces are lit as their front. ``"gltf"``: the same model as glTF defines it. ``"flat"``: base
            colours without light. ``"normals"``: world-space normals, from -1..1 to 0..1, not encoded.
        transfer : str
            What encodes linear light in `Frame.color`: ``"gamma22"``, the power 1/2.2 as in pyrender; ``"srgb"``,
            the curve of IEC 61966-2-1; or ``"linear"``, none. `Frame.linear` is not encoded.
        wait : bool
            With ``streaming=True``, draw until all that the picture needs is there, as far as the pool has room:
            the picture is then that of the whole mesh, bit for bit. Ctrl-C ends the wait for a slow disk, and the
            renderer stays usable. Otherwise draw at once with what is there, for interactive use; coarser clusters
            stand in for what is on its way, and `FrameStats.stream` says how much they are off.
        shadows : bool or str
            Whether what is in the way of lights casts shadows: True or ``"virtual"``, by virtual shadow maps, in
            which a texel is about a pixel and whose pages are kept while nothing in them changes. With
            ``"cascaded"`` those of directional lights are drawn anew for each frame instead, in four cascades that
            are fitted to the depths that it shows: to compare with. Lights, meshes and materials say whether they
            take part: ``casts_shadows``, `MeshNode.receives_shadows`. Edges are sharp but for lights with a size:
            `DirectionalLight.angle`, ``radius``. Environment and ambient light cast none. See the guide on shadows
            for how exact they are.
        shadow_memory : int
            Bytes of pages of shadow maps at most, 64 KiB each. Where a picture wants more, texels become twice as
            large until there is room, and ``Frame.stats.shadows.coarser`` says how often. Frames that are kept hold
            the pages that they show, beyond this.
        shadow_samples : int
            Rays from each pixel to a light with a size, 1 to 256: more are smoother. A pixel has the same in every
            frame.
        max_layers : int
            Blended surfaces that are composited at each pixel, 0 to 256, from the nearest on; what lies behind more
            is not seen, and ``Frame.stats.layers_left`` says at how many pixels. They are ordered by depth,
            whatever the order in which meshes were added, and blended in linear light. On the GPU backend the CPU
            draws such meshes over the device's picture, and shades it.
        transparent_ids : bool
            Depth, normals, ids and `Frame.motion` are those of the nearest surface, blended or not. By default they
            are those of what is opaque.
        motion : bool
            Take note of where everything is, and tell by `Frame.motion` how far each pixel moved since the last
            frame for which that was done.

        Warns
        -----
        UsageWarning
            If the picture shows nothing and no picture of this renderer did before, with what would help: as found
            by a few coarse frames with other poses and clip distances; or if the first that shows something is cut
            off by the near plane. And once if a pose mirrors, and if one is off a rotation by more than 0.0001.

        Returns
        -------
        Frame

        Raises
        ------
        ArgumentError
            For a pose that is not finite or not rigid, a threshold out of range, an unknown `raster`, `shading`,
            `transfer` or output, other `samples` than these, or several samples or an output besides depth with
            `depth_only`.
        BackendError
            If the device asked for cannot draw the frame: it was lost, it lacks what `raster` needs, or the scene
            or the picture does not fit.
        NaniteError
            If the renderer was closed.

        Examples
        --------
        >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
        >>> node = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000)))
        >>> pose = np.eye(4)
        >>> pose[2, 3] = 4.0
        >>> with nrs.Renderer(64, 64) as renderer:
        ...     plain, smooth = [
        ...         renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), pose, samples=n) for n in (1, 16)
        ...     ]
        >>> len(np.unique(plain.color)), len(np.unique(smooth.color)) > 10
        (2, True)
        >>> np.array_equal(plain.depth, smooth.depth)
        True
        """
        if not isinstance(scene, Scene):
            raise _no_scene(scene)
        if not isinstance(camera, Camera):
            raise DtypeError(
                f"camera: expected a camera of nanite_rs, not {type(camera).__name__}; give scene, camera, pose"
            )
        (frame,) = self._render(
            scene,
            [View(camera, pose)],
            _Options(
                pixel_error,
                occlusion,
                raster,
                outputs,
                depth_only,
                samples,
                shading,
                transfer,
                wait,
                shadows,
                shadow_memory,
                shadow_samples,
                max_layers,
                transparent_ids,
                motion,
            ),
        )
        return frame

    def render_views(
        self,
        scene: Scene,
        views: Iterable[View | tuple[Camera, ArrayLike]],
        *,
        pixel_error: float = 1.0,
        occlusion: bool = True,
        raster: RasterName = "auto",
        outputs: Sequence[OutputName] | None = None,
        depth_only: bool = False,
        samples: Literal[1, 4, 16] = 1,
        shading: ShadingName = "pyrender",
        transfer: TransferName = "gamma22",
        wait: bool = True,
        shadows: bool | ShadowsName = False,
        shadow_memory: int = SHADOW_BYTES,
        shadow_samples: int = SHADOW_SAMPLES,
        max_layers: int = 8,
        transparent_ids: bool = False,
        motion: bool = False,
    ) -> list[Frame]:
        """Render what several cameras see of a scene: on a GPU in one submission, on the CPU one after the other.

        A view starts from what the view of the same identity showed in an earlier call. By default that is the one
        at the same place, so keep their order from call to call, or give each a `View.id`.

        Parameters
        ----------
        scene : Scene
            What to draw.
        views : iterable of View or of pairs
            What each view has of its own, or a camera and its pose, as for `render`.
        pixel_error, occlusion, raster, outputs, depth_only, samples
            As for `render`, for all views that have none of their own.
        shading, transfer, wait, shadows, shadow_memory, shadow_samples, max_layers, transparent_ids, motion
            As for `render`, for all views. What moved is told of each view by its identity.

        Returns
        -------
        list of Frame
            One for each view, as `render` gives it. Their times are of all views together, and so are a GPU's
            times of stages.

        Raises
        ------
        ArgumentError, BackendError, NaniteError
            As `render` does; for a view, with its place in `views`. Also for two views of one identity.

        Examples
        --------
        >>> scene = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
        >>> node = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=20_000)))
        >>> poses = [np.eye(4), np.eye(4)]
        >>> poses[0][:3, 3], poses[1][:3, 3] = (-0.03, 0, 4), (0.03, 0, 4)
        >>> with nrs.Renderer(64, 64) as renderer:
        ...     left, right = renderer.render_views(scene, [(nrs.PerspectiveCamera(yfov=0.8), p) for p in poses])
        >>> bool((left.depth > 0).any() and (left.depth != right.depth).any())
        True
        """
        return self._render(
            scene,
            [_checked(view, i) for i, view in enumerate(views)],
            _Options(
                pixel_error,
                occlusion,
                raster,
                outputs,
                depth_only,
                samples,
                shading,
                transfer,
                wait,
                shadows,
                shadow_memory,
                shadow_samples,
                max_layers,
                transparent_ids,
                motion,
            ),
        )

    def render_batch(
        self,
        items: Iterable[tuple[Scene, Camera, ArrayLike]],
        *,
        outputs: Sequence[OutputName] = ("color", "depth"),
        out: Mapping[OutputName, NDArray[Any]] | None = None,
        pixel_error: float = 1.0,
        occlusion: bool = True,
        samples: Literal[1, 4, 16] = 1,
        shading: ShadingName = "pyrender",
        transfer: TransferName = "gamma22",
        shadows: bool | ShadowsName = False,
        shadow_memory: int = SHADOW_BYTES,
        shadow_samples: int = SHADOW_SAMPLES,
        max_layers: int = 8,
        transparent_ids: bool = False,
    ) -> dict[OutputName, NDArray[Any]]:
        """Render thousands of small pictures of many scenes into one array for each output.

        Each picture is the one that `render` makes, bit for bit. On the CPU threads draw pictures by themselves,
        which keeps all cores busy where single pictures are small; on a GPU all views of a scene that follow each
        other, up to 64, are one submission. Nothing is warned of.

        Parameters
        ----------
        items : iterable of tuples
            Scenes, cameras and poses, each as for `render`. Scenes may be shared; put items of one scene behind
            each other. All are taken before anything is drawn: what is moved in between is seen as it is last.
        outputs : sequence of str
            Which arrays, by the names that `render` knows.
        out : mapping of names to arrays, optional
            Arrays to fill, of the shape and dtype that would be returned; those of other outputs are made. NumPy's
            arrays speak DLPack: ``torch.from_dlpack(array)`` shares their memory.
        pixel_error, occlusion, samples, shading, transfer, shadows, shadow_memory, shadow_samples
            As for `render`, for all items.
        max_layers, transparent_ids
            As for `render`, for all items.

        Returns
        -------
        dict of str to array
            For each output (N, H, W, …): N pictures of the renderer's size.

        Raises
        ------
        ArgumentError, DtypeError, BackendError
            As `render` does; for an item, with its place in ``items``.

        Examples
        --------
        >>> ball = nrs.TriangleMesh(*nrs.shapes.icosphere(faces=500))
        >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
        >>> node = scene.add(ball)
        >>> camera = nrs.PerspectiveCamera(yfov=0.8)
        >>> with nrs.Renderer(64, 64) as renderer:
        ...     arrays = renderer.render_batch((scene, camera, pose) for pose in nrs.orbit(ball, 100, yfov=0.8))
        >>> arrays["color"].shape, arrays["depth"].dtype
        ((100, 64, 64, 3), dtype('float32'))
        """
        if self._core is None:
            raise NaniteError("the renderer was closed; make another: Renderer(width, height)")
        core, names = self._core, _names(outputs) or []
        settings = _Options(
            pixel_error,
            occlusion,
            "auto",
            outputs,
            False,
            samples,
            shading,
            transfer,
            True,
            shadows,
            shadow_memory,
            shadow_samples,
            max_layers,
            transparent_ids,
        ).raw()
        found = _batch.checked(items)

        def renderers() -> list[_core.Renderer]:
            threads = int(self._settings["threads"]) or _core.num_threads()
            if self.backend == "gpu" or self._settings["streaming"] or threads < 2 or len(found) < 3:
                return [core]
            return [_core.Renderer(*self._size, "cpu", None, 1) for _ in range(min(threads, len(found) - 1))]

        try:
            made = _batch.render(
                found, _batch.Arrays(len(found), names, out), settings, self.width * self.height, renderers
            )
        except ArgumentError as error:
            raise _advice.near(error) from None
        return made  # type: ignore[return-value]

    def _render(
        self,
        scene: Scene,
        views: list[View],
        options: _Options,
    ) -> list[Frame]:
        if self._core is None:
            raise NaniteError("the renderer was closed; make another: Renderer(width, height)")
        if not isinstance(scene, Scene):
            raise _no_scene(scene)
        for view in views:
            size = view.camera.size if isinstance(view.camera, IntrinsicsCamera) else None
            width, height = view.size or self._size
            if size is not None and size != (width, height):
                raise ArgumentError(
                    f"camera: it is of pictures of {size[0]} × {size[1]}, and this renderer makes {width} × "
                    f"{height}: scale its numbers, or make a Renderer of its size"
                )
        try:
            raw = options.raw()
            frames = self._core.render(
                scene._core,
                [_raw(view, i) for i, view in enumerate(views)],
                raw,
            )
        except ArgumentError as error:
            if str(error).startswith("pose"):
                raise _advice.advised(error, _advice.for_pose(views[0].pose)) from None
            if str(error).startswith("pool_bytes"):
                raise _advice.advised(error, "it counts bytes: 512 << 20 is 512 MiB") from None
            raise _advice.near(error) from None
        for fault in self._core.read_errors():
            _advice.warn(fault, StreamWarning)
        smaller = max((dict(frame.totals()[0])["reduced_images"] for frame in frames), default=0)
        if smaller > self._smaller:
            _advice.warn(
                f"the GPU has no room for all textures: {smaller} of the images lack their largest levels",
                TextureWarning,
            )
        self._smaller = smaller
        self._look_at_poses([view.pose for view in views])
        if self._blank and frames:
            self._look_at_first(frames, scene, views)
        self._backend = self._core.backend
        unlit = _unlit(scene, raw["shading"])

        def made(frame: _core.Frame, view: View) -> Frame:
            of_call = {name: raw[name] for name in ("pixel_error", "depth_only", "shading", "transfer")}
            own = {name: getattr(view, name) for name in ("pixel_error", "depth_only")}
            how = of_call | {name: value for name, value in own.items() if value is not None}
            how |= {"pose": np.asarray(view.pose, np.float64).tolist(), "backend": self.backend}
            asked_for = raw["outputs"] if view.outputs is None else _names(view.outputs)
            return Frame(frame, _lens(view.camera) | how, unlit, tuple(asked_for or ()))

        return [made(frame, view) for frame, view in zip(frames, views, strict=True)]

    def _look_at_first(self, frames: list[_core.Frame], scene: Scene, views: list[View]) -> None:
        """Warn where the first pictures show nothing; and where a mesh reaches the near distance, which cuts it."""
        camera, pose, size = views[0].camera, views[0].pose, views[0].size or self._size
        totals = [dict(frame.totals()[0]) for frame in frames]
        self._blank = not any(own["covered_pixels"] + own["layers"] for own in totals)
        if self._blank:
            reason = _unseen.reason(scene._core, camera, pose, size)
            if scene.instances:
                eye, middle = np.asarray(pose, np.float64)[:3, 3], scene.bounds.mean(axis=0)
                places = [", ".join(f"{x:.4g}" for x in place) for place in (eye, middle)]
                reason += f"; the camera is at ({places[0]}), the middle of the meshes at ({places[1]})"
            _advice.warn(f"the picture shows no mesh: {reason}", UsageWarning)
            return
        _, _, near, _ = camera._spec()
        depth = frames[0].depth()
        reaches = depth[depth > 0.0].min(initial=np.inf) < 1.02 * near
        if reaches and _unseen.cut_off(scene._core, camera, pose, size):
            _advice.warn(
                f"meshes are cut off at znear={near:g}, from which on they are drawn; give a smaller one",
                UsageWarning,
            )

    def _look_at_poses(self, poses: list[ArrayLike]) -> None:
        """Warn about the first pose that mirrors, and the first that is off a rotation, once each."""
        for i, pose in enumerate(poses):
            which = f"views[{i}]: " if len(poses) > 1 else ""
            if not self._mirrors and np.linalg.det(np.asarray(pose, np.float64)[:3, :3]) < 0.0:
                self._mirrors = True
                _advice.warn(f"{which}pose: it mirrors the picture: its determinant is below 0", UsageWarning)
            if not self._inexact and (note := _advice.of_rounded_pose(_core.check_pose(pose))):
                self._inexact = True
                _advice.warn(f"{which}{note}", UsageWarning)

    def close(self) -> None:
        """Give the memory back. Frames stay valid."""
        self._core = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the settings."""
        return _made, (self._size, self._settings)

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        closed = ", closed" if self._core is None else ""
        return f"<Renderer {self.width}×{self.height} on {self.backend}{closed}>"


def _checked(view: Any, place: int) -> View:
    """Return a view that may be given as a pair; an error says at which place."""
    pair = isinstance(view, tuple | list) and len(view) == 2
    of = View(*view) if pair else view
    if not (isinstance(of, View) and isinstance(of.camera, Camera)):
        raise DtypeError(f"views[{place}]: expected a View, or a camera and a pose, not {view!r}")
    if not (of.size is None or (isinstance(of.size, tuple | list) and len(of.size) == 2)):
        raise DtypeError(f"views[{place}]: size: expected a width and a height, not {of.size!r}")
    try:
        _core.check_pose(of.pose)
    except ArgumentError as error:
        raise ArgumentError(f"views[{place}]: {error}") from None
    return of


def _shadows(shadows: bool | str) -> str:
    """Return the name by which the core knows a kind of shadows."""
    if isinstance(shadows, bool | np.bool_):
        return "virtual" if shadows else "off"
    if not isinstance(shadows, str):
        raise DtypeError(f'shadows: expected a bool, "virtual" or "cascaded", not {type(shadows).__name__}')
    return shadows


def _names(outputs: Sequence[OutputName] | None) -> list[str] | None:
    """Return the names of arrays, of which one may be given by itself."""
    return [outputs] if isinstance(outputs, str) else None if outputs is None else list(outputs)


def _raw(view: View, place: int) -> _core._View:
    """Return what the core takes of a view."""
    which = f"views[{place}]: "
    size = None
    if view.size is not None:
        size = _pixels(view.size[0], f"{which}size"), _pixels(view.size[1], f"{which}size")
    number = place if view.id is None else _whole(view.id, f"{which}id", 1 << 63, "0 and 2^63 - 1")
    error = view.pixel_error
    if not (error is None or isinstance(error, int | float | np.integer | np.floating)):
        raise DtypeError(f"{which}pixel_error: expected a number, not {type(error).__name__}")
    return (
        view.camera._spec(),
        view.pose,
        number,
        size,
        None if error is None else float(error),
        _names(view.outputs),
        None if view.depth_only is None else bool(view.depth_only),
    )


def _made(size: tuple[int, int], settings: dict[str, Any]) -> Renderer:
    """Make a renderer with the settings of another."""
    return Renderer(*size, **settings)


def _unlit(scene: Scene, shading: str) -> str:
    """Say why the meshes are unlit, and what would light them; empty where they are lit."""
    if any(node.visible for node in scene.lights) or any(scene.ambient_light):
        return ""
    # What wants no light. Of very many the first will do.
    shown = islice(scene._shown.values(), 1000)
    looks = (
        shape.far._default_look() if isinstance(shape, Assembly) else look
        for shape, look in shown
        if isinstance(shape, Geometry | Assembly)
    )
    if all(one.unlit for look in looks for one in several(look, "material")):
        return ""
    if scene.environment is None:
        return (
            "the scene has no light; scene.add(nrs.DirectionalLight(intensity=3.0), pose=pose), "
            'scene.ambient_light = (1, 1, 1), or render(shading="flat")'
        )
    return "" if shading == "gltf" else 'the environment counts with render(shading="gltf") alone'


def _no_scene(found: object) -> DtypeError:
    error = DtypeError(f"scene: expected a Scene, not {_advice.name_of_type(found)}")
    return _advice.advised(error, _advice.for_item(found))


def _lens(camera: Camera) -> dict[str, Any]:
    """Kind and parameters of a camera; those that are not given are left out."""
    kind, _ = camera._parameters()
    return {"camera": kind, **{k: float(v) for k, v in vars(camera).items() if v is not None and k != "size"}}


def _whole(value: Any, name: str, end: int, allowed: str) -> int:
    """Return an integer that Rust can take, below ``end``; what is allowed is named in the error."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise DtypeError(f"{name}: expected an integer, not {type(value).__name__}")
    if not 0 <= value < end:
        raise ArgumentError(f"{name}: must be between {allowed}, not {value}")
    return int(value)


def _pixels(value: Any, name: str) -> int:
    return _whole(value, name, 1 << 32, "1 and 8192")
