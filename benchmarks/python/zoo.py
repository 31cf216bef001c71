"""Quality of cuts on meshes of many kinds, beside other simplifiers at equal numbers of triangles.

``python -m benchmarks.python.zoo`` takes scans, CAD, assemblies, thin sheets, slivers, terrain and what is broken
(``zoo_meshes.py``). Distances are in 1e-4 of the diagonal, of two directions the larger. What peers make is kept in
``target/zoo-cache``, so that only cuts are made anew. VTK's is ``vtkQuadricDecimation`` with pyvista's defaults:
no attributes, no volume preservation, boundary weight 1. Where it keeps more than 1.02 times what it was asked for,
a second cut of as many triangles as it has is held against it. Needs requirements/error.txt.

``--against before.json`` prints what changed since a run that was kept with ``--json``.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import multiprocessing
import time
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import nanite_rs as nrs

from . import zoo_report
from .zoo_measure import Doubts, Reference, edge_counts
from .zoo_meshes import LARGEST, SMALLEST, ZOO

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .zoo_meshes import Arrays

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / "target" / "zoo-cache"
QUICK = (
    "stanford_bunny_full",
    "1002_tray_bottom",
    "cycloidal",
    "scatter_tree",
    "parts of many sizes",
    "small box beside large",
    "plate 1e-3",
    "annuli",
    "wire",
    "sliced part",
    "plain gears",
    "terraces",
    "voxels",
    "noisy sphere",
)
EARLY = 1.02
"""VTK stopped early where it has so many times the triangles that it was asked for."""
FLOOR = 1e-2
"""In 1e-4 of the diagonal: distances below count as so much when they are compared."""
PATIENCE = 600
"""Seconds for one call of a peer."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.zoo", description=__doc__)
    kinds = sorted({animal.kind for animal in ZOO.values()})
    parser.add_argument("--only", nargs="+", metavar="NAME", help="which meshes; a part of a name will do")
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=kinds, help="which kinds")
    parser.add_argument("--qualities", nargs="+", choices=["best", "fast"], default=["best", "fast"])
    parser.add_argument("--removed", nargs="+", type=float, default=[0.5, 0.9, 0.99], help="parts removed")
    parser.add_argument("--peers", nargs="*", choices=PEERS, default=list(PEERS), help="beside whom")
    parser.add_argument("--samples", type=int, help="points of either surface (50000; 10000 with --quick)")
    parser.add_argument(
        "--near",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="take what a peer made earlier if it has at most so much more triangles, 0.01 say: for trying out",
    )
    parser.add_argument("--quick", action="store_true", help=f"{len(QUICK)} meshes, few samples")
    parser.add_argument("--list", action="store_true", help="print the meshes that were chosen, and stop")
    parser.add_argument("--against", type=Path, metavar="JSON", help="an earlier run to compare with")
    parser.add_argument("--output", type=Path, metavar="MARKDOWN", help="where the report goes")
    parser.add_argument("--json", type=Path, help="where all figures go")
    options = parser.parse_args()
    samples = options.samples or (10_000 if options.quick else 50_000)
    if not any(animal.file for animal in ZOO.values()):
        print("left out: meshes of ../shared/data, which is absent")
    names = [name for name in ZOO if ZOO[name].kind in options.kinds]
    if options.only:
        names = [name for name in names if any(part in name for part in options.only)]
    elif options.quick:
        names = [name for name in names if name in QUICK]
    if options.list:
        print("\n".join(f"{ZOO[name].kind:10}{name}" for name in names))
        return
    print(f"nanite_rs of {Path(nrs.__file__).parent}, {len(names)} meshes, {samples:,} samples each way")
    earlier = json.loads(options.against.read_text())["rows"] if options.against else []
    rows: list[dict[str, Any]] = []
    errors: list[str] = []
    start = time.perf_counter()
    for name in names:
        try:
            for row in measure(
                name, options.qualities, options.removed, options.peers, samples, options.near
            ):
                rows.append(row)
                print(zoo_report.line(row, earlier), flush=True)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # one mesh must not end the others, nor a panic, which is no Exception
            errors.append(f"{name}: {type(error).__name__}: {error}")
            print(f"FAILED {errors[-1]}\n{traceback.format_exc(limit=-2)}", flush=True)
        result = {"samples": samples, "rows": rows, "errors": errors}
        if options.json:
            options.json.parent.mkdir(parents=True, exist_ok=True)
            options.json.write_text(json.dumps(result, indent=1) + "\n")
    text = zoo_report.document(rows, errors, earlier)
    print(f"\n{text}\n{time.perf_counter() - start:.0f} s")
    if options.output:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(text)


