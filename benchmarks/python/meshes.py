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

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
Arrays = tuple[np.ndarray, np.ndarray]

MESHES: dict[str, Callable[[], Arrays]] = {
    "bunny": lambda: load("scans/stanford_bunny_full/bun_zipper.ply"),
    "armadillo": lambda: load("scans/armadillo_86k/armadillo.obj"),
    "horse": lambda: load("scans/horse_full/horse.ply"),
    "lucy": lambda: load("scans/lucy_100k/lucy.ply"),
    "turbine": lambda: load("scans/turbine_blade_199k/turbineblade.ply"),
    "dragon": lambda: load("scans/stanford_dragon_res2/dragon_vrip_res2.ply.gz"),
    "sphere 100 k": lambda: nrs.shapes.displaced_icosphere(faces=100_000)[:2],
    "sphere 1 M": lambda: nrs.shapes.displaced_icosphere(faces=1_000_000)[:2],
    "sphere 5 M": lambda: nrs.shapes.displaced_icosphere(faces=5_000_000)[:2],
}


def load(path: str) -> Arrays:
    """The vertices that faces use, float32, and the faces of a file of ``../shared/data``."""
    name = DATA / path
    if not name.exists():
        raise FileNotFoundError(2, "no such file", str(name))
    with gzip.open(name) if name.suffix == ".gz" else name.open("rb") as file:
        mesh = trimesh.load_mesh(file, file_type=path.removesuffix(".gz").rpartition(".")[2], process=False)
    used, faces = np.unique(np.asarray(mesh.faces), return_inverse=True)
    return np.asarray(mesh.vertices)[used].astype(np.float32), faces.reshape(-1, 3)
