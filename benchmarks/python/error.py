"""Run time against error: cuts against every simplifier that Python has, at equal numbers of triangles.

``make bench-error`` runs it: the scans of ``../shared/data`` where they are, and generated meshes. Each peer is
asked for as many triangles as the cut of the best quality has. A cut's time is that of the cut; what building
took is told apart, once per mesh. Times are the lesser of wall clock and processor time, so that others at work on
the machine count less. Distances are libigl's, 200,000 samples each way, in 1e-4 of the diagonal of the bounding
box. fast-simplification, whose thresholds are absolute, gets the mesh as it is and scaled to a diagonal of 100.

``--only "sphere 5 M" --merge`` adds a mesh to the results of the day, ``--methods Open3D --merge`` a contestant.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import fast_simplification
import matplotlib
import meshoptimizer
import numpy as np
import pymeshlab

import nanite_rs as nrs

from . import machine, tables
from .cut import Source
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
CUTS = {"nanite_rs cut, best": "best", "nanite_rs cut, fast": "fast"}
BUSY = 3.0
"""Load above which times are marked."""
METHODS = (
    *CUTS,
    "fast-simplification, as given",
    "fast-simplification, diagonal 100",
    "meshoptimizer simplify",
    "pymeshlab",
    "VTK",
    "Open3D",
)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.error", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=MESHES, default=list(MESHES), help="which meshes")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS, help="which contestants")
    parser.add_argument(
        "--limit", type=float, default=600, help="seconds for a contestant and a mesh (%(default)s)"
    )
    parser.add_argument("--merge", action="store_true", help="keep what the day's results hold besides")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    methods = [m for m in options.methods if m != "Open3D" or open3d]
    date = tables.today()
    stem = options.output / f"{date}-error"
    before = json.loads(stem.with_suffix(".json").read_text()) if options.merge else {"meshes": {}}
    meshes = before["meshes"]
    for name in options.only:
        try:
            arrays = MESHES[name]()
        except FileNotFoundError as missing:
            print(f"{name}: left out, {missing.filename} is absent")
            continue
        print(f"{name} …", flush=True)
        meshes[name] = compare(*arrays, methods, options.limit, meshes.get(name))
        print(table(name, meshes[name]), flush=True)
    meshes = {name: meshes[name] for name in MESHES if name in meshes}
    results = {"date": date, "machine": machine.describe(PEERS), "meshes": meshes}
    options.output.mkdir(parents=True, exist_ok=True)
    stem.with_suffix(".json").write_text(json.dumps(results, indent=1) + "\n")
    stem.with_suffix(".md").write_text(document(results))
    plot(meshes, stem.with_suffix(".png"))
    print(f"wrote {stem}.md, .json and .png")


def compare(
    vertices: np.ndarray, faces: np.ndarray, methods: list[str], limit: float, before: dict | None
) -> dict[str, object]:
    """Contestants on one mesh, and what was known of others before; JSON-ready."""
    source = Source(vertices, faces, samples=200_000)
    result = before or {"triangles": len(faces), "built in s": {}, "rows": []}
    counts = {r["removed"]: r["triangles"] for r in result["rows"] if r["method"] == "nanite_rs cut, best"}
    built = {}
    for quality in [q for method, q in CUTS.items() if method in methods or (q == "best" and not counts)]:
        options = nrs.BuildOptions(quality=quality)
        built[quality], seconds = timed(
            lambda options=options: nrs.NaniteMesh.from_arrays(
                vertices, faces, options=options, progress=False
            )
        )
        result["built in s"][quality] = seconds
    if "best" in built:
        counts = {removed: len(built["best"].cut(target_reduction=removed).faces) for removed in REMOVED}
    rows = {(r["removed"], r["method"]): r for r in result["rows"]}
    spent = dict.fromkeys(methods, 0.0)
    made = contestants(vertices, faces, built, source.diagonal)
    for removed in REMOVED:
        for method in methods:
            row = {"removed": removed, "method": method, "load": machine.describe()["load"]}
            if spent[method] > limit:
                row["left out"] = f"after {spent[method]:.0f} s for the rows above"
            else:
                (v, f, stated), row["s"] = timed(lambda m=method, n=counts[removed]: made[m](n))
                spent[method] += row["s"]
                row["triangles"] = len(f)
                row["stated"] = None if stated is None else stated / source.diagonal * 1e4
                row |= source.two_sided(v, f)
            rows[removed, method] = row
            print(row, flush=True)
    order = sorted(rows, key=lambda key: (key[0], METHODS.index(key[1])))
    return result | {"rows": [rows[key] for key in order]}


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """What a call gives, and the lesser of the wall clock's and the processor's seconds."""
    wall, processor = time.perf_counter(), time.process_time()
    result = call()
    return result, min(time.perf_counter() - wall, time.process_time() - processor)


Result = TypeVar("Result")
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

    calls = (
        *(cut(quality) for quality in CUTS.values()),
        fast(1.0),
        fast(up),
        meshopt,
        meshlab,
        vtk,
        o3d,
    )
    return dict(zip(METHODS, calls, strict=True))


def table(name: str, result: dict) -> str:
    """One mesh as Markdown."""
    star = "*" if result["rows"][0].get("load", 0) > BUSY else ""
    builds = ", ".join(f"{quality} {s:.2f} s{star}" for quality, s in result["built in s"].items())
    lines = [
        f"## {name}, {result['triangles']:,} triangles",
        "",
        f"Built on all cores: {builds}.",
        "",
        "| removed | method | triangles | s | mean | rms | max | stated |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in result["rows"]:
        if "left out" in r:
            lines.append(f"| {r['removed']} | {r['method']} | left out {r['left out']} | | | | | |")
            continue
        stated = "" if r["stated"] is None else f"{r['stated']:.1f}"
        busy = "*" if r.get("load", 0) > BUSY else ""
        lines.append(
            f"| {r['removed']} | {r['method']} | {r['triangles']:,} | {r['s']:.3g}{busy}"
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
        " by libigl; single runs, so quote times as ratios. Times are the lesser of wall clock and processor time;"
        f" a star stands where others were at work on the machine (load over {BUSY}). `stated` is the error that"
        " the contestant states itself.\n\n"
        f"![error against triangles and against time]({results['date']}-error.png)\n\n"
    )
    return head + "\n".join(table(name, result) for name, result in results["meshes"].items())


def plot(meshes: dict[str, dict], path: Path) -> None:
    """Error against triangles above, against time below; a column per mesh."""
    figure, axes = plt.subplots(2, len(meshes), figsize=(4.2 * len(meshes), 7.6), squeeze=False)
    for column, (name, result) in zip(axes.T, meshes.items(), strict=True):
        for method in dict.fromkeys(r["method"] for r in result["rows"]):
            rows = [r for r in result["rows"] if r["method"] == method and "s" in r]
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
