"""3D Tiles of files: time and memory against triangles, beside the build of the file.

``python -m benchmarks.python.tiles --faces 5e6 20e6``. The source is the generated scan of ``blocks``. Building and
tiling run in processes of their own; the largest ``RssAnon`` is sampled, beyond what a process has with the modules
loaded.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import nanite_rs as nrs

from . import machine, tables
from .blocks import RESULTS, SAMPLED, child, ready, write_scan


def tile(given: dict[str, Any]) -> dict[str, Any]:
    """Tile an opened file."""
    ready()
    start = time.perf_counter()
    report = nrs.NaniteMesh.open(given["target"]).to_3dtiles(given["folder"], overwrite=True, progress=False)
    seconds = time.perf_counter() - start
    return {
        "tiles s": seconds,
        "tiles": report.tiles,
        "levels": report.levels,
        "median kB": report.median_bytes / 1e3,
        "B/triangle of a tile": report.bytes / report.triangles,
        "MB": report.bytes / 1e6,
    }


def main() -> None:
    """Command line."""
    if len(sys.argv) == 3 and sys.argv[1] == "tile":
        print(json.dumps(tile(json.loads(sys.argv[2]))))
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.tiles", description=__doc__)
    parser.add_argument("--faces", type=float, nargs="+", default=[1e6, 5e6, 20e6])
    parser.add_argument(
        "--quality", default="best", choices=("best", "fast"), help="of the build (%(default)s)"
    )
    parser.add_argument("--folder", type=Path, help="where files are made; some 150 bytes per triangle")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    asked = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        source, target = Path(folder) / "scan.ply", Path(folder) / "scan.nanite"
        for faces in asked.faces:
            write_scan(source, int(faces))
            given = {"source": str(source), "target": str(target), "memory": 0, "workers": 0}
            built = child("build", given | {"quality": asked.quality, "threads": 0})
            tiled = child("tile", {"target": str(target), "folder": f"{folder}/tiles"}, "tiles")
            row = {"triangles": built["triangles"], "build s": built["s"], "tiles s": tiled["tiles s"]}
            row |= {"of the build": tiled["tiles s"] / built["s"]}
            row |= {"k tri/s": built["triangles"] / tiled["tiles s"] / 1e3}
            row |= {"tiles' peak MB": tiled["peak MB"]}
            row |= {key: value for key, value in tiled.items() if key not in ("peak MB", "tiles s")}
            rows.append(row)
            print(row, flush=True)
    here = machine.describe()
    lines = [
        f"# 3D Tiles, {tables.today()}",
        "",
        f"`python -m benchmarks.python.tiles {' '.join(sys.argv[1:])}`.",
        f"{here['processor']}, {here['cores']} cores, {here['memory_gib']} GiB. A generated scan, closed; its file",
        f'was built in memory with `quality="{asked.quality}"`, and tiled as it was opened, by default options.',
        f"Peak: `RssAnon` beyond what loading the modules took, every {SAMPLED * 1000:.0f} ms. One run each.",
        "",
        tables.table(rows),
    ]
    tables.publish(lines, asked.output, "tiles")


if __name__ == "__main__":
    main()
