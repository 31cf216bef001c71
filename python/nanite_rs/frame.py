"""Frames: the arrays of a picture."""

from __future__ import annotations

import json
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _checks, _core, _images, _kept
from nanite_rs.exceptions import ArgumentError, FormatError, NaniteError, UsageWarning
from nanite_rs.stats import (
    AssemblyStats,
    FrameStats,
    ShadowCascade,
    ShadowStats,
    StageStats,
    StreamStats,
)

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from nanite_rs._checks import Color

__all__ = ["Frame"]

ViewName: TypeAlias = Literal[
    "shaded",
    "wireframe",
    "triangles",
    "clusters",
    "groups",
    "levels",
    "rasterizers",
    "overdraw",
    "shadow_pages",
    "shadow_levels",
    "shadow_kept",
    "shadow_cut",
]
OutputName: TypeAlias = Literal[
    "color",
    "linear",
    "depth",
    "normal",
    "instance_id",
    "cluster_id",
    "triangle_id",
    "overdraw",
    "triangles",
    "clusters",
    "groups",
    "levels",
    "base_color",
    "shading_normal",
    "orm",
    "emissive",
]

_CHANNELS: Final = {
    "linear": ("R", "G", "B"),
    "depth": ("Z",),
    "normal": ("N.x", "N.y", "N.z"),
    "instance_id": ("instance_id",),
    "cluster_id": ("cluster_id",),
    "triangle_id": ("triangle_id",),
    "overdraw": ("overdraw",),
    "base_color": ("base.R", "base.G", "base.B"),
    "shading_normal": ("shading.x", "shading.y", "shading.z"),
    "orm": ("occlusion", "roughness", "metallic"),
    "emissive": ("emissive.R", "emissive.G", "emissive.B"),
}
"""Channels of an EXR that hold an array of a frame."""

_DEEPEST: Final = 65_535
"""The most that 16 bits hold."""

_SAVED: Final = ("linear", "depth", "normal", "instance_id", "cluster_id", "triangle_id")
"""What an EXR holds unless asked for otherwise."""


