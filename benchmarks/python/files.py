"""One surface as a ``.nanite`` file and by the codecs of glTF, Draco and meshoptimizer: bytes, and decoding.

All hold the same triangles over the same vertices on the same grid, that of ``precision="auto"`` (a sixteenth of
the median edge or less), which is compared triangle by triangle; normals are octahedral, 10 bits a coordinate. The
codecs hold that surface alone, and their bytes are those of the buffers, without the JSON of a glTF file. A
``.nanite`` file holds all levels of detail, about twice the triangles, with their hierarchy, and is counted whole.

Meshoptimizer's streams are those of EXT_meshopt_compression and of its successor KHR_meshopt_compression, ordered
as gltfpack orders for compression: positions in 16 bits, normals through the octahedral filter, triangles as for
strips.

Every mesh is measured in a process of its own on one thread, by processor time. Decoding starts from bytes in
memory (a ``.nanite`` file: in the cache of the system) and ends with NumPy arrays (a validated mesh, with bounds of
all clusters).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import nanite_rs as nrs
from nanite_rs._core import Mesh as CoreMesh

from . import machine, meshes

if TYPE_CHECKING:
    from collections.abc import Callable

    Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]

NAMES = ("bunny", "armadillo", "dragon", "lucy", "sphere 1 M")
PEERS = ("DracoPy", "meshoptimizer", "zstandard")
NORMAL_BITS = 10
NORMALS_OFF = 0.5  # degrees: what rounding to so many bits may do
OCTAHEDRAL_ONE = (1 << (NORMAL_BITS - 1)) - 1
DRACO_LEVELS = (7, 10)  # what encoders of glTF take, and the best
PAGE_TABLE, PAGES = 4, 5  # kinds of sections: docs/format.md
ROW_WORDS = 18  # of the page table
RUNS = 7
OURS = ".nanite, all levels"


class Coded(NamedTuple):
    """A surface as bytes."""

    bytes: int
    #: Positions, normals and triangles, or whatever can be used in their place.
    decode: Callable[[], object] | None = None
    #: Of decoded positions, in steps of the grid.
    unit: float = 1.0


def run(*, quick: bool) -> dict[str, object]:
    """A row for each mesh and codec; JSON-ready."""
    rows: list[dict[str, object]] = []
    absent = []
    for name in ("sphere 100 k",) if quick else NAMES:
        command = [sys.executable, "-m", "benchmarks.python.files", name]
        result = subprocess.run(
            command,
            check=True,
            capture_output=True,
            text=True,
            cwd=Path(__file__).resolve().parents[2],
            env={**os.environ, "RAYON_NUM_THREADS": "1"},
        )
        found = json.loads(result.stdout)
        absent += [] if found else [name]
        rows += found
    known = machine.describe(PEERS)["packages"]
    peers = {name: known[name] or "not installed" for name in PEERS}
    return {"meshes left out": ", ".join(absent) or "none", "peers": peers, "rows": rows}


def _measure(name: str) -> list[dict[str, object]]:
    """The rows of a mesh; none where it is absent."""
    try:
        vertices, faces = meshes.MESHES[name]()
    except FileNotFoundError:
        return []
    exact = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.nanite"
        exact.save(path)
        ours = nrs.NaniteMesh.open(path)
        step = ours.info["precision"]
        cut = ours.cut(error=0.0)
        grid = np.rint(np.asarray(cut.vertices, np.float64) / step).astype(np.int64)
        grid -= grid.min(axis=0)
        # Normals before they were rounded: each codec rounds for itself.
        surface = (grid, exact.cut(error=0.0).normals, cut.faces)
        file = path.read_bytes()
        peers = {**_draco(surface, step), **_meshoptimizer(surface)}
        coded = {
            # Opening reads no page; this reads all.
            OURS: Coded(len(file), lambda: CoreMesh.from_bytes(file)),
            "its pages of level 0": Coded(_level_0(file)),
            **peers,
        }
        times = _seconds({method: c.decode for method, c in coded.items() if c.decode})
        for method, peer in peers.items():
            points, normals, triangles = peer.decode()
            _compare(method, surface, (np.rint(points / peer.unit), normals, triangles))
    stored = {method: len(cut.faces) for method in coded} | {OURS: ours.report.triangles}
    return [
        {
            "mesh": name,
            "triangles": len(cut.faces),
            "method": method,
            "bytes": c.bytes,
            "B/triangle": c.bytes / len(cut.faces),
            "B/stored triangle": c.bytes / stored[method],
            "decoding ms": 1e3 * times[method] if method in times else "",
            "M stored triangles/s": 1e-6 * stored[method] / times[method] if method in times else "",
        }
        for method, c in coded.items()
    ]


def _level_0(file: bytes) -> int:
    """Coded bytes of the pages of level 0, by the page table."""
    sections = np.frombuffer(file, np.dtype("u4, u4, u8, u8, u8"), int.from_bytes(file[12:16], "little"), 24)
    of = {int(kind): (int(offset), int(length)) for kind, _, offset, length, _ in sections}
    offset, length = of[PAGE_TABLE]
    rows = np.frombuffer(file, np.uint32, length // 4, offset).reshape(-1, ROW_WORDS)
    assert rows[:, 2].sum() == of[PAGES][1]
    return int(rows[rows[:, 6] == 0, 2].sum())


def _draco(surface: Arrays, step: float) -> dict[str, Coded]:
    """By Draco, on the same grid: its steps are the range over 2^bits − 1."""
    try:
        import DracoPy
    except ImportError:
        return {}
    grid, normals, faces = surface
    bits = int(grid.max()).bit_length()

    def decode(data: bytes) -> Arrays:
        mesh = DracoPy.decode(data)
        return mesh.points, mesh.normals, mesh.faces

    out = {}
    for level in DRACO_LEVELS:
        data = DracoPy.encode(
            (grid * step).astype(np.float32),
            faces,
            quantization_bits=bits,
            quantization_range=((1 << bits) - 1) * step,
            quantization_origin=[0.0, 0.0, 0.0],
            compression_level=level,
            normals=np.asarray(normals, np.float64),
            normal_quantization_bits=NORMAL_BITS,
        )
        out[f"Draco, level {level}"] = Coded(len(data), lambda data=data: decode(data), step)
    return out


def _octahedral(normals: np.ndarray) -> np.ndarray:
    """What meshoptimizer's filter takes: two coordinates, what stands for one, and nothing."""
    n = np.asarray(normals, np.float64)
    n = n / np.abs(n).sum(axis=1, keepdims=True)
    x, y = n[:, 0], n[:, 1]
    below = n[:, 2] < 0
    folded_x = np.where(below, (1.0 - np.abs(y)) * np.where(x < 0, -1.0, 1.0), x)
    folded_y = np.where(below, (1.0 - np.abs(x)) * np.where(y < 0, -1.0, 1.0), y)
    out = np.zeros((len(n), 4), np.int16)
    out[:, 0], out[:, 1] = np.rint(folded_x * OCTAHEDRAL_ONE), np.rint(folded_y * OCTAHEDRAL_ONE)
    out[:, 2] = OCTAHEDRAL_ONE
    return out


