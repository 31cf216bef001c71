"""What splits triangles into clusters and gathers clusters into groups: edges cut, sizes, error of cuts, time.

``python -m benchmarks.python.partition`` writes a table into ``benchmarks/results``. Meshes of ``../shared/data``
where they are, and a generated one. Cut edges are those of the source whose two faces lie in different clusters,
or in different groups of clusters, as parts of all edges with two faces. Distances are libigl's, in 1e-4 of the
diagonal. Cuts come in whole groups, so their sizes differ by a few per cent: as the error of a surface goes with
one over its triangles, it is stated for exactly the size asked for.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import nanite_rs as nrs
from nanite_rs import _core

from . import machine, meshes, tables
from .cut import Source

if TYPE_CHECKING:
    from collections.abc import Callable

    from .meshes import Arrays

RESULTS = Path(__file__).resolve().parents[1] / "results"
REMOVED = (0.5, 0.9, 0.99)
SAMPLES = 100_000
CHOICES = tuple(itertools.product(("median", "flex", "metis"), ("meshopt", "metis")))

MESHES: dict[str, Callable[[], Arrays]] = {
    "bunny": meshes.MESHES["bunny"],
    "armadillo": meshes.MESHES["armadillo"],
    "CAD frame": lambda: meshes.load("cad/voron_a_drive_frame_lower/a_drive_frame_lower.stl"),
    "foliage tree": lambda: meshes.load("foliage/scatter_tree/tree.glb"),
    "sphere 1 M": meshes.MESHES["sphere 1 M"],
}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.partition", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=MESHES, default=list(MESHES), help="which meshes")
    parser.add_argument("--runs", type=int, default=3, help="builds of each kind, in turn (%(default)s)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    date = tables.today()
    described = machine.describe()
    lines = [
        f"# Clusters and groups, {date}",
        "",
        f"`python -m benchmarks.python.partition`. {described['processor']}, {described['cores']} cores; load"
        f" before the first run: {described['load']}. Options besides those of the table are the defaults. Time is"
        f" the processor's, the least of {options.runs} builds in turn.",
    ]
    for name in options.only:
        try:
            vertices, faces = MESHES[name]()
        except FileNotFoundError as missing:
            print(f"{name}: left out, {missing.filename} is absent")
            continue
        lines += ["", f"## {name}, {len(faces):,} triangles", "", *table(vertices, faces, options.runs)]
    tables.publish([*lines, ""], options.output, "partition")


def table(vertices: np.ndarray, faces: np.ndarray, runs: int) -> list[str]:
    """Lines of a Markdown table with a row for each pair of choices."""
    head = ["clusterizer", "partition", "clusters", "fill", "edges cut: clusters", "groups", "processor s"]
    head += [f"rms at −{removed:.0%}" for removed in REMOVED]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    seconds = dict.fromkeys(CHOICES, np.inf)
    built = {}
    for _, choice in itertools.product(range(runs), CHOICES):
        start = time.process_time()
        built[choice] = nrs.NaniteMesh.from_arrays(
            vertices,
            faces,
            options=nrs.BuildOptions(clusterizer=choice[0], partition=choice[1]),
            progress=False,
        )
        seconds[choice] = min(seconds[choice], time.process_time() - start)
    source = Source(vertices, faces, samples=SAMPLES)
    for choice, mesh in built.items():
        clusters, groups = edges_cut(mesh)
        report = mesh.report
        row = [*choice, f"{report.clusters:,}", f"{report.fill:.1%}", f"{clusters:.2%}", f"{groups:.2%}"]
        row.append(f"{seconds[choice]:.2f}")
        for removed in REMOVED:
            target = round((1 - removed) * len(mesh))
            cut = mesh.cut(target_faces=target)
            error = source.two_sided(cut.vertices, cut.faces)["rms"]
            row.append(f"{error * len(cut.faces) / target:.3f}")
        lines.append(f"| {' | '.join(row)} |")
    return lines


def edges_cut(mesh: nrs.NaniteMesh) -> tuple[float, float]:
    """Parts of the edges of the source, by position, that lie between clusters and between groups."""
    cut = mesh.cut(error=0.0)
    cluster = cut.cluster_ids[cut.face_clusters]
    all_clusters = _core.cluster_table(mesh._core)
    order = np.argsort(all_clusters["id"])
    group = all_clusters["group"][order][np.searchsorted(all_clusters["id"][order], cluster)]
    _, position = np.unique(cut.vertices, axis=0, return_inverse=True)
    ends = np.sort(position.ravel()[cut.faces[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2), axis=1)
    _, edge, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(edge.ravel(), kind="stable")
    order = order[(uses[edge.ravel()] == 2)[order]].reshape(-1, 2) // 3
    return tuple(float(np.mean(part[order[:, 0]] != part[order[:, 1]])) for part in (cluster, group))


if __name__ == "__main__":
    main()
