"""Statistics of frames: counts, and times of stages."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from nanite_rs._notebook import pairs, table

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["AssemblyStats", "FrameStats", "ShadowStats", "StageStats", "StreamStats", "TrafficStats"]


@dataclass(frozen=True)
class StageStats:
    """What one stage received, passed on, and took."""

    stage: str
    """Name of the stage."""
    pass_number: int
    """The pass: 1, or 2 for what was deferred until nearer surfaces were drawn."""
    received: int
    """What came in, counted in `received_unit`."""
    received_unit: str
    passed: int
    """What went out, counted in `passed_unit`."""
    passed_unit: str
    ms: float
    """Milliseconds: wall time, or what a GPU's own clock says; NaN where it has none."""


@dataclass(frozen=True)
class TrafficStats:
    """What reading a file that is not on a local disk has cost, see `NaniteMesh.traffic`."""

    requests: int
    """Requests so far."""
    failed_requests: int
    """Of these, requests that failed. What may pass is asked for again."""
    read_bytes: int
    """Bytes that the others brought."""
    joined_bytes: int
    """Of these, bytes between pages that were read by one request."""
    cached_bytes: int
    """Bytes that the cache on disk had."""
    latency_ms: float
    """Mean time from a request to its last byte, milliseconds."""

    def __str__(self) -> str:
        failed = f" ({self.failed_requests:,} failed)" if self.failed_requests else ""
        return (
            f"{self.requests:,} requests{failed} of {self.latency_ms:.0f} ms brought "
            f"{self.read_bytes / 1e6:,.1f} MB, {self.joined_bytes / 1e6:,.1f} MB of them between pages; "
            f"{self.cached_bytes / 1e6:,.1f} MB were cached"
        )


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
    read_errors: int
    """Pages that could not be read, since the renderer was made. One that still cannot be is not counted again."""
    draws: int
    """How often the frame was drawn until all was there."""
    coarsest_pixels: float
    """Largest error, pixels, of what stands in for something finer; 0 where nothing does. The picture keeps to
    this, or to its ``pixel_error``, whichever is larger."""
    requests: int = 0
    """Requests since the frame before, of meshes that were opened by a URL or of a file object, whoever read them.
    The numbers below are of the same."""
    failed_requests: int = 0
    """Of these, requests that failed. What may pass is asked for again."""
    read_bytes: int = 0
    """Bytes that the others brought."""
    joined_bytes: int = 0
    """Of these, bytes between pages that were read by one request."""
    cached_bytes: int = 0
    """Bytes that the cache on disk had."""
    latency_ms: float = 0.0
    """Mean time from a request to its last byte, milliseconds; 0 without requests."""

    @property
    def settled(self) -> bool:
        """Nothing is missing: the picture is that of the whole mesh."""
        return self.missing_pages == 0 and self.coarsest_pixels == 0.0

    def __str__(self) -> str:
        counts = {f.name: getattr(self, f.name) for f in fields(TrafficStats)}
        traffic = str(TrafficStats(**counts)) if self.requests or self.cached_bytes else ""
        return (
            f"{self.resident_pages:,} pages in {self.pool_bytes / 2**20:.1f} MiB; {self.missing_pages:,} of "
            f"{self.needed_pages:,} needed are missing ({self.refused_pages:,} for lack of room), off by up to "
            f"{self.coarsest_pixels:.2f} pixels; {self.arrived_pages:,} arrived, {self.evicted_pages:,} left"
            + (f"; {traffic}" if traffic else "")
        )


@dataclass(frozen=True)
class ShadowCascade:
    """A cascade of a directional light, see ``render(shadows="cascaded")``."""

    light: int
    """Which of the lights that are switched on."""
    begin: float
    """Distance from the camera at which it begins."""
    end: float
    """Distance at which it ends; infinite of the last."""
    texel: float
    """Side of a texel, world units: a power of two."""


