"""Levels of detail as files: one of glTF with all of them (``MSFT_lod``), or a file for each."""

from __future__ import annotations

import math
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _checks, _export, _export_gltf
from nanite_rs._asset import Notes
from nanite_rs._export_packing import Grid, Packing, image_format
from nanite_rs._export_textures import fitted
from nanite_rs.exceptions import ArgumentError, DtypeError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from nanite_rs._export_parts import Surface
    from nanite_rs._geometry import Geometry
    from nanite_rs.cut import Cut

SCREEN: Final = (1920, 1080)
"""Pixels of the screen that coverages are of."""
YFOV: Final = math.pi / 3
"""Angle that it shows from its lower to its upper edge."""


def export(
    mesh: Geometry,
    path: str,
    levels: Iterable[float] | None,
    errors: Iterable[float] | None,
    separate: bool,
    pixel_error: float,
    fit_textures: bool,
    compression: object,
    images: object,
) -> list[str]:
    """Write cuts; return the paths of the files."""
    ending = _export.ending_of(path)
    packing, kind = Packing.of(compression, ending), image_format(images, ending)
    cuts = _cuts(mesh, levels, errors)
    if not pixel_error > 0.0:
        raise ArgumentError(f"pixel_error: must be positive, not {pixel_error}")
    notes = Notes()
    # A level begins where its error is so many pixels: there a unit is so long.
    surfaces: list[Surface] = [
        fitted(cut, pixel_error / cut.error) if fit_textures and k and cut.error > 0.0 else cut
        for k, cut in enumerate(cuts)
    ]
    if separate or len(cuts) == 1 or ending not in ("glb", "gltf"):
        if not separate and len(cuts) > 1:
            raise ArgumentError(f"export: .{ending} files hold one level; give separate=True")
        names = [path] if len(cuts) == 1 else [_name(path, k) for k in range(len(cuts))]
        for name, surface in zip(names, surfaces, strict=True):
            if ending in ("glb", "gltf"):
                single = _export_gltf.Document(notes, name, packing, kind)
                single.place(single.mesh(surface), np.eye(4))
                _export.write(single.files())
            else:
                _export.write(_export.files_of(surface, name, notes))
        notes.warn(path)
        return names
    document = _export_gltf.Document(notes, path, packing, kind)
    moved = 0.0 if packing is None else max(Grid.around(cut.vertices).moved for cut in cuts)
    bounds = [float(np.nextafter(cut.error + moved, np.inf)) if moved else cut.error for cut in cuts]
    extras: list[dict[str, Any]] = [
        {"error": bound, "triangles": len(cut)} for bound, cut in zip(bounds, cuts, strict=True)
    ]
    radius = 0.5 * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
    extras[0]["MSFT_screencoverage"] = coverages(bounds, radius, pixel_error)
    document.place_levels([document.mesh(surface) for surface in surfaces], extras)
    _export.write(document.files())
    notes.warn(path)
    return [path]


def coverages(errors: Sequence[float], radius: float, pixel_error: float) -> list[float]:
    """Return for each level the part of the screen, by area, from which on it is shown.

    Below it the next one is, whose error is at most ``pixel_error`` pixels then: a sphere around the mesh, of
    ``radius``, covers less of the screen, and its nearest point is so far away. The last one is always shown.
    """
    width, height = SCREEN
    focal = 0.5 * height / math.tan(0.5 * YFOV)
    out = []
    for error in list(accumulate(errors, max))[1:]:
        # The nearest point of the sphere, at distance d - r, shows an error of f e / (d - r) pixels.
        covered = focal * radius / (radius + focal * error / pixel_error) if radius > 0.0 else 0.0
        out.append(min(math.pi * covered**2 / (width * height) * (1.0 - 1e-12), 1.0))
    return [*out, 0.0]


def _cuts(mesh: Geometry, levels: Iterable[float] | None, errors: Iterable[float] | None) -> list[Cut]:
    if levels is not None and errors is not None:
        raise ArgumentError("export: expected levels or errors, found both")
    if levels is None and errors is None:
        return [mesh.cut(error=0.0)]
    name, given = ("levels", levels) if errors is None else ("errors", errors)
    if given is None or isinstance(given, str | bytes):
        raise DtypeError(f"{name}: expected numbers, not {given!r}")
    values = [_checks.number(value, name) for value in given]
    if not values:
        raise ArgumentError(f"{name}: there are none")
    for value in values:
        if errors is not None and not value >= 0.0:
            raise ArgumentError(f"errors: must be 0 or more, not {value}")
        if errors is None and not 0.0 < value <= 1.0:
            raise ArgumentError(f"levels: must be above 0 and at most 1, not {value}")
    if any(a >= b if errors is not None else a <= b for a, b in pairwise(values)):
        raise ArgumentError(f"{name}: the finest comes first, found {values}")
    if errors is not None:
        return [mesh.cut(error=value) for value in values]
    faces = len(mesh)
    return [
        mesh.cut(error=0.0)
        if value == 1.0
        else mesh.cut(target_faces=max(math.floor(value * faces + 1e-6), 1))
        for value in values
    ]


def _name(path: str, level: int) -> str:
    file: Any = Path(path)
    return str(file.with_name(f"{file.stem}_lod{level}{file.suffix}"))
