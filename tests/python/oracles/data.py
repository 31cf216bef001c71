"""Real meshes. They are no part of the project: tests that need them skip, and say so, without them."""

from __future__ import annotations

import functools
import gzip
import io
import json
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh

_ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Mesh:
    """Plain arrays of a triangle mesh, as a caller would hand them over."""

    name: str
    vertices: np.ndarray  # (N, 3) float32
    faces: np.ndarray  # (M, 3) int64

    @functools.cached_property
    def center(self) -> np.ndarray:
        """Centre of the bounding box."""
        used = self.used.astype(np.float64)
        return (used.min(axis=0) + used.max(axis=0)) / 2

    @functools.cached_property
    def used(self) -> np.ndarray:
        """The vertices that faces refer to."""
        return self.vertices[np.unique(self.faces)]

    @functools.cached_property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal."""
        used = self.used.astype(np.float64)
        return float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))


def shared() -> Path | None:
    """The folder of real meshes: ``$NANITE_SHARED_DATA``, or ``../shared/data`` beside the repository."""
    folder = Path(os.environ.get("NANITE_SHARED_DATA", _ROOT.parent / "shared" / "data"))
    return folder if folder.is_dir() else None


def require(*parts: str) -> Path:
    """Path of a real mesh; skips the calling test when it is absent."""
    base = shared()
    if base is None:
        pytest.skip("real meshes are absent: no ../shared/data, and NANITE_SHARED_DATA names none")
    path = base.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"real mesh is absent: {'/'.join(parts)}")
    return path


SCANS = {
    "bunny": ("scans", "stanford_bunny_full", "bun_zipper.ply"),
    "armadillo": ("scans", "armadillo_86k", "armadillo.obj"),
    "lucy": ("scans", "lucy_100k", "lucy.ply"),
    "horse": ("scans", "horse_full", "horse.ply"),
    "dragon": ("scans", "stanford_dragon_res2", "dragon_vrip_res2.ply.gz"),
    "turbine": ("scans", "turbine_blade_199k", "turbineblade.ply"),
    "mountain": ("scans", "mountain", "mountain.obj"),
}
"""Scans by name; parts of the path below the data folder."""

MODEL_SUFFIXES = (".ply", ".obj", ".stl", ".off", ".glb", ".gltf", ".gz")


def folder_models(folder: str) -> list[Path]:
    """Every model file of a folder of assets, for parametrization; empty where the data is absent."""
    base = shared()
    if base is None or not (base / folder).is_dir():
        return []
    return sorted(p for p in (base / folder).rglob("*") if p.suffix.lower() in MODEL_SUFFIXES)


def model_names(folder: str) -> list[str]:
    """``folder/asset`` for every model file of a folder of assets; what :func:`model` takes."""
    return [f"{folder}/{path.parent.name}" for path in folder_models(folder)]


def load_arrays(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (float32) and faces of a file, merged and untouched otherwise."""
    raw, suffix = path.read_bytes(), path.suffix
    if suffix == ".gz":
        raw, suffix = gzip.decompress(raw), Path(path.stem).suffix
    if b"EXT_meshopt_compression" in raw:
        raw = _without_meshopt(raw)
    if suffix == ".gltf":  # has its buffers beside it
        loaded = trimesh.load_mesh(path, process=False)
    else:
        loaded = trimesh.load_mesh(io.BytesIO(raw), file_type=suffix[1:].lower(), process=False)
    return np.asarray(loaded.vertices, np.float32), np.asarray(loaded.faces, np.int64)


def _without_meshopt(raw: bytes) -> bytes:
    """A .glb whose buffers EXT_meshopt_compression shrinks, written out in full: trimesh cannot read it else."""
    import meshoptimizer

    start = 20 + struct.unpack_from("<I", raw, 12)[0]
    document, body = json.loads(raw[20:start]), raw[start + 8 :]
    full = bytearray()
    for view in document["bufferViews"]:
        packed = view.get("extensions", {}).pop("EXT_meshopt_compression", None)
        part = packed or view
        data = body[part.get("byteOffset", 0) :][: part["byteLength"]]
        if packed and packed["mode"] == "ATTRIBUTES":
            stride = packed["byteStride"]
            data = meshoptimizer.decode_vertex_buffer(packed["count"], stride, data).tobytes()
        elif packed:
            indices = meshoptimizer.decode_index_buffer(packed["count"], 4, data)
            data = indices.astype(f"<u{packed['byteStride']}").tobytes()
        view.update(buffer=0, byteOffset=len(full), byteLength=len(data))
        full += data + bytes(-len(data) % 4)
    document["buffers"] = [{"byteLength": len(full)}]
    for key in ("extensionsUsed", "extensionsRequired"):
        document[key] = [name for name in document.get(key, []) if name != "EXT_meshopt_compression"]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(full), b"BIN\0") + full
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@functools.cache
def scan(name: str) -> Mesh:
    """A scan by name; skips the calling test when it is absent."""
    vertices, faces = load_arrays(require(*SCANS[name]))
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Mesh(name, vertices, faces)


@functools.cache
def model(name: str) -> Mesh:
    """The one model of an asset, by ``folder/asset``; skips the calling test when it is absent."""
    folder, _, _ = name.partition("/")
    found = [path for path in folder_models(folder) if f"{folder}/{path.parent.name}" == name]
    if not found:
        pytest.skip(f"real mesh is absent: {name}")
    vertices, faces = load_arrays(found[0])
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Mesh(name, vertices, faces)
