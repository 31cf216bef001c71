"""The renderer and its frames."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from nanite_rs import _advice, _core, _images, _unseen
from nanite_rs._html import pairs, table
from nanite_rs.camera import Camera
from nanite_rs.exceptions import ArgumentError, DtypeError, NaniteError, UsageWarning
from nanite_rs.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Calibration",
    "Frame",
    "FrameStats",
    "Renderer",
    "StageStats",
    "StreamStats",
    "StreamWarning",
    "TextureWarning",
]

ViewName: TypeAlias = Literal[
    "shaded", "triangles", "clusters", "groups", "levels", "rasterizers", "overdraw"
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
POOL_BYTES = 512 << 20
"""Bytes of a renderer's pool with ``streaming=True``, unless asked for otherwise."""

RasterName: TypeAlias = Literal["auto", "compute", "hybrid", "hardware"]
TransferName: TypeAlias = Literal["gamma22", "srgb", "linear"]
ShadingName: TypeAlias = Literal["gltf", "pyrender", "flat", "normals"]

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

_SAVED: Final = ("linear", "depth", "normal", "instance_id", "cluster_id", "triangle_id")
"""What an EXR holds unless asked for otherwise."""


@dataclass(frozen=True)
class StageStats:
    """What one stage received, passed on, and took."""

    stage: str
    """Name of the stage."""
    pass_number: int
    """1, or 2 for what was put off until nearer surfaces were drawn, all such rounds together."""
    received: int
    """What came in, counted in `received_unit`."""
    received_unit: str
    passed: int
    """What went out, counted in `passed_unit`."""
    passed_unit: str
    ms: float
    """Milliseconds: wall time, or what a GPU's own clock says; NaN where it has none."""


class TextureWarning(UserWarning):
    """A GPU has no room for all textures: some are shown from smaller versions of their images."""


class StreamWarning(UserWarning):
    """Part of a streamed mesh cannot be read: it is shown with less detail."""


@dataclass(frozen=True)
class StreamStats:
    """What streaming did for a frame, see ``Renderer(streaming=True)``."""

    resident_pages: int
    """Pages that the frame could draw."""
    pool_bytes: int
    """Bytes of the pool in use, with those of pages that are being read."""
    needed_pages: int
    """Pages that the picture needs."""
    missing_pages: int
    """Of these, pages that were not there: coarser clusters stand in for theirs."""
    refused_pages: int
    """Of these, pages that the pool has no room for."""
    arrived_pages: int
    """Pages that arrived since the frame before."""
    evicted_pages: int
    """Pages that had to leave since the frame before."""
    faults: int
    """Pages that could not be read, since the renderer was made."""
    rounds: int
    """How often the frame was drawn until all was there."""
    coarsest_pixels: float
    """Largest error, pixels, of what stands in for something finer; 0 where nothing does. The picture keeps to
    this, or to its ``pixel_error``, whichever is larger."""

    @property
    def settled(self) -> bool:
        """Nothing is missing: the picture is that of the whole mesh."""
        return self.missing_pages == 0 and self.coarsest_pixels == 0.0

    def __str__(self) -> str:
        return (
            f"{self.resident_pages:,} pages in {self.pool_bytes / 2**20:.1f} MiB; {self.missing_pages:,} of "
            f"{self.needed_pages:,} needed are missing ({self.refused_pages:,} for lack of room), off by up to "
            f"{self.coarsest_pixels:.2f} pixels; {self.arrived_pages:,} arrived, {self.evicted_pages:,} left"
        )


