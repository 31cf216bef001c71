"""What ``quality="best"`` is worth: cuts against VTK's decimation to the same number of triangles.

``python -m benchmarks.python.quality`` prints, for each mesh, the root mean square distance of cuts as a part of
that of VTK's mesh and of fast-simplification's at its best (scaled to a diagonal of 100), by libigl, two-sided;
processor time of the build on all cores; and triangles stored for each of the source. ``--option`` sets build
options: ``--option quality=fast group_clusters=24``. Needs requirements/error.txt.
"""

from __future__ import annotations

import argparse
import json
import time

import fast_simplification
import numpy as np
import pyvista

import nanite_rs as nrs

from .cut import Source
from .meshes import MESHES

REMOVED = (0.5, 0.9, 0.99)
DEFAULT = ("bunny", "armadillo", "horse", "lucy", "turbine", "sphere 1 M")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.quality", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=MESHES, default=list(DEFAULT), help="which meshes")
    parser.add_argument("--option", nargs="+", default=[], metavar="NAME=VALUE", help="build options")
    parser.add_argument("--samples", type=int, default=50_000, help="samples each way (%(default)s)")
    arguments = parser.parse_args()
    options = {"quality": "best"} | {name: _value(text) for name, text in map(_split, arguments.option)}
    columns = " | ".join(f"{removed}: rms, VTK, f-s" for removed in REMOVED)
    print(f"{nrs.BuildOptions(**options)}\n\n| mesh | {columns} | build s | stored |")
    print("|---" * (len(REMOVED) + 3) + "|")
    for name in arguments.only:
        vertices, faces = MESHES[name]()
        print(row(name, vertices, faces, nrs.BuildOptions(**options), arguments.samples), flush=True)


def _split(text: str) -> tuple[str, str]:
    name, _, value = text.partition("=")
    return name, value


def _value(text: str) -> object:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def row(name: str, vertices: np.ndarray, faces: np.ndarray, options: nrs.BuildOptions, samples: int) -> str:
    """One mesh as a line of Markdown."""
    source = Source(vertices, faces, samples=samples)
    start = time.process_time()
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
    seconds = time.process_time() - start
    cells = []
    for removed in REMOVED:
        cut = mesh.cut(target_reduction=removed)
        made = [
            (cut.vertices, cut.faces),
            decimate(vertices, faces, len(cut.faces)),
            fast(vertices, faces, len(cut.faces), source.diagonal),
        ]
        ours, vtk, other = (source.two_sided(v, f)["rms"] for v, f in made)
        cells.append(f"{ours:.3g}, {ours / vtk:.2f}×, {ours / other:.2f}×")
    return f"| {name} | {' | '.join(cells)} | {seconds:.2f} | {mesh.report.triangles / len(faces):.2f} |"


def decimate(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """VTK's quadric decimation to so many triangles."""
    padded = np.column_stack([np.full(len(faces), 3), faces]).ravel()
    result = pyvista.PolyData(vertices, padded).decimate(1 - count / len(faces))
    return np.asarray(result.points), np.asarray(result.faces).reshape(-1, 4)[:, 1:]


def fast(
    vertices: np.ndarray, faces: np.ndarray, count: int, diagonal: float
) -> tuple[np.ndarray, np.ndarray]:
    """fast-simplification to so many triangles, at the scale where it is at its best."""
    scale = 100 / diagonal
    scaled = (vertices * scale).astype(np.float32)
    v, f = fast_simplification.simplify(scaled, faces.astype(np.int32), target_count=count)
    return v / scale, f


if __name__ == "__main__":
    main()
