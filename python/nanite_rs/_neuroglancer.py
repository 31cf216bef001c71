"""Multi-resolution meshes of neuroglancer's precomputed format: fragments of Draco, split at their octants.

After the format's specification, https://github.com/google/neuroglancer, ``datasource/precomputed/meshes.md``.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _advice, _checks, _core
from nanite_rs._images import beside
from nanite_rs._progress import reporter
from nanite_rs.exceptions import ArgumentError, FileError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from nanite_rs._geometry import Geometry
    from nanite_rs._progress import Progress

KIND: Final = "neuroglancer_multilod_draco"
# Sides of the box of all, at least, as part of the longest.
_FLAT: Final = 1e-3
# So that nothing lies on the upper planes of all.
_WIDER: Final = 1.0 + 2.0**-18


def write(
    mesh: Geometry,
    folder: str,
    segment: int,
    triangles: int,
    bits: int,
    unit: float,
    workers: int,
    progress: Progress,
) -> list[float]:
    """Write a segment; return the errors of its levels, finest first, with the rounding of positions."""
    try:
        import DracoPy
    except ImportError as error:
        raise _advice.missing("to_neuroglancer", "DracoPy") from error
    levels = _core.Tiles(mesh._core, triangles).levels
    lower, size = _box(mesh, unit)
    layout = [(allowed, k if allowed == 0.0 else k + 1) for k, allowed in enumerate(levels)]
    tiles = _core.Tiles.grid(mesh._core, [lower / unit, (lower + size) / unit], layout)
    level, corner, bound = tiles.level, tiles.lower * unit, tiles.error * unit
    fragments: list[dict[tuple[int, ...], list[int]]] = [{} for _ in levels]
    for number in range(len(tiles)):
        side = size / 2.0 ** int(level[number])
        # The middle of an octant is in its fragment.
        place = np.floor((corner[number] - lower + side * 2.0**-6) / side).astype(np.int64)
        fragments[level[number]].setdefault(tuple(place.tolist()), []).append(number)

    def encoded(task: tuple[int, tuple[int, ...], list[int]]) -> bytes:
        k, place, numbers = task
        side = size / 2.0**k
        points, faces, count = [], [], 0
        for number in numbers:
            piece = tiles.piece(number)
            points.append((piece.vertices * unit - lower - side * place) / side)
            faces.append(piece.faces + count)
            count += len(piece.vertices)
        steps = np.rint(np.concatenate(points) * (2**bits - 1)).clip(0, 2**bits - 1)
        return _draco(DracoPy, steps, np.concatenate(faces), bits)

    tasks = [
        (k, place, numbers)
        for k in range(len(levels))
        for place, numbers in sorted(fragments[k].items(), key=lambda row: _morton(row[0]))
    ]
    rows: list[list[tuple[tuple[int, ...], bytes]]] = [[] for _ in levels]
    with ThreadPoolExecutor(workers) as threads, reporter(progress, "writing") as report:
        for done, ((k, place, _), data) in enumerate(zip(tasks, threads.map(encoded, tasks), strict=True), 1):
            if data:
                rows[k].append((place, data))
            if report is not None:
                report(done, len(tasks))
    # Neuroglancer's first level is the finest.
    rows.reverse()
    count = len(levels)
    rounding = [0.87 * float((size / 2.0 ** (count - 1 - k)).max()) / (2**bits - 1) for k in range(count)]
    found = [float(bound[level == count - 1 - k].max(initial=0.0)) for k in range(count)]
    errors = [float(np.nextafter(a + b, np.inf)) for a, b in zip(found, rounding, strict=True)]
    manifest = _manifest(lower, size / 2.0 ** (count - 1), errors, rows)
    where = Path(folder)
    _info(where, bits)
    data = b"".join(own for lod in rows for _, own in lod)
    for name, content in ((str(segment), data), (f"{segment}.index", manifest)):
        with beside(str(where / name)) as temporary:
            Path(temporary).write_bytes(content)
    return errors


def _box(mesh: Geometry, unit: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lower corner and the sides of the box of all, as float32 has them."""
    low, high = mesh.bounds * unit
    longest = float((high - low).max())
    if not longest > 0.0:
        raise ArgumentError("to_neuroglancer: the mesh has no extent")
    least = np.nextafter(low.astype(np.float32), np.float32(-np.inf)).astype(np.float64)
    size = np.maximum(high - least, _FLAT * longest) * _WIDER
    return least, size.astype(np.float32).astype(np.float64)


def _draco(draco: Any, steps: NDArray[np.float64], faces: NDArray[np.integer[Any]], bits: int) -> bytes:
    """Encode whole numbers as Draco rounds them: to themselves."""
    if not len(faces):
        return b""
    points, where = np.unique(steps, axis=0, return_inverse=True)
    corners = where.reshape(-1)[faces]
    # What has become a line shows nothing.
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    if not len(corners):
        return b""
    data: bytes = draco.encode(
        points.astype(np.float32),
        corners.astype(np.uint32),
        quantization_bits=bits,
        quantization_range=2**bits - 1,
        quantization_origin=[0.0, 0.0, 0.0],
        compression_level=7,
    )
    return data


def _morton(place: tuple[int, ...]) -> int:
    """Return the place of a fragment along the Z curve."""
    return sum(
        ((value >> bit) & 1) << (3 * bit + axis) for axis, value in enumerate(place) for bit in range(21)
    )


def _manifest(
    lower: NDArray[np.float64],
    chunk: NDArray[np.float64],
    errors: Sequence[float],
    rows: Sequence[Sequence[tuple[tuple[int, ...], bytes]]],
) -> bytes:
    parts: list[NDArray[Any]] = [
        chunk.astype("<f4"),
        lower.astype("<f4"),
        np.array([len(rows)], "<u4"),
        np.maximum.accumulate(np.array(errors)).astype("<f4"),
        np.zeros((len(rows), 3), "<f4"),
        np.array([len(lod) for lod in rows], "<u4"),
    ]
    for lod in rows:
        places = np.array([place for place, _ in lod], "<u4").reshape(-1, 3)
        parts += [np.ascontiguousarray(places.T), np.array([len(data) for _, data in lod], "<u4")]
    return b"".join(part.tobytes() for part in parts)


def _info(folder: Path, bits: int) -> None:
    """Write what all segments of a folder have in common, or check it."""
    own: Mapping[str, Any] = {
        "@type": KIND,
        "vertex_quantization_bits": bits,
        "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
        "lod_scale_multiplier": 1,
    }
    path = folder / "info"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        known = json.loads(path.read_text()) if path.exists() else None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: {error}") from None
    if known is None:
        with beside(str(path)) as temporary:
            Path(temporary).write_text(json.dumps(own))
    elif known.get("@type") != KIND or known.get("vertex_quantization_bits") != bits:
        raise FileError(f"{path}: holds other meshes: {json.dumps(known)}")


def checked(segment: Any, triangles: Any, bits: Any, unit: Any, workers: Any) -> dict[str, Any]:
    """Check arguments."""
    if bits not in (10, 16):
        raise ArgumentError(f"quantization_bits: must be 10 or 16, not {bits!r}")
    factor = _checks.number(unit, "unit")
    if not factor > 0.0:
        raise ArgumentError(f"unit: must be positive, not {unit}")
    return {
        "segment": _checks.whole(segment, "segment", 0, (1 << 64) - 1),
        "triangles": _checks.whole(triangles, "triangles", 256, 1 << 24),
        "bits": int(bits),
        "unit": factor,
        "workers": _core.num_threads() if workers is None else _checks.whole(workers, "workers", 1, 256),
    }