def measure(
    name: str, qualities: list[str], removed: list[float], peers: list[str], samples: int, near: float
) -> Iterator[dict[str, Any]]:
    """Rows of one mesh, one after another; JSON-ready."""
    vertices, faces = ZOO[name]()
    if ZOO[name].file and not SMALLEST <= len(faces) <= LARGEST:
        print(f"{name}: left out, {len(faces):,} triangles")
        return
    kept = Kept(vertices, faces, samples, near)
    before = edge_counts(vertices, faces)
    for quality in qualities:
        start = time.process_time()
        options = nrs.BuildOptions(quality=quality)
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
        seconds = time.process_time() - start
        for part in removed:
            cut = mesh.cut(target_reduction=part)
            target = round((1 - part) * len(faces), 6)
            row = {
                "mesh": name,
                "kind": ZOO[name].kind,
                "quality": quality,
                "removed": part,
                "source": {"triangles": len(faces), **before},
                "build s": seconds,
                "of target": len(cut.faces) / target,
                "coarsest": len(cut.faces) > target and len(cut.faces) <= len(mesh.cut(error=np.inf).faces),
                **measured(kept, cut),
                "peers": {},
            }
            for peer in peers:
                row["peers"][peer] = versus(mesh, row, peer, kept, cut.error)
            yield row


def measured(kept: Kept, cut: nrs.Cut) -> dict[str, Any]:
    """A cut against the source."""
    source = kept.source
    found, doubts = kept.distances(cut.vertices, cut.faces)
    unit = source.diagonal / 1e4
    violated = False
    if cut.error < found["max"] * unit:
        most, violated = source.beyond(cut.vertices, cut.faces, cut.error)
        found["max"] = most / unit
    return {
        **found,
        "stated": cut.error / unit,
        "tightness": cut.error / unit / found["max"] if found["max"] > FLOOR else None,
        "violated": violated,
        "turned": source.turned(doubts, cut.error),
    }


def versus(
    mesh: nrs.NaniteMesh, row: dict[str, Any], peer: str, kept: Kept, allowed: float
) -> dict[str, Any]:
    """A peer's figures and the ratio of a cut's rms to its own."""
    made = kept.made(peer, row["triangles"])
    if "failed" in made or not len(made["faces"]):
        return {"failed": str(made.get("failed", "nothing left"))}
    found, doubts = kept.distances(made["vertices"], made["faces"])
    result = {**found, "s": float(made["seconds"]), "turned": kept.source.turned(doubts, allowed)}
    result["ratio"] = ratio(row["rms"], found["rms"])
    if found["triangles"] > EARLY * row["triangles"]:
        cut = mesh.cut(target_faces=found["triangles"])
        again, _ = kept.distances(cut.vertices, cut.faces)
        result["early"], result["ratio as asked"] = len(cut.faces), result["ratio"]
        result["ratio"] = ratio(again["rms"], found["rms"])
    return result


def ratio(ours: float, theirs: float) -> float:
    """Of two distances; those too small to matter are equal."""
    return max(ours, FLOOR) / max(theirs, FLOOR)


# ------------------------------------------------------------------------------------------------------- peers


def _vtk(vertices: np.ndarray, faces: np.ndarray, count: int, _: float) -> Arrays:
    from .quality import decimate

    return decimate(vertices, faces, count)


def _fast(vertices: np.ndarray, faces: np.ndarray, count: int, diagonal: float) -> Arrays:
    from .quality import fast

    return fast(vertices, faces, count, diagonal)


def _fast_as_given(vertices: np.ndarray, faces: np.ndarray, count: int, _: float) -> Arrays:
    from .quality import fast

    return fast(vertices, faces, count, 100.0)


