"""Run time against error: cuts against every simplifier that Python has, at equal numbers of triangles.

``make bench-error`` runs it: the scans of ``../shared/data`` where they are, and generated meshes. Each peer is
asked for as many triangles as the cut of the best quality has. A cut's time is that of the cut; what building
took is told apart, once per mesh. Distances are libigl's, 200,000 samples each way, in 1e-4 of the diagonal of
the bounding box. fast-simplification, whose thresholds are absolute, gets the mesh as it is and scaled to a
diagonal of 100.
"""

from __future__ import annotations

import argparse
import datetime
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING

import fast_simplification
import matplotlib
import meshoptimizer
import numpy as np
import pymeshlab

import nanite_rs as nrs

from . import machine
from .cut import two_sided
from .meshes import MESHES
from .quality import decimate

try:
    import open3d
except ImportError as missing:
    print(f"Open3D is left out: {missing}. On Debian: apt-get install libusb-1.0-0 libgl1")
    open3d = None

matplotlib.use("Agg")
from matplotlib import pyplot as plt

if TYPE_CHECKING:
    from collections.abc import Callable

RESULTS = Path(__file__).resolve().parents[1] / "results"
REMOVED = (0.5, 0.75, 0.9, 0.97, 0.99)
PEERS = ("meshoptimizer", "open3d", "pymeshlab", "pyvista", "vtk", "matplotlib")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.error", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=MESHES, default=list(MESHES), help="which meshes")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    meshes = {}
    for name in options.only:
        try:
            arrays = MESHES[name]()
        except FileNotFoundError as missing:
            print(f"{name}: left out, {missing.filename} is absent")
            continue
        print(f"{name} …", flush=True)
        meshes[name] = compare(*arrays)
        print(table(name, meshes[name]), flush=True)
    date = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
    results = {"date": date, "machine": machine.describe(PEERS), "meshes": meshes}
    options.output.mkdir(parents=True, exist_ok=True)
    stem = options.output / f"{date}-error"
    stem.with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")
    stem.with_suffix(".md").write_text(document(results))
    plot(meshes, stem.with_suffix(".png"))
    print(f"wrote {stem}.md, .json and .png")


