"""One level at once: `nrs.decimate` to a tenth of the triangles, against ``fast_simplification.simplify``.

fast-simplification's thresholds are absolute, so it is run on the mesh as given and on the mesh scaled to a
diagonal of 100, where it is at its best; with ``agg=4`` it is slower and more exact, and with less it ends before
the target.
Deviation as for cuts: 100,000 samples each way, by libigl, in units of 1e-4 of the diagonal.
"""

from __future__ import annotations

import fast_simplification
import numpy as np

import nanite_rs as nrs

from .cut import Source
from .measure import interleaved

REMOVED = 0.9
OURS = ("nanite_rs decimate, best", "nanite_rs decimate, fast")
GIVEN = "fast-simplification, as given"
SCALED = "fast-simplification, diagonal 100"
EXACT = "fast-simplification, diagonal 100, agg 4"


def run(*, quick: bool) -> dict[str, object]:
    """Times and deviations; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=100_000 if quick else 1_000_000)
    source = Source(vertices, faces, samples=20_000 if quick else 100_000)
    scale = 100 / source.diagonal
    scaled, signed = (vertices * scale).astype(np.float32), faces.astype(np.int32)

    def ours(quality: str) -> tuple[np.ndarray, np.ndarray]:
        cut = nrs.decimate((vertices, faces), target_reduction=REMOVED, quality=quality, progress=False)
        return cut.vertices, cut.faces

    def theirs(points: np.ndarray, unit: float, agg: float) -> tuple[np.ndarray, np.ndarray]:
        v, f = fast_simplification.simplify(points, signed, REMOVED, agg=agg)
        return v / unit, f

    contestants = {
        OURS[0]: lambda _: ours("best"),
        OURS[1]: lambda _: ours("fast"),
        GIVEN: lambda _: theirs(vertices, 1.0, 7.0),
        SCALED: lambda _: theirs(scaled, scale, 7.0),
        EXACT: lambda _: theirs(scaled, scale, 4.0),
    }
    times = interleaved(contestants, runs=3, warm_up=0 if quick else 1)
    rows = []
    for method, call in contestants.items():
        v, f = call(0)
        rows.append(
            {
                "removed": REMOVED,
                "method": method,
                "triangles": len(f),
                "s": times[method]["median"],
                **source.two_sided(v, f),
            }
        )
    return {"source triangles": len(faces), "rows": rows}


def main() -> None:
    """Print the table."""
    from . import tables

    print(tables.section("decimate", run(quick=False)))


if __name__ == "__main__":
    main()