@dataclass(frozen=True)
class FrameStats:
    """What a frame cost and skipped: ``print(stats)`` shows a table, ``stats["shade"]`` is one stage."""

    stages: tuple[StageStats, ...]
    """Every stage in the order in which it ran."""
    total_ms: float
    """Wall time of the frame, milliseconds."""
    raster: str
    """Which rasterizers drew: ``"compute"``, ``"hybrid"`` or ``"hardware"``."""
    source_triangles: int
    """Triangles of the instances on the screen, at full detail."""
    clusters: int
    """Clusters that were drawn."""
    triangles: int
    """Triangles of those clusters."""
    drawn_small: int
    """Of these, drawn by the rasterizer for small triangles: facing the eye and near a pixel centre."""
    drawn_large: int
    """The same for large and clipped triangles."""
    drawn_hardware: int
    """Of both, drawn by the GPU's own rasterizer: see `raster`."""
    covered_pixels: int
    """Pixels that show a surface."""
    occluded_instances: int
    """Instances that the depth pyramid hid."""
    occluded_clusters: int
    """Clusters that passed every other test, and that the depth pyramid hid."""
    uploaded_bytes: int
    """Bytes of instances that were written to a device, because they changed."""
    smaller_images: int
    """Images of textures that lack their largest levels on a GPU, which has no room for them."""
    samples: int
    """Samples of each pixel's colour. With several, `stages` are sums over all passes: one for each sample, and the
    one through pixel centres, of which all other numbers are."""
    stream: StreamStats | None = None
    """What streaming did; None where nothing is streamed."""

    def __getitem__(self, stage: str) -> StageStats:
        """Return a stage by name, both passes taken together."""
        found = [s for s in self.stages if s.stage == stage]
        if not found:
            raise KeyError(stage)
        first = found[0]
        received, passed = sum(s.received for s in found), sum(s.passed for s in found)
        ms = sum(s.ms for s in found)
        return StageStats(stage, 1, received, first.received_unit, passed, first.passed_unit, ms)

    def __iter__(self) -> Iterator[StageStats]:
        """Iterate over the stages in the order in which they ran."""
        return iter(self.stages)

    def as_dict(self) -> dict[str, float]:
        """Return the totals and, as ``<stage>_ms``, the time of each stage, for tables and data frames."""
        totals = {k: v for k, v in vars(self).items() if k not in {"stages", "raster", "stream"}}
        times: dict[str, float] = {}
        for s in self.stages:
            times[f"{s.stage}_ms"] = times.get(f"{s.stage}_ms", 0.0) + s.ms
        stream = {f"stream_{k}": v for k, v in vars(self.stream).items()} if self.stream else {}
        return totals | times | stream

    def __str__(self) -> str:
        lines = [f"{'stage':<14}{'received':>16}{'passed on':>16}   {'of':<28}{'ms':>9}"]
        for s in self.stages:
            name = s.stage if s.pass_number == 1 else f"{s.stage} (2)"
            unit = s.received_unit
            if s.passed_unit != unit:
                unit = f"{unit} → {s.passed_unit}"
            lines.append(f"{name:<18}{s.received:>12,}{s.passed:>16,}   {unit:<28}{s.ms:>9.2f}")
        lines.append(f"{'frame':<77}{self.total_ms:>9.2f}")
        drawn = self.drawn_small + self.drawn_large
        lines.append(
            f"{self.source_triangles:,} triangles in the source → {self.triangles:,} in {self.clusters:,} clusters"
            f" → {drawn:,} rasterized ({self.drawn_large:,} large; {self.raster}) → {self.covered_pixels:,} pixels"
        )
        if self.stream is not None:
            lines.append(str(self.stream))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        head = ("stage", "received", "of", "passed on", "of", "ms")
        rows = [
            (
                s.stage if s.pass_number == 1 else f"{s.stage} (2)",
                f"{s.received:,}",
                s.received_unit,
                f"{s.passed:,}",
                s.passed_unit,
                "–" if math.isnan(s.ms) else f"{s.ms:.2f}",
            )
            for s in self.stages
        ]
        rows.append(("frame", "", "", "", "", f"{self.total_ms:.2f}"))
        drawn = self.drawn_small + self.drawn_large
        totals = [
            ("in the source", f"{self.source_triangles:,} triangles"),
            ("in the cut", f"{self.triangles:,} triangles in {self.clusters:,} clusters"),
            ("rasterized", f"{drawn:,} triangles, {self.drawn_large:,} of them large; {self.raster}"),
            ("covered", f"{self.covered_pixels:,} pixels"),
            ("hidden", f"{self.occluded_instances:,} instances, {self.occluded_clusters:,} clusters"),
        ]
        if self.samples > 1:
            totals.append(("samples", f"{self.samples} of each pixel; stages are sums over all of them"))
        if self.stream is not None:
            totals.append(("streamed", str(self.stream)))
        return pairs(totals) + table(head, rows, text=(0, 2, 4))

    def __repr__(self) -> str:
        return (
            f"<FrameStats: {self.total_ms:.1f} ms, {self.source_triangles:,} source triangles, "
            f"{self.triangles:,} in the cut, {self.covered_pixels:,} pixels>"
        )