def _meshoptimizer(surface: Arrays) -> dict[str, Coded]:
    """By Meshoptimizer's codecs of both versions, and through general compressors."""
    try:
        import meshoptimizer as mo
    except ImportError:
        return {}
    grid, normals, faces = surface
    assert grid.max() < 1 << 16
    vertices = np.zeros((len(grid), 8), np.uint16)
    vertices[:, :3] = grid
    vertices[:, 4:] = _octahedral(normals).view(np.uint16)
    indices = np.zeros(faces.size, np.uint32)
    mo.optimize_vertex_cache_strip(indices, faces.ravel().astype(np.uint32), faces.size, len(vertices))
    fetched = np.zeros_like(vertices)
    mo.optimize_vertex_fetch(fetched, indices, vertices)
    streams = [np.ascontiguousarray(fetched[:, :4]), np.ascontiguousarray(fetched[:, 4:])]
    count = len(vertices)

    def decode(positions: bytes, normals: bytes, triangles: bytes) -> Arrays:
        p = mo.decode_vertex_buffer(count, 8, positions, dtype=np.dtype((np.uint16, 4)))
        n = mo.decode_vertex_buffer(count, 8, normals, dtype=np.dtype((np.int16, 4)))
        n = mo.decode_filter_oct(n, count, 8)
        f = mo.decode_index_buffer(len(indices), 4, triangles)
        return p[:, :3], n[:, :3], f.reshape(-1, 3)

    out = {}
    for extension, version in {"EXT_meshopt_compression": 0, "KHR_meshopt_compression": 1}.items():
        mo.encode_vertex_version(version)
        mo.encode_index_version(1)  # that of both extensions
        coded = [mo.encode_vertex_buffer(s, count, 8) for s in streams]
        coded.append(mo.encode_index_buffer(indices, len(indices), count))
        for compressor, (compress, expand) in _compressors().items():
            data = [compress(part) for part in coded]
            out[extension + compressor] = Coded(
                sum(len(part) for part in data),
                lambda data=data, expand=expand: decode(*(expand(part) for part in data)),
            )
    return out