def compare(vertices: np.ndarray, faces: np.ndarray) -> dict[str, object]:
    """All contestants on one mesh; JSON-ready."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    builds, built = {}, {}
    for quality in ("fast", "best"):
        start = time.perf_counter()
        built[quality] = nrs.NaniteMesh.from_arrays(
            vertices, faces, options=nrs.BuildOptions(quality=quality), progress=False
        )
        builds[quality] = time.perf_counter() - start
    rows = []
    for removed in REMOVED:
        count = len(built["best"].cut(target_reduction=removed).faces)
        for method, make in contestants(vertices, faces, built, diagonal).items():
            start = time.perf_counter()
            v, f, stated = make(count)
            seconds = time.perf_counter() - start
            row = {"removed": removed, "method": method, "triangles": len(f), "s": seconds, "stated": stated}
            if stated is not None:
                row["stated"] = stated / diagonal * 1e4
            rows.append(row | two_sided(vertices, faces, v, f, diagonal, samples=200_000))
    return {"triangles": len(faces), "built in s": builds, "rows": rows}


Made = tuple[np.ndarray, np.ndarray, float | None]


def contestants(
    vertices: np.ndarray, faces: np.ndarray, built: dict[str, nrs.NaniteMesh], diagonal: float
) -> dict[str, Callable[[int], Made]]:
    """What makes a mesh of so many triangles: vertices, faces and the error it states, if it does."""
    signed, up = faces.astype(np.int32), 100 / diagonal

    def cut(quality: str) -> Callable[[int], Made]:
        def make(count: int) -> Made:
            result = built[quality].cut(target_faces=count)
            return result.vertices, result.faces, result.error

        return make

    def fast(scale: float) -> Callable[[int], Made]:
        def make(count: int) -> Made:
            scaled = (vertices * scale).astype(np.float32)
            v, f = fast_simplification.simplify(scaled, signed, target_count=count)
            return v / scale, f, None

        return make

    def meshopt(count: int) -> Made:
        indices = np.ascontiguousarray(faces, np.uint32).ravel()
        out, error = np.empty_like(indices), np.zeros(1, np.float32)
        size = meshoptimizer.simplify(
            out, indices, vertices, target_index_count=3 * count, target_error=1.0, result_error=error
        )
        extent = float(np.ptp(vertices, axis=0).max())
        return vertices, out[:size].reshape(-1, 3), float(error[0]) * extent

    def vtk(count: int) -> Made:
        return *decimate(vertices, faces, count), None

    def o3d(count: int) -> Made:
        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(vertices.astype(np.float64)), open3d.utility.Vector3iVector(signed)
        )
        result = mesh.simplify_quadric_decimation(count)
        return np.asarray(result.vertices), np.asarray(result.triangles), None

    def meshlab(count: int) -> Made:
        session = pymeshlab.MeshSet()
        session.add_mesh(pymeshlab.Mesh(vertices.astype(np.float64), signed))
        session.meshing_decimation_quadric_edge_collapse(targetfacenum=count)
        result = session.current_mesh()
        return result.vertex_matrix(), result.face_matrix(), None

    made = {
        "nanite_rs cut, best": cut("best"),
        "nanite_rs cut, fast": cut("fast"),
        "fast-simplification, as given": fast(1.0),
        "fast-simplification, diagonal 100": fast(up),
        "meshoptimizer simplify": meshopt,
        "pymeshlab": meshlab,
        "VTK": vtk,
    }
    return made | ({"Open3D": o3d} if open3d else {})


def table(name: str, result: dict) -> str:
    """One mesh as Markdown."""
    builds = ", ".join(f"{quality} {s:.2f} s" for quality, s in result["built in s"].items())
    lines = [
        f"## {name}, {result['triangles']:,} triangles",
        "",
        f"Built on all cores: {builds}.",
        "",
        "| removed | method | triangles | s | mean | rms | max | stated |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in result["rows"]:
        stated = "" if r["stated"] is None else f"{r['stated']:.1f}"
        lines.append(
            f"| {r['removed']} | {r['method']} | {r['triangles']:,} | {r['s']:.3g}"
            f" | {r['mean']:.3g} | {r['rms']:.3g} | {r['max']:.3g} | {stated} |"
        )
    return "\n".join(lines) + "\n"


def document(results: dict) -> str:
    """The whole report."""
    about = results["machine"]
    versions = ", ".join(f"{n} {v}" for n, v in about["packages"].items() if v)
    head = (
        f"# Run time against error, {results['date']}\n\n"
        f"{about['processor']}, {about['cores']} cores, {about['memory_gib']} GiB, Python {about['python']};"
        f" {versions}. `make bench-error`. Distances in 1e-4 of the diagonal, two-sided, 200,000 samples each way,"
        " by libigl; single runs, so quote times as ratios. `stated` is the error that the contestant states"
        " itself.\n\n"
        f"![error against triangles and against time]({results['date']}-error.png)\n\n"
    )
    return head + "\n".join(table(name, result) for name, result in results["meshes"].items())


def plot(meshes: dict[str, dict], path: Path) -> None:
    """Error against triangles above, against time below; a column per mesh."""
    figure, axes = plt.subplots(2, len(meshes), figsize=(4.2 * len(meshes), 7.6), squeeze=False)
    for column, (name, result) in zip(axes.T, meshes.items(), strict=True):
        for method in dict.fromkeys(r["method"] for r in result["rows"]):
            rows = [r for r in result["rows"] if r["method"] == method]
            style = {
                "marker": "o",
                "ms": 3,
                "lw": 2.2 if method.startswith("nanite_rs") else 1,
                "label": method,
            }
            column[0].loglog([r["triangles"] for r in rows], [r["rms"] for r in rows], **style)
            column[1].loglog([r["s"] for r in rows], [r["rms"] for r in rows], **style)
        column[0].set(title=name, xlabel="triangles", ylabel="rms distance, 1e-4 of the diagonal")
        column[1].set(xlabel="seconds", ylabel="rms distance, 1e-4 of the diagonal")
    handles, labels = axes[0][0].get_legend_handles_labels()
    columns = min(4, len(meshes))
    figure.legend(handles, labels, loc="lower center", ncols=columns, frameon=False)
    figure.tight_layout(rect=(0, 0.025 + 0.025 * -(-len(labels) // columns), 1, 1))
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