@dataclass(frozen=True)
class Calibration:
    """Which rasterizers of a device are the fastest, by a short measurement."""

    raster: str
    """What ``raster="auto"`` takes: ``"compute"``, ``"hybrid"`` or ``"hardware"``."""
    reason: str
    """Why."""
    times_ms: dict[str, float]
    """Milliseconds that each form takes for 512 clusters of small triangles and 512 of large ones. Absent are those
    that the device lacks, and those whose pixels were not exactly those of ``"compute"``."""


class Frame(_advice.Teaching):
    """A rendered frame: arrays with row 0 on top, each made when first asked for unless rendered with the frame.

    All arrays are owned, contiguous and writable; each is made once and then kept. A frame does not follow later
    edits of the scene. One rendered with ``depth_only=True`` has `depth` and `stats`; all else raises
    `ArgumentError`.

    Examples
    --------
    >>> frame.color.shape, frame.color.dtype
    ((72, 128, 3), dtype('uint8'))
    >>> bool((frame.depth > 0).any())
    True
    """

    def __init__(self, core: _core.Frame, made: dict[str, Any], unlit: str = "") -> None:
        self._frame = core
        self._made = made
        self._unlit = unlit

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
        """Light given off, (H, W, 3) float32, linear; zero where nothing is covered."""
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
        """``MeshNode.instance_id`` of what is shown, (H, W) int32; −1 where nothing is covered."""
        return self._frame.instance_id()

    @cached_property
    def cluster_id(self) -> NDArray[np.uint32]:
        """Address of the cluster inside its mesh, (H, W) uint32; 0xFFFFFFFF where nothing is covered."""
        return self._frame.cluster_id()

    @cached_property
    def triangle_id(self) -> NDArray[np.int32]:
        """Number of the triangle inside its cluster, (H, W) int32; −1 where nothing is covered."""
        return self._frame.triangle_id()

    @cached_property
    def face_id(self) -> NDArray[np.int64]:
        """Row of the source ``faces``, (H, W) int64.

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
        streamed = None if stream is None else StreamStats(**dict(stream[0]), coarsest_pixels=stream[1])
        return FrameStats(stages=stages, total_ms=total_ms, raster=raster, stream=streamed, **dict(totals))

    @property
    def width(self) -> int:
        """Pixels in a row."""
        return self._frame.size[0]

    @property
    def height(self) -> int:
        """Rows."""
        return self._frame.size[1]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """The picture, `color`, for ``np.asarray(frame)`` and ``plt.imshow(frame)``."""
        return self.color.astype(dtype or np.uint8, copy=copy is not False)

    def __iter__(self) -> Iterator[Any]:
        raise TypeError("a frame is no tuple: frame.color and frame.depth are its pictures")

    def view(self, name: ViewName = "shaded") -> NDArray[np.uint8]:
        """Return a picture, (H, W, 3) uint8.

        Parameters
        ----------
        name : str
            ``"shaded"`` (a copy of `color`), ``"triangles"``, ``"clusters"`` or ``"groups"`` (a colour for each),
            ``"levels"`` (red is the finest level of detail, then towards blue), ``"rasterizers"`` (blue where the
            rasterizer of small triangles drew what is seen, orange where that of large ones did), or ``"overdraw"``
            (blue once, red eight times or more).

        Raises
        ------
        ArgumentError
            For another name, or a frame of depth alone.
        """
        if name == "shaded":
            return self.color.copy()
        return self._frame.view(name)

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
    ) -> None:
        """Write a picture as PNG, or arrays as EXR, with `metadata` beside them.

        A ``.png`` has 8 bits per channel, as `color` has, or 16, to which `linear` is encoded in the same way. An
        ``.exr`` holds arrays bit for bit. Its part ``geometry`` has float32 channels that compositing programs
        know: `linear` as ``R``, ``G`` and ``B``, `depth` as ``Z``, and `normal` as ``N.x``, ``N.y`` and ``N.z``.
        Its part ``ids`` has uint32 channels: ``instance_id``, ``cluster_id`` and ``triangle_id``, 0xFFFFFFFF where
        nothing is covered, and ``overdraw``.

        Either is written to the side and renamed, so that there is a whole file or none. Metadata are attributes of
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

        Raises
        ------
        FormatError
            If the name ends otherwise.
        ArgumentError
            As for `view`; for an output that is unknown, or that the frame lacks; for `view` or `bits` of an EXR,
            `outputs` of a PNG, or other `bits` than there are.
        FileError
            If the file cannot be written.
        DependencyError
            For an EXR or 16 bits without OpenImageIO.

        Examples
        --------
        >>> frame.save("clusters.png", view="clusters")
        >>> frame.save("frame.png", bits=16)
        >>> frame.save("frame.exr", outputs=["linear", "depth"])
        """
        if bits not in (8, 16):
            raise ArgumentError(f"bits: must be 8 or 16, not {bits!r}")
        name = os.fsdecode(path)
        if _images.suffix(name) == ".png":
            if outputs is not None:
                raise ArgumentError("outputs: a .png holds one picture, see view; arrays take an .exr")
            shown: ViewName = "shaded" if view is None else view
            if bits == 8:
                _images.write_png(name, self.view(shown), self._texts())
            elif shown == "shaded":
                _images.write_deep_png(name, self._frame.deep_color(), self._texts())
            else:
                raise ArgumentError(f"bits: the view {shown!r} has 8, not 16")
        else:
            if view is not None:
                raise ArgumentError("view: an .exr holds arrays, see outputs; pictures take a .png")
            if bits != 8:
                raise ArgumentError("bits: an .exr holds arrays as they are; bits are of a .png")
            _images.write_exr(name, self._channels(outputs), self._texts())

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


class Renderer(_advice.Teaching):
    """Renders scenes into pictures of one size.

    Memory is kept between frames; use it in a ``with`` block, or call `close`, to give it back at once.

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
    ) -> None:
        self._size = _pixels(width, "width"), _pixels(height, "height")
        pool = _whole(pool_bytes, "pool_bytes", 1 << 63, "0 and 2^63")
        if not isinstance(backend, str):
            raise DtypeError(f'backend: expected "auto", "cpu" or "gpu", not {backend!r}')
        if not streaming and pool != POOL_BYTES:
            _advice.warn("pool_bytes: counts with streaming=True alone", UsageWarning)
        try:
            core = _core.Renderer(*self._size, backend, pool if streaming else None)
        except ArgumentError as error:
            raise _advice.near(error) from None
        self._core: _core.Renderer | None = core
        # Until a picture shows something, one that shows nothing is looked into.
        self._blank = True
        # Whether a pose was found to mirror: said once.
        self._mirrors = False
        self._backend = self._core.backend
        # Images that the last frame showed smaller than they are.
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
        """How ``raster="auto"`` was decided on the device; None on the CPU, and before it had to be."""
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
    ) -> Frame:
        """Render a frame.

        Parameters
        ----------
        scene : Scene
            What to draw.
        camera : PerspectiveCamera, IntrinsicsCamera or OrthographicCamera
            How to project it.
        pose : (4, 4) array
            Camera-to-world matrix: a rotation and a translation. The camera looks along its −Z, +Y is up.
        pixel_error : float
            Threshold of the cut: the error of no cluster projects above so many pixels. 0 is full detail.
        occlusion : bool
            Skip what nearer surfaces hide, where that pays. The picture is the same bit for bit. The GPU backend
            starts from what the frame before hid, and a first frame from its nearest instances.
        raster : str
            What draws triangles on a GPU: ``"compute"`` shaders, whose pictures are those of the CPU;
            ``"hardware"``, the device's own rasterizer, for all that need not be clipped; ``"hybrid"``, shaders
            for small triangles and the device's rasterizer for large ones; or ``"auto"``, the fastest of these,
            see `calibration`. All cover the same pixels, which ``"auto"`` makes sure of on the device; ties in
            depth and the last bits of depths may differ. The CPU has one form, ``"compute"``.
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

        Warns
        -----
        UsageWarning
            If the picture shows nothing and no picture of this renderer did before, with what would help: as found
            by a few coarse frames with other poses and clip distances; or if the first that shows something is cut
            off by the near plane. And once if a pose mirrors.

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
            [(camera, pose)],
            pixel_error,
            occlusion,
            raster,
            outputs,
            depth_only,
            samples,
            shading,
            transfer,
            wait,
        )
        return frame

    def render_views(
        self,
        scene: Scene,
        views: Iterable[tuple[Camera, ArrayLike]],
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
    ) -> list[Frame]:
        """Render what several cameras see of a scene: on a GPU in one submission, on the CPU one after the other.

        A view finds what the view at the same place of the call before hid, so keep their order from call to call.

        Parameters
        ----------
        scene : Scene
            What to draw.
        views : iterable of pairs
            A camera and its pose each, as for `render`.
        pixel_error, occlusion, raster, outputs, depth_only, samples, shading, transfer, wait
            As for `render`, for all views.

        Returns
        -------
        list of Frame
            One for each view, as `render` gives it. Their times are of all views together, and so are a GPU's
            times of stages.

        Raises
        ------
        ArgumentError, BackendError, NaniteError
            As `render` does; for a view, with its place in `views`.

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
        checked: list[tuple[Camera, ArrayLike]] = []
        for i, view in enumerate(views):
            if not (isinstance(view, tuple | list) and len(view) == 2 and isinstance(view[0], Camera)):
                raise DtypeError(f"views[{i}]: expected a camera and a pose, not {view!r}")
            try:
                _core.check_pose(view[1])
            except ArgumentError as error:
                raise ArgumentError(f"views[{i}]: {error}") from None
            checked.append((view[0], view[1]))
        return self._render(
            scene,
            checked,
            pixel_error,
            occlusion,
            raster,
            outputs,
            depth_only,
            samples,
            shading,
            transfer,
            wait,
        )

    def _render(
        self,
        scene: Scene,
        views: list[tuple[Camera, ArrayLike]],
        pixel_error: float,
        occlusion: bool,
        raster: RasterName,
        outputs: Sequence[OutputName] | None,
        depth_only: bool,
        samples: int,
        shading: ShadingName,
        transfer: TransferName,
        wait: bool,
    ) -> list[Frame]:
        if self._core is None:
            raise NaniteError("the renderer was closed; make another: Renderer(width, height)")
        if not isinstance(scene, Scene):
            raise _no_scene(scene)
        if not isinstance(pixel_error, int | float | np.integer | np.floating):
            raise DtypeError(f"pixel_error: expected a number, not {type(pixel_error).__name__}")
        try:
            frames = self._core.render(
                scene._core,
                [(camera._spec(), pose) for camera, pose in views],
                pixel_error=float(pixel_error),
                occlusion=bool(occlusion),
                raster=str(raster),
                outputs=[outputs] if isinstance(outputs, str) else None if outputs is None else list(outputs),
                depth_only=bool(depth_only),
                samples=_whole(samples, "samples", 1 << 32, "1 and 16"),
                shading=str(shading),
                transfer=str(transfer),
                wait=bool(wait),
            )
        except ArgumentError as error:
            if str(error).startswith("pose"):
                raise _advice.advised(error, _advice.for_pose(views[0][1])) from None
            if str(error).startswith("pool_bytes"):
                raise _advice.advised(error, "it counts bytes: 512 << 20 is 512 MiB") from None
            raise _advice.near(error) from None
        for fault in self._core.faults():
            _advice.warn(fault, StreamWarning)
        smaller = max((dict(frame.totals()[0])["smaller_images"] for frame in frames), default=0)
        if smaller > self._smaller:
            _advice.warn(
                f"the GPU has no room for all textures: {smaller} of the images lack their largest levels",
                TextureWarning,
            )
        self._smaller = smaller
        if not self._mirrors:
            self._look_for_mirrors([pose for _, pose in views])
        if self._blank and frames:
            self._look_at_first(frames, scene, views)
        self._backend = self._core.backend
        made = {
            "pixel_error": float(pixel_error),
            "depth_only": bool(depth_only),
            "shading": str(shading),
            "transfer": str(transfer),
            "backend": self.backend,
        }
        unlit = _unlit(scene, str(shading))
        return [
            Frame(frame, _lens(camera) | {"pose": np.asarray(pose, np.float64).tolist()} | made, unlit)
            for frame, (camera, pose) in zip(frames, views, strict=True)
        ]

    def _look_at_first(
        self, frames: list[_core.Frame], scene: Scene, views: list[tuple[Camera, ArrayLike]]
    ) -> None:
        """Warn where the first pictures show nothing; and where a mesh reaches the near distance, which cuts it."""
        camera, pose = views[0]
        self._blank = not any(dict(frame.totals()[0])["covered_pixels"] for frame in frames)
        if self._blank:
            reason = _unseen.reason(scene._core, camera, pose, self._size)
            if scene.instances:
                eye, middle = np.asarray(pose, np.float64)[:3, 3], scene.bounds.mean(axis=0)
                places = [", ".join(f"{x:.4g}" for x in place) for place in (eye, middle)]
                reason += f"; the camera is at ({places[0]}), the middle of the meshes at ({places[1]})"
            _advice.warn(f"the picture shows no mesh: {reason}", UsageWarning)
            return
        _, _, near, _ = camera._spec()
        depth = frames[0].depth()
        reaches = depth[depth > 0.0].min(initial=np.inf) < 1.02 * near
        if reaches and _unseen.cut_off(scene._core, camera, pose, self._size):
            _advice.warn(
                f"meshes are cut off at znear={near:g}, from which on they are drawn; give a smaller one",
                UsageWarning,
            )

    def _look_for_mirrors(self, poses: list[ArrayLike]) -> None:
        """Warn about the first pose that mirrors, once."""
        for i, pose in enumerate(poses):
            if np.linalg.det(np.asarray(pose, np.float64)[:3, :3]) < 0.0:
                self._mirrors = True
                which = f"views[{i}]: " if len(poses) > 1 else ""
                _advice.warn(f"{which}pose: it mirrors the picture: its determinant is below 0", UsageWarning)
                return

    def close(self) -> None:
        """Give the memory back. Frames stay valid."""
        self._core = None

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


def _unlit(scene: Scene, shading: str) -> str:
    """Say why nothing lights the meshes, and what would; empty where something does."""
    if scene._core.light_count or any(scene.ambient_light):
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
    return {"camera": kind, **{k: float(v) for k, v in vars(camera).items() if v is not None}}


def _whole(value: Any, name: str, end: int, allowed: str) -> int:
    """Return an integer that Rust can take, below ``end``; what is allowed is named in the error."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise DtypeError(f"{name}: expected an integer, not {type(value).__name__}")
    if not 0 <= value < end:
        raise ArgumentError(f"{name}: must be between {allowed}, not {value}")
    return int(value)


def _pixels(value: Any, name: str) -> int:
    return _whole(value, name, 1 << 32, "1 and 8192")