def _compressors() -> dict[str, tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]]:
    """Names to append, and functions."""
    out = {"": (bytes, bytes), ", zlib 9": (lambda data: zlib.compress(data, 9), zlib.decompress)}
    try:
        import zstandard
    except ImportError:
        return out
    writer, reader = zstandard.ZstdCompressor(level=19), zstandard.ZstdDecompressor()
    return {**out, ", zstd 19": (writer.compress, reader.decompress)}


def _seconds(contestants: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median processor seconds, in turn."""
    spent: dict[str, list[float]] = {method: [] for method in contestants}
    for _ in range(RUNS):
        for method, call in contestants.items():
            before = time.process_time()
            call()
            spent[method].append(time.process_time() - before)
    return {method: float(np.median(seconds)) for method, seconds in spent.items()}


def _places(grid: np.ndarray) -> np.ndarray:
    """Three coordinates as one number."""
    at = np.asarray(grid).astype(np.int64)
    return at[:, 0] << 42 | at[:, 1] << 21 | at[:, 2]


def _triangles(grid: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangles by the places of their corners, each from its least corner on, in order."""
    corners = _places(grid)[np.asarray(faces)]
    first = corners.argmin(axis=1)[:, None]
    corners = np.take_along_axis(corners, (first + np.arange(3)) % 3, axis=1)
    return corners[np.lexsort(corners.T)]


def _by_place(places: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places where one vertex lies alone, in order, and their unit normals."""
    known, first, count = np.unique(places, return_index=True, return_counts=True)
    unit = np.asarray(normals, np.float64)[first[count == 1]]
    return known[count == 1], unit / np.linalg.norm(unit, axis=1, keepdims=True)


def _compare(method: str, source: Arrays, decoded: Arrays) -> None:
    """The same triangles, and normals as near as their bits allow."""
    same = np.array_equal(_triangles(source[0], source[2]), _triangles(decoded[0], decoded[2]))
    assert same, f"{method}: other triangles than those of the source"
    (places, before), (again, after) = (_by_place(_places(a[0]), a[1]) for a in (source, decoded))
    _, i, j = np.intersect1d(places, again, assume_unique=True, return_indices=True)
    assert len(i) > 0.9 * len(source[0]), f"{method}: {len(i)} of {len(source[0])} vertices"
    angle = np.degrees(np.arccos((before[i] * after[j]).sum(axis=1).clip(-1.0, 1.0))).max()
    assert angle < NORMALS_OFF, f"{method}: a normal is off by {angle} degrees"


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1])))