class Frame(_advice.Teaching):
    """A rendered frame: arrays with row 0 on top, each made when first asked for unless rendered with the frame.

    All arrays are owned, contiguous and writable; each is made once and then kept. A frame does not follow later
    edits of the scene. One rendered with ``depth_only=True`` has `depth` and `stats`; all else raises
    `ArgumentError`. Pickled it keeps `color`, `rgba`, `depth`, `normal`, the ids, `stats`, what ``outputs=`` named,
    and what was looked at before; all else raises `ArgumentError` then.

    Examples
    --------
    >>> frame.color.shape, frame.color.dtype
    ((72, 128, 3), dtype('uint8'))
    >>> bool((frame.depth > 0).any())
    True
    """

    def __init__(
        self,
        core: _core.Frame | _kept.KeptFrame,
        made: dict[str, Any],
        unlit: str = "",
        asked_for: tuple[str, ...] = (),
    ) -> None:
        self._frame = core
        self._made = made
        self._unlit = unlit
        self._asked_for = asked_for

    @cached_property
    def color(self) -> NDArray[np.uint8]:
        """Shaded picture, (H, W, 3) uint8: `linear`, cut off at 1 and encoded by the frame's ``transfer``.

        The background is ``Scene.bg_color`` as it is, where all samples of a pixel show it.

        Warns
        -----
        UsageWarning
            Where most of what is seen is black since the scene had no light, or none that counts with the
            ``shading``.
        """
        color = self._frame.color()
        if self._unlit and (seen := self.depth > 0).any() and color[seen].any(axis=-1).mean() < 0.5:
            _advice.warn(f"meshes are black: {self._unlit}", UsageWarning)
        return color

    @cached_property
    def linear(self) -> NDArray[np.float32]:
        """Shaded picture before it is encoded, (H, W, 3) float32 in linear light, which may exceed 1.

        The mean of a pixel's samples. The background is what ``Scene.bg_color``, rounded to 8 bits, encodes. On a
        GPU values may differ from the CPU's by 0.1 %.

        Examples
        --------
        >>> frame.linear.dtype, np.array_equal(np.round(255 * frame.linear.clip(0, 1) ** (1 / 2.2)), frame.color)
        (dtype('float32'), True)
        """
        return self._frame.linear()

    @cached_property
    def shadow(self) -> NDArray[np.float32]:
        """How much of each light reaches each pixel past what is in its way, (H, W, L) float32, 0 to 1.

        The L lights are those of ``scene.lights`` that are switched on, in the order of their numbers. 1 where
        nothing is covered, and throughout for lights that cast no shadows. For shading of your own; `color` has it
        counted in.

        Raises
        ------
        ArgumentError
            If the frame was rendered without ``shadows``.

        Examples
        --------
        >>> scene = nrs.Scene()
        >>> ball = scene.add(nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2_000)))
        >>> sun = scene.add(nrs.DirectionalLight(intensity=3.0))
        >>> camera, pose = nrs.PerspectiveCamera(yfov=0.8), nrs.look_at((4, 0, 0), (0, 0, 0))
        >>> with nrs.Renderer(64, 64) as renderer:
        ...     shadow = renderer.render(scene, camera, pose, shadows=True).shadow
        >>> shadow.shape, [int(shadow[32, column, 0]) for column in (22, 42)]
        ((64, 64, 1), [1, 0])
        """
        return self._frame.shadow()

    @cached_property
    def rgba(self) -> NDArray[np.uint8]:
        """Shaded picture of the meshes alone, (H, W, 4) uint8, to be laid over another one.

        Colours are as in `color`, and not multiplied by alpha; alpha is the share of the pixel's samples that show
        a mesh: 0 or 255 unless rendered with several ``samples``. The background, be it a colour or an environment,
        is left out: where nothing is covered all four are 0.

        Examples
        --------
        >>> alpha = frame.rgba[..., 3]
        >>> np.array_equal(alpha == 255, frame.depth > 0)
        True
        """
        return self._frame.rgba()

    @cached_property
    def motion(self) -> NDArray[np.float32]:
        """How far each pixel has moved since the frame before, (H, W, 2) float32: pixels to the right and down.

        What the pixel shows was there, in the last frame of this renderer (of the same `View.id`) that was rendered
        with ``motion=True``: the camera may have moved, instances, and vertices by `TriangleMesh.update`,
        `SkinnedMesh.pose`, `SwayingMesh.move` or `Points.update`. Points of a triangle keep their place on it. Zero
        where nothing is covered, in a first frame and after one of another scene; what was not in the scene yet
        counts as if it had stood still; NaN for what was at the camera or behind it.

        Raises
        ------
        ArgumentError
            If the frame was rendered without ``motion``.

        Examples
        --------
        >>> scene = nrs.Scene(ambient_light=(1, 1, 1))
        >>> ball = scene.add(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=500)))
        >>> camera, pose = nrs.OrthographicCamera(2.0, 2.0), nrs.look_at((0, 0, 5), (0, 0, 0))
        >>> with nrs.Renderer(64, 64) as renderer:
        ...     before = renderer.render(scene, camera, pose, motion=True)
        ...     ball.pose = [[1, 0, 0, 0.25], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        ...     frame = renderer.render(scene, camera, pose, motion=True)
        >>> frame.motion[32, 32].tolist()
        [4.0, 0.0]
        """
        return self._frame.motion()

    @cached_property
    def base_color(self) -> NDArray[np.float32]:
        """Base colour of what each pixel shows, textures and, but for pyrender's shading, vertex colours included.

        (H, W, 3) float32, linear; zero where nothing is covered. With `shading_normal`, `orm`, `emissive` and
        `depth` all that light needs, for shading of your own.

        Examples
        --------
        >>> facing = frame.shading_normal @ np.array([0.0, 0.0, 1.0], np.float32)
        >>> unlit = frame.base_color * facing.clip(0, 1)[..., None]
        >>> unlit.shape == frame.linear.shape
        True
        """
        return self._frame.base_color()

    @cached_property
    def shading_normal(self) -> NDArray[np.float32]:
        """Unit normals as they are shaded, with those of textures, (H, W, 3) float32 in world space.

        Zero where nothing is covered. `normal` is without textures.
        """
        return self._frame.shading_normal()

    @cached_property
    def orm(self) -> NDArray[np.float32]:
        """Occlusion (1 for none), roughness and metallic, (H, W, 3) float32; zero where nothing is covered."""
        return self._frame.orm()

    @cached_property
    def emissive(self) -> NDArray[np.float32]:
        """Emitted light, (H, W, 3) float32, linear; zero where nothing is covered."""
        return self._frame.emissive()

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """Distance along the view axis, (H, W) float32 in world units; 0 where nothing is covered."""
        return self._frame.depth()

    @cached_property
    def normal(self) -> NDArray[np.float32]:
        """Unit surface normals in world space, (H, W, 3) float32; zero where nothing is covered."""
        return self._frame.normal()

    @cached_property
    def instance_id(self) -> NDArray[np.int32]:
        """``MeshNode.instance_id`` of what is shown, (H, W) int32; −1 where nothing is covered.

        All parts of an assembly have that of the instance of the assembly.
        """
        return self._frame.instance_id()

    @cached_property
    def cluster_id(self) -> NDArray[np.uint32]:
        """Address of the cluster inside its mesh, (H, W) uint32; 0xFFFFFFFF where nothing is covered.

        Of an assembly that is the mesh of a part, or the far mesh.
        """
        return self._frame.cluster_id()

    @cached_property
    def triangle_id(self) -> NDArray[np.int32]:
        """Number of the triangle inside its cluster, (H, W) int32; −1 where nothing is covered."""
        return self._frame.triangle_id()

    @cached_property
    def face_id(self) -> NDArray[np.int64]:
        """Row of the source ``faces``, of ``positions`` of `Points` or of ``segments`` of `Lines`, (H, W) int64.

        −1 where nothing is covered, where a level other than the source is shown (render with ``pixel_error=0``),
        and for meshes built without ``BuildOptions(face_ids=True)``.
        """
        return self._frame.face_id()

    @cached_property
    def overdraw(self) -> NDArray[np.uint32]:
        """Triangles that cover each pixel, hidden ones included, among the clusters drawn; (H, W) uint32.

        Counted by rasterizing them again.
        """
        return self._frame.overdraw()

    @cached_property
    def stats(self) -> FrameStats:
        """What the frame cost and skipped."""
        totals, total_ms, raster = self._frame.totals()
        stages = tuple(StageStats(*stage) for stage in self._frame.stages())
        stream = self._frame.stream()
        streamed = None
        if stream is not None:
            counts, coarsest, latency = stream
            streamed = StreamStats(**dict(counts), coarsest_pixels=coarsest, latency_ms=latency)
        found = self._frame.shadows()
        shadows = None
        if found is not None:
            counts, (mark, draw), cascades = found
            fitted = tuple(ShadowCascade(*cascade) for cascade in cascades)
            shadows = ShadowStats(**dict(counts), mark_ms=mark, draw_ms=draw, cascades=fitted)
        walk = self._frame.assemblies()
        assemblies = None if walk is None else AssemblyStats(**dict(walk[0]), ms=walk[1])
        return FrameStats(
            stages=stages,
            total_ms=total_ms,
            raster=raster,
            stream=streamed,
            shadows=shadows,
            assemblies=assemblies,
            **dict(totals),
        )

    @property
    def width(self) -> int:
        """Pixels in a row."""
        return self._frame.size[0]

    @property
    def height(self) -> int:
        """Rows."""
        return self._frame.size[1]

    def __copy__(self) -> Frame:
        """Return a frame with the same arrays."""
        return self._with(dict(vars(self)))

    def __deepcopy__(self, memo: dict[int, Any]) -> Frame:
        """Return a frame with arrays of its own; what they are made of does not change, and is shared."""
        own = {name: value.copy() for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        return self._with(vars(self) | own)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle color, depth, normal, the ids, the statistics, what was asked for and what was looked at."""
        depth_only = self._made["depth_only"]
        core = _kept.kept(self._frame, vars(self), self._asked_for, depth_only=depth_only)
        return Frame, (core, self._made, self._unlit, self._asked_for)

    def _with(self, state: dict[str, Any]) -> Frame:
        other = object.__new__(type(self))
        vars(other).update(state)
        return other

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The picture, `color`, for ``np.asarray(frame)`` and ``plt.imshow(frame)``."""
        return self.color.astype(dtype or np.uint8, copy=copy is not False)

    def __iter__(self) -> Iterator[Any]:
        raise TypeError("a frame is no tuple: frame.color and frame.depth are its pictures")

    def view(self, name: ViewName = "shaded", *, edges: bool | Color = False) -> NDArray[np.uint8]:
        """Return a picture, (H, W, 3) uint8.

        Parameters
        ----------
        name : str
            ``"shaded"`` (a copy of `color`), ``"wireframe"`` (edges of the triangles that are seen),
            ``"triangles"``, ``"clusters"`` or ``"groups"`` (a colour for each), ``"levels"`` (red is the finest
            level of detail, then towards blue), ``"rasterizers"`` (blue where the rasterizer of small triangles
            drew what is seen, orange where that of large ones did), or ``"overdraw"`` (blue once, red eight times
            or more). Of a frame with shadows, what pixels look up in the maps of the first light that casts any:
            ``"shadow_pages"`` (a colour for each), ``"shadow_levels"`` (red has the smallest texels),
            ``"shadow_kept"`` (green from a frame before, red drawn for this one) and ``"shadow_cut"`` (triangles
            of the light's cut that each page of 128 × 128 texels was drawn from: blue 16 or fewer, red 16,384 or
            more); grey where they look nothing up.
        edges : bool or three floats
            Draw the edges of the triangles that are seen over the picture, black or in a colour of 0 to 1, written
            as it is.

        Raises
        ------
        ArgumentError
            For another name, a frame of depth alone, or one without the shadows that are to be shown.

        Examples
        --------
        >>> picture = frame.view("levels", edges=True)
        >>> picture.shape == frame.color.shape
        True
        """
        if edges is False:
            return self.color.copy() if name == "shaded" else self._frame.view(name)
        color = (0.0, 0.0, 0.0) if edges is True else _checks.rgb(edges, "edges")
        for one in color:
            _checks.unit(one, "edges")
        red, green, blue = (round(255.0 * one) for one in color)
        return self._frame.view(name, (red, green, blue))

    @property
    def metadata(self) -> dict[str, Any]:
        """How the frame was made: what `save` writes beside it.

        ``software`` with its version; ``camera``, its kind, and its parameters by their names; ``pose``, the
        camera-to-world matrix as nested lists; ``pixel_error``, ``depth_only``, ``transfer``, ``backend``, and from
        `stats` ``raster``, ``samples``, ``source_triangles``, ``triangles`` and ``clusters``. Distances are in
        world units, angles in radians.

        Examples
        --------
        >>> frame.metadata["camera"], frame.metadata["yfov"], frame.metadata["pixel_error"]
        ('perspective', 0.8, 1.0)
        """
        counts = ("raster", "samples", "source_triangles", "triangles", "clusters")
        software = {"software": f"nanite_rs {_core.__version__}"}
        return software | self._made | {name: getattr(self.stats, name) for name in counts}

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        view: ViewName | None = None,
        outputs: Sequence[OutputName] | None = None,
        bits: Literal[8, 16] = 8,
        alpha: bool = False,
    ) -> None:
        """Write a picture as PNG, or arrays as EXR, with `metadata` beside them.

        A ``.png`` has 8 bits per channel, as `color` has, or 16, to which `linear` is encoded in the same way. An
        ``.exr`` holds arrays bit for bit. Its part ``geometry`` has float32 channels that compositing programs
        know: `linear` as ``R``, ``G`` and ``B``, `depth` as ``Z``, and `normal` as ``N.x``, ``N.y`` and ``N.z``.
        Its part ``ids`` has uint32 channels: ``instance_id``, ``cluster_id`` and ``triangle_id``, 0xFFFFFFFF where
        nothing is covered, and ``overdraw``.

        Either is written to the side and renamed, so that there is a whole file or none; a file that is overwritten
        keeps its mode, and a symbolic link goes on being one. Metadata are attributes of
        an EXR and texts of a PNG: ``Software``, and all else as ``nanite_rs:<key>``, numbers and lists as JSON.

        Parameters
        ----------
        path : path
            File to write, ``.png`` or ``.exr``; replaced if it exists. EXR takes OpenImageIO, which
            ``pip install OpenImageIO`` installs.
        view : str
            Which picture a PNG shows, see `view`; ``"shaded"`` by default.
        outputs : sequence of str
            Which arrays an EXR holds: of ``"linear"``, for which ``"color"`` stands too, ``"depth"``, ``"normal"``,
            ``"instance_id"``, ``"cluster_id"``, ``"triangle_id"`` and ``"overdraw"``. By default all but the last;
            of a frame of depth alone, depth.
        bits : int
            Of each channel of a PNG: 8, or 16 for the shaded picture, which takes OpenImageIO too.
        alpha : bool
            Leave out the background: a PNG is as `rgba`; an EXR has `linear` of the meshes alone, times alpha, and
            alpha as ``A``, as compositing programs expect it.

        Raises
        ------
        FormatError
            If the name ends otherwise.
        ArgumentError
            As for `view`; for an output that is unknown, or that the frame lacks; for `view` or `bits` of an EXR,
            `outputs` of a PNG, other `bits` than there are, or `alpha` of other views than the shaded one.
        FileError
            If the file cannot be written.
        DependencyError
            For an EXR or 16 bits without OpenImageIO.

        Examples
        --------
        >>> frame.save("clusters.png", view="clusters")
        >>> frame.save("frame.png", bits=16)
        >>> frame.save("cut-out.png", alpha=True)
        >>> frame.save("frame.exr", outputs=["linear", "depth"])
        """
        if bits not in (8, 16):
            raise ArgumentError(f"bits: must be 8 or 16, not {bits!r}")
        name = _checks.path_of(path)
        if _images.suffix(name) == ".png":
            if outputs is not None:
                raise ArgumentError("outputs: a .png holds one picture, see view; arrays take an .exr")
            shown: ViewName = "shaded" if view is None else view
            if alpha and shown != "shaded":
                raise ArgumentError(f"alpha: goes with the shaded picture, not with view={shown!r}")
            if bits == 8:
                _images.write_png(name, self.rgba if alpha else self.view(shown), self._texts())
            elif shown == "shaded":
                deep = self._frame.deep_rgba() if alpha else self._frame.deep_color()
                _images.write_deep_png(name, deep, self._texts())
            else:
                raise ArgumentError(f"bits: the view {shown!r} has 8, not 16")
        else:
            if view is not None:
                raise ArgumentError("view: an .exr holds arrays, see outputs; pictures take a .png")
            if bits != 8:
                raise ArgumentError("bits: an .exr holds arrays as they are; bits are of a .png")
            channels = self._channels(outputs)
            if alpha:
                if "R" not in channels:
                    raise ArgumentError('alpha: goes with outputs that have "linear"')
                layer = self._frame.layer()
                channels |= {channel: layer[..., k] for k, channel in enumerate("RGBA")}
            _images.write_exr(name, channels, self._texts())

    def save_depth(self, path: str | os.PathLike[str], *, unit: float = 0.001) -> None:
        """Write `depth` as a grey PNG of 16 bits: whole numbers of a unit, and 0 where nothing is covered.

        That is what depth cameras give and Open3D, ROS and most data sets read: of a scene in metres, the default
        is millimetres. Numbers are rounded to the nearest. `metadata` and ``depth_unit`` are beside them. An EXR
        keeps depth as it is: ``frame.save(path, outputs=["depth"])``.

        Parameters
        ----------
        path : path
            File to write, ``.png``; replaced as `save` does it.
        unit : float
            What 1 stands for, world units: depths up to 65,535 of it can be written.

        Raises
        ------
        FormatError
            If the name ends otherwise.
        ArgumentError, DtypeError
            If `unit` is not positive, or a depth does not fit: more than 65,535 of it, or so near that it would be
            rounded to 0. The message names a unit that would.
        FileError
            If the file cannot be written.

        Examples
        --------
        >>> frame.save_depth("depth.png")
        >>> from PIL import Image
        >>> millimetres = np.asarray(Image.open("depth.png"))
        >>> millimetres.dtype, bool(abs(millimetres / 1000 - frame.depth).max() <= 0.0005001)
        (dtype('uint16'), True)
        """
        unit = _checks.number(unit, "unit")
        if not 0.0 < unit < float("inf"):
            raise ArgumentError(f"unit: must be positive and finite, not {unit}")
        name = _checks.path_of(path)
        if _images.suffix(name) != ".png":
            raise FormatError(
                f'{name}: depth is saved as .png; frame.save(path, outputs=["depth"]) writes .exr'
            )
        steps = np.rint(self.depth.astype(np.float64) / unit)
        covered = self.depth[self.depth > 0.0].astype(np.float64)
        near, far = (covered.min(), covered.max()) if covered.size else (unit, unit)
        if steps.max(initial=0.0) > _DEEPEST or round(near / unit) < 1:
            raise ArgumentError(
                f"unit: depths from {near:.4g} to {far:.4g} do not fit; {_unit_for(near, far)}"
            )
        _images.write_png(name, steps.astype(np.uint16), self._texts() | {"nanite_rs:depth_unit": repr(unit)})

    def _texts(self) -> dict[str, str]:
        made = self.metadata
        texts = {k: v if isinstance(v, str) else json.dumps(v) for k, v in made.items()}
        return {"Software": texts.pop("software"), **{f"nanite_rs:{k}": v for k, v in texts.items()}}

    def _channels(self, outputs: Sequence[OutputName] | None) -> dict[str, NDArray[Any]]:
        """Arrays by the names of channels, integers as uint32."""
        names: list[str]
        if outputs is None:
            names = ["depth"] if self._made["depth_only"] else list(_SAVED)
        else:
            names = [outputs] if isinstance(outputs, str) else list(outputs)
            names = ["linear" if name == "color" else name for name in names]
        if not names:
            raise ArgumentError(f"outputs: expected one at least of {', '.join(_CHANNELS)}")
        channels: dict[str, NDArray[Any]] = {}
        for name in names:
            if name not in _CHANNELS:
                raise ArgumentError(f"outputs: an .exr holds {', '.join(_CHANNELS)}, not {name!r}")
            array: NDArray[Any] = getattr(self, name)
            if array.dtype.kind == "i":
                array = array.view(np.uint32)
            planes = array.reshape(*array.shape[:2], -1)
            channels |= {channel: planes[..., k] for k, channel in enumerate(_CHANNELS[name])}
        return channels

    def _repr_png_(self) -> bytes | None:
        """Return `color` for notebooks; None, so that they show the text, where there is none."""
        if self._made["depth_only"]:
            return None
        try:
            return _images.png(self.color)
        except NaniteError:  # the device was lost, with what it kept of the frame
            return None

    def __repr__(self) -> str:
        depth = " of depth alone" if self._made["depth_only"] else ""
        return f"<Frame {self.width}×{self.height}{depth}: {self.stats!r}>"


def _unit_for(near: float, far: float) -> str:
    """A unit in which depths fit into 16 bits: a power of ten where one does."""
    least = far / _DEEPEST
    unit = 10.0 ** np.ceil(np.log10(least) - 1e-9)
    if near / unit < 0.5:
        unit = least
    if near / unit < 0.5:
        return 'no unit has room for both: frame.save(path, outputs=["depth"]) writes an .exr'
    return f"they do with unit={unit:.6g}"
