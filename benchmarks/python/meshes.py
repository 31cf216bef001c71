"""The meshes that errors are measured on: scans of ``../shared/data`` where they are, and generated ones."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

import nanite_rs as nrs

if TYPE_CHECKING:
    from collections.abc import Callable

SCANS = Path(__file__).resolve().parents[3] / "shared" / "data" / "scans"
Arrays = tuple[np.ndarray, np.ndarray]

MESHES: dict[str, Callable[[], Arrays]] = {
    "bunny": lambda: _scan("stanford_bunny_full/bun_zipper.ply"),
    "armadillo": lambda: _scan("armadillo_86k/armadillo.obj"),
    "horse": lambda: _scan("horse_full/horse.ply"),
    "lucy": lambda: _scan("lucy_100k/lucy.ply"),
    "turbine": lambda: _scan("turbine_blade_199k/turbineblade.ply"),
    "dragon": lambda: _scan("stanford_dragon_res2/dragon_vrip_res2.ply.gz"),
    "sphere 1 M": lambda: nrs.shapes.displaced_icosphere(faces=1_000_000)[:2],
    "sphere 5 M": lambda: nrs.shapes.displaced_icosphere(faces=5_000_000)[:2],
}


def _scan(path: str) -> Arrays:
    if not (SCANS / path).exists():
        raise FileNotFoundError(2, "no such file", str(SCANS / path))
    name = SCANS / path
    with gzip.open(name) if name.suffix == ".gz" else name.open("rb") as file:
        mesh = trimesh.load_mesh(file, file_type=path.removesuffix(".gz").rpartition(".")[2], process=False)
    used, faces = np.unique(np.asarray(mesh.faces), return_inverse=True)
    return np.asarray(mesh.vertices)[used].astype(np.float32), faces.reshape(-1, 3)
