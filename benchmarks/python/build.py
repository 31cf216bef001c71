"""Building: triangles per second from arrays, on one thread and on two, beside meshopt's ``clod_build``.

The comparison itself is Rust's (``cargo bench --bench build``): both sides there see the same arrays in the
same run. Here the whole call from Python is timed, and criterion's latest medians are read in, if there are
any.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import nanite_rs as nrs

ROOT = Path(__file__).resolve().parents[2]


def run(*, quick: bool) -> dict[str, object]:
    """Builds the same mesh several times; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=250_000 if quick else 1_000_000)
    rows = []
    for threads in (1, 2):
        times = []
        for _ in range(2 if quick else 3):
            start = time.perf_counter()
            mesh = nrs.NaniteMesh.from_arrays(
                vertices, faces, options=nrs.BuildOptions(threads=threads), progress=False
            )
            times.append(time.perf_counter() - start)
            del mesh
        seconds = sorted(times)[len(times) // 2]
        rows.append(
            {"triangles": len(faces), "threads": threads, "s": seconds, "Mtri/s": len(faces) / seconds / 1e6}
        )
    return {
        "rows": rows,
        "speed-up of two threads": rows[0]["s"] / rows[1]["s"],
        "criterion": criterion("build"),
    }


def criterion(group: str) -> dict[str, float]:
    """Median seconds of each of criterion's latest results whose name contains ``group``."""
    medians = {}
    for estimates in sorted((ROOT / "target" / "criterion").glob("**/new/estimates.json")):
        name = "/".join(estimates.relative_to(ROOT / "target" / "criterion").parts[:-2])
        if group in name:
            medians[name] = json.loads(estimates.read_text())["median"]["point_estimate"] / 1e9
    return medians
