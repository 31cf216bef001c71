"""Real meshes. They are no part of the project: tests that need them skip, and say so, without them."""

from __future__ import annotations

import functools
import os
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
    """Every model file of ``nasty`` or ``cad``, for parametrization; empty where the data is absent."""
    base = shared()
    if base is None or not (base / folder).is_dir():
        return []
    return sorted(p for p in (base / folder).rglob("*") if p.suffix.lower() in MODEL_SUFFIXES)


def load_arrays(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (float32) and faces of a file, merged and untouched otherwise."""
    if path.suffix == ".gz":
        import gzip
        import io

        with gzip.open(path) as stream:
            loaded = trimesh.load_mesh(
                io.BytesIO(stream.read()), file_type=path.stem.rsplit(".", 1)[-1], process=False
            )
    else:
        loaded = trimesh.load_mesh(path, process=False)
    return np.asarray(loaded.vertices, np.float32), np.asarray(loaded.faces, np.int64)


@functools.cache
def scan(name: str) -> Mesh:
    """A scan by name; skips the calling test when it is absent."""
    vertices, faces = load_arrays(require(*SCANS[name]))
    vertices.setflags(write=False)
    faces.setflags(write=False)
    return Mesh(name, vertices, faces)