def _meshoptimizer(vertices: np.ndarray, faces: np.ndarray, count: int, _: float) -> Arrays:
    import meshoptimizer

    indices = np.ascontiguousarray(faces, np.uint32).ravel()
    out = np.empty_like(indices)
    points = np.ascontiguousarray(vertices, np.float32)
    size = meshoptimizer.simplify(out, indices, points, target_index_count=3 * count, target_error=1.0)
    return vertices, out[:size].reshape(-1, 3)


PEERS: dict[str, Callable[[np.ndarray, np.ndarray, int, float], Arrays]] = {
    "vtk": _vtk,
    "fast-simplification": _fast_as_given,
    "fast-simplification 100": _fast,
    "meshoptimizer": _meshoptimizer,
}
VERSION = 1
"""Of what is kept; another one makes all anew."""


def digest(vertices: np.ndarray, faces: np.ndarray) -> str:
    """A name for two arrays."""
    found = hashlib.sha256(f"{VERSION} {vertices.dtype}".encode())
    found.update(np.ascontiguousarray(vertices).tobytes())
    found.update(np.ascontiguousarray(faces, np.int64).tobytes())
    return found.hexdigest()[:24]


class Kept:
    """What peers make of one mesh, and how far anything is from the source; found once, then read from disk."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, samples: int, near: float) -> None:
        self._mesh, self._samples, self._near = (vertices, faces), samples, near
        self._folder = CACHE / digest(vertices, faces)
        self._folder.mkdir(parents=True, exist_ok=True)

    @functools.cached_property
    def source(self) -> Reference:
        """What others are measured against."""
        return Reference(*self._mesh, self._samples)

    def distances(self, vertices: np.ndarray, faces: np.ndarray) -> tuple[dict[str, Any], Doubts]:
        """Distances and edges of a mesh, and what may be turned of it."""
        path = self._folder / f"{digest(vertices, faces)}-{self._samples}.npz"
        if not path.exists():
            found, doubts = self.source.distances(vertices, faces)
            found |= {"triangles": len(faces), **edge_counts(vertices, faces)}
            np.savez_compressed(path, found=json.dumps(found), **vars(doubts))
        with np.load(path) as file:
            doubts = Doubts(file["points"], file["normals"], file["distances"], int(file["samples"]))
            return json.loads(str(file["found"])), doubts

    def made(self, peer: str, count: int) -> dict[str, Any]:
        """A peer's mesh of so many triangles, or how it failed; or one that is there and has few more."""
        stems = (path.stem for path in self._folder.glob(f"{peer}-*.npz"))
        there = sorted(int(s[len(peer) + 1 :]) for s in stems if s[len(peer) + 1 :].isdigit())
        count = next((n for n in there if count <= n <= count * (1 + self._near)), count)
        path = self._folder / f"{peer}-{count}.npz"
        if not path.exists():
            self._make(peer, count, path)
        with np.load(path) as file:
            return dict(file)

    def _make(self, peer: str, count: int, path: Path) -> None:
        """In a process of its own: a peer that crashes on a broken mesh must not end the others."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forking where there are threads
            child = multiprocessing.get_context("fork").Process(
                target=_save, args=(path, PEERS[peer], *self._mesh, count, self.source.diagonal)
            )
            child.start()
        child.join(PATIENCE)
        if child.is_alive():
            child.kill()
            child.join()
            np.savez(path, failed=f"no end in {PATIENCE} s")
        elif not path.exists():
            np.savez(path, failed=f"ended with {child.exitcode}")


def _save(
    path: Path,
    call: Callable[..., Arrays],
    vertices: np.ndarray,
    faces: np.ndarray,
    count: int,
    diagonal: float,
) -> None:
    start = time.process_time()
    points, triangles = call(vertices, faces, count, diagonal)
    unfinished = path.with_suffix(".part.npz")
    np.savez_compressed(
        unfinished, vertices=points, faces=triangles.astype(np.int32), seconds=time.process_time() - start
    )
    unfinished.rename(path)


if __name__ == "__main__":
    main()