@dataclass(frozen=True)
class ShadowStats:
    """What shadows cost, see ``render(shadows=True)``: of all views of a call together.

    A page is 128 × 128 texels of a light's shadow map, 64 KiB.
    """

    wanted_pages: int
    """Pages that the pictures look up."""
    drawn_pages: int
    """Of these, pages that were not there and were drawn; the others are from frames before."""
    invalidated_pages: int
    """Pages that were dropped because something in them changed."""
    evicted_pages: int
    """Pages that were dropped for lack of room."""
    kept_pages: int
    """Pages that are kept for the next frame."""
    clusters: int
    """Clusters that were drawn; one that touches several pages counts for each."""
    triangles: int
    """Triangles of those clusters."""
    culled_instances: int
    """Of cascades: instances that were left out since they cast nothing on what is seen, or since others hide them
    from the light. One that touches several cascades counts for each."""
    culled_clusters: int
    """Clusters of other instances that were left out: those that other casters hide from the light, once for each
    page; of cascades also those that cast nothing on what is seen."""
    coarser: int
    """How often texels were made twice as large, for lack of room."""
    mark_ms: float
    """Finding what pixels look up, milliseconds."""
    draw_ms: float
    """Drawing pages, milliseconds."""
    cascades: tuple[ShadowCascade, ...] = ()
    """Those of this frame that show something, light by light, from near to far."""

    def __str__(self) -> str:
        coarser = f", texels {2**self.coarser} times as large" if self.coarser else ""
        if self.cascades:
            culled = f"{self.culled_instances:,} instances and {self.culled_clusters:,} clusters"
            coarser += f"; {len(self.cascades)} cascades, {culled} left out"
        return (
            f"{self.wanted_pages:,} pages wanted, {self.drawn_pages:,} of them drawn ({self.triangles:,} triangles "
            f"in {self.clusters:,} clusters), {self.kept_pages:,} kept{coarser}; {self.mark_ms:.2f} ms to mark "
            f"them, {self.draw_ms:.2f} to draw"
        )


@dataclass(frozen=True)
class AssemblyStats:
    """What became of the instances of an `Assembly`: of all views of a call together."""

    walked: int
    """Assemblies that were looked at: instances of the scene, and those inside of others that were expanded."""
    outside: int
    """Those that no view sees, or that are hidden."""
    far: int
    """Those that were drawn as one mesh."""
    expanded: int
    """Those that were drawn by their parts."""
    parts: int
    """Instances of meshes that these gave to the stages."""
    changed: int
    """Of these, those that the frame before did not have in the same place; making them is most of the time."""
    ms: float
    """Time of all that, milliseconds."""

    def __str__(self) -> str:
        return (
            f"{self.walked:,} assemblies: {self.outside:,} outside, {self.far:,} as one mesh, {self.expanded:,} "
            f"expanded to {self.parts:,} parts ({self.changed:,} of them new); {self.ms:.2f} ms"
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
    uploaded_mesh_bytes: int
    """Bytes of meshes that were written to a device: all of those that are new, and of those that moved where their
    vertices are now."""
    reduced_images: int
    """Images of textures that lack their largest levels on a GPU, which has no room for them."""
    layers: int
    """Layers of blended surfaces that were composited."""
    layers_left: int
    """Pixels where more of them lie behind the last layer, which are not seen: see ``max_layers``."""
    samples: int
    """Samples of each pixel's colour. With several, `stages` are sums over all passes: one for each sample, and the
    one through pixel centres, of which all other numbers are."""
    stream: StreamStats | None = None
    """What streaming did; None where nothing is streamed."""
    shadows: ShadowStats | None = None
    """What shadows cost; None without."""
    assemblies: AssemblyStats | None = None
    """What became of assemblies; None where the scene has none."""

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
        apart = {"stages", "raster", "stream", "shadows", "assemblies"}
        totals = {k: v for k, v in vars(self).items() if k not in apart}
        times: dict[str, float] = {}
        for s in self.stages:
            times[f"{s.stage}_ms"] = times.get(f"{s.stage}_ms", 0.0) + s.ms
        stream = {f"stream_{k}": v for k, v in vars(self.stream).items()} if self.stream else {}
        numbers = {k: v for k, v in vars(self.shadows).items() if k != "cascades"} if self.shadows else {}
        walk = {f"assemblies_{k}": v for k, v in vars(self.assemblies).items()} if self.assemblies else {}
        return totals | times | stream | {f"shadow_{k}": v for k, v in numbers.items()} | walk

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
        if self.shadows is not None:
            lines.append(str(self.shadows))
        if self.assemblies is not None:
            lines.append(str(self.assemblies))
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
        if self.shadows is not None:
            totals.append(("shadows", str(self.shadows)))
        if self.assemblies is not None:
            totals.append(("assemblies", str(self.assemblies)))
        return pairs(totals) + table(head, rows, text=(0, 2, 4))

    def __repr__(self) -> str:
        return (
            f"<FrameStats: {self.total_ms:.1f} ms, {self.source_triangles:,} source triangles, "
            f"{self.triangles:,} in the cut, {self.covered_pixels:,} pixels>"
        )
