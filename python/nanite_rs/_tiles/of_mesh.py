"""The tiles of a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _checks, _core
from nanite_rs._asset import Notes
from nanite_rs._export_packing import Packing, image_format
from nanite_rs._progress import reporter
from nanite_rs._tiles import write
from nanite_rs._tiles.target import CONTENT, opened
from nanite_rs.exceptions import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nanite_rs._geometry import Geometry
    from nanite_rs._progress import Progress
    from nanite_rs.report import TilesReport

FEWEST: Final = 256
"""Triangles of a tile, at least."""


def how(
    triangles: int,
    compression: object,
    images: object,
    skirts: bool,
    pixel_error: float,
    preview: bool,
    workers: int | None,
) -> write.How:
    """Check how tiles are made."""
    pixels = _checks.number(pixel_error, "pixel_error")
    if not pixels > 0.0:
        raise ArgumentError(f"pixel_error: must be positive, not {pixel_error}")
    return write.How(
        triangles=_checks.whole(triangles, "triangles", FEWEST, 1 << 24),
        packing=Packing.of(compression, "glb"),
        images=image_format(images, "glb"),
        skirts=_checks.truth(skirts, "skirts"),
        pixel_error=pixels,
        preview=_checks.truth(preview, "preview"),
        workers=_core.num_threads() if workers is None else _checks.whole(workers, "workers", 1, 256),
    )


def export(
    mesh: Geometry,
    folder: object,
    how: write.How,
    up: object,
    crs: object,
    transform: object,
    options: Mapping[str, Any] | None,
    overwrite: bool,
    progress: Progress,
) -> TilesReport:
    """Write the tiles of a mesh."""
    place = write.place_of(up, crs)
    if crs is not None and transform is not None:
        raise ArgumentError("transform: a reference system says where the tiles are")
    pose = np.eye(4) if transform is None else np.asarray(transform, np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ArgumentError(f"transform: expected a (4, 4) matrix of finite numbers, found {pose.shape}")
    notes = Notes()
    with opened(folder, options, overwrite) as target, reporter(progress, "tiling") as report:
        writing = write.Writing(mesh._core, mesh._materials, place, how, target, f"{CONTENT}/", notes)
        made = writing.run(report)
        root, json = write.whole(made.roots), write.Json(target, crs is not None)
        json.write(json.row(root, pose), write.size_of(root))
        write.show(target, how)
        found = write.report(target, [made])
    notes.warn(found.path)
    return found
