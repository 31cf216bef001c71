"""Builds of sources larger than memory: time and memory against triangles, beside the same surface in memory.

``python -m benchmarks.python.blocks --faces 5e6 20e6 --memory 2e9``. The source is a generated scan in a PLY file:
a torus with waves of all lengths and noise, closed, written strip by strip. Every build runs in a process of its
own, under a limit of its data of 1.25 times ``--memory``. The largest ``RssAnon`` is sampled, beyond what a process
has with the modules loaded. ``--in-memory`` builds so many triangles in memory, to compare with; 0 leaves it out.
Files are opened, checked and cut in another process. ``--workers 2`` builds on one worker of a Dask cluster, too,
and on so many, of a thread each.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import nanite_rs as nrs

from . import machine, tables

if TYPE_CHECKING:
    from collections.abc import Iterator

RESULTS = Path(__file__).resolve().parents[1] / "results"
ROOT = Path(__file__).resolve().parents[2]
STRIP = 1 << 20
"""Vertices that are made at a time."""
WAVES = 40
SAMPLED = 0.02
"""Seconds between looks at the memory."""
LIMIT = 1.25
"""Of the memory asked for: what the system allows."""


def write_scan(path: Path, faces: int, seed: int = 0) -> int:
    """Write a scan of about as many triangles; returns how many."""
    columns = round(np.sqrt(faces / 2 / 3))
    rows = 3 * columns
    rng = np.random.default_rng(seed)
    lengths = np.geomspace(2, columns / 8, WAVES)
    turns = np.rint(lengths * rng.normal(size=(2, WAVES))).astype(int)
    heights = 0.08 / lengths
    phases = rng.uniform(0, 2 * np.pi, WAVES)
    around = 2 * np.pi * np.arange(columns) / columns
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {rows * columns}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {2 * rows * columns}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    step = max(1, STRIP // columns)
    with open(path, "wb") as file:
        file.write(header.encode())
        for first in range(0, rows, step):
            along = 2 * np.pi * np.arange(first, min(rows, first + step))[:, None] / rows
            height = np.zeros((len(along), columns))
            for a, b, h, phase in zip(*turns, heights, phases, strict=True):
                height += h * (
                    np.sin(a * along + phase) * np.cos(b * around)
                    + np.cos(a * along + phase) * np.sin(b * around)
                )
            noise = np.random.default_rng([seed, first]).normal(size=height.shape)
            radius = 0.35 + 0.3 * height + 0.05 * (2 * np.pi / rows) * noise
            ring = 1.0 + radius * np.cos(around)
            points = (ring * np.cos(along), ring * np.sin(along), radius * np.sin(around))
            file.write(np.stack(points, axis=-1).astype("<f4").tobytes())
        table = np.zeros(2 * columns, [("count", "u1"), ("corners", "<i4", 3)])
        table["count"] = 3
        own = np.arange(columns)
        right = (own + 1) % columns
        for row in range(rows):
            here, above = row * columns, (row + 1) % rows * columns
            quads = (here + own, above + own, above + right), (here + own, above + right, here + right)
            for half, corners in enumerate(quads):
                table["corners"][half::2] = np.stack(corners, axis=-1)
            file.write(table.tobytes())
    return 2 * rows * columns


def _status(process: int, key: str) -> int:
    """Bytes that the system states for a process; 0 once it has ended."""
    try:
        text = Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return 0
    line = next((line for line in text.splitlines() if line.startswith(f"{key}:")), None)
    return 1024 * int(line.split()[1]) if line else 0


def child(task: str, given: dict[str, Any], module: str = "blocks") -> dict[str, Any]:
    """Run a task of a benchmark in a process of its own; adds the largest memory sampled."""
    command = [sys.executable, "-m", f"benchmarks.python.{module}", task, json.dumps(given)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        before = peak = _status(process.pid, "RssAnon")
        process.stdin.write("go\n")
        process.stdin.flush()
        while process.poll() is None:
            peak = max(peak, _status(process.pid, "RssAnon"))
            time.sleep(SAMPLED)
        if process.returncode:
            raise SystemExit(f"{task}: ended with {process.returncode}")
        found: dict[str, Any] = json.loads(process.stdout.read())
    return found | {"peak MB": (peak - before) / 1e6}


def build(given: dict[str, Any]) -> dict[str, Any]:
    """Build a file, with a limit of memory or without."""
    ready()
    options = nrs.BuildOptions(quality=given["quality"], threads=given["threads"])
    with contextlib.ExitStack() as stack:
        if given["memory"]:
            # Workers inherit it.
            allowed = int(LIMIT * given["memory"]) + _status_of_self("VmData")
            resource.setrlimit(resource.RLIMIT_DATA, (allowed, allowed))
        client = stack.enter_context(_cluster(given["workers"])) if given["workers"] else None
        start = time.perf_counter()
        if given["memory"]:
            how = {"memory": given["memory"], "options": options, "executor": client, "progress": False}
            mesh = nrs.build_file(given["source"], given["target"], **how)
        else:
            mesh = nrs.NaniteMesh.from_file(given["source"], options=options, progress=False)
            mesh.save(given["target"])
        seconds = time.perf_counter() - start
    return {"triangles": mesh.report.input_faces, "s": seconds}


@contextlib.contextmanager
def _cluster(workers: int) -> Iterator[Any]:
    """Yield a client of a cluster of processes of one thread each."""
    from distributed import Client, LocalCluster

    how = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with LocalCluster(**how) as cluster, Client(cluster, set_as_default=False) as client:
        yield client


def _status_of_self(key: str) -> int:
    return _status(os.getpid(), key)


def look(given: dict[str, Any]) -> dict[str, Any]:
    """Open a file, check it and cut it."""
    ready()
    start = time.perf_counter()
    mesh = nrs.NaniteMesh.open(given["target"])
    checked = mesh.check()
    seconds = time.perf_counter() - start
    cut = mesh.cut(target_faces=100_000)
    edges = np.sort(cut.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.uint64), axis=1)
    _, uses = np.unique(edges[:, 0] << np.uint64(32) | edges[:, 1], return_counts=True)
    return {
        "B/tri": Path(given["target"]).stat().st_size / mesh.report.input_faces,
        "clusters/1k tri": 1e3 * checked.clusters / mesh.report.input_faces,
        "levels": len(mesh.report.levels),
        "root tri": mesh.report.levels[-1].triangles,
        "check s": seconds,
        "cut's error 1e-6": 1e6 * cut.error,
        "closed": bool((uses == 2).all()),
    }


def ready() -> None:
    """Wait until the parent has seen what a process has before it begins."""
    print("ready", flush=True)
    sys.stdin.readline()


def main() -> None:
    """Command line."""
    if len(sys.argv) == 3 and sys.argv[1] in ("build", "look"):
        print(json.dumps({"build": build, "look": look}[sys.argv[1]](json.loads(sys.argv[2]))))
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.blocks", description=__doc__)
    parser.add_argument("--faces", type=float, nargs="+", default=[5e6, 20e6, 50e6, 200e6])
    parser.add_argument("--memory", type=float, default=2e9, help="bytes of a build in blocks (%(default)s)")
    parser.add_argument("--in-memory", type=float, default=10e6, help="triangles of the build beside them")
    parser.add_argument("--workers", type=int, default=0, help="also on so many workers of a cluster")
    parser.add_argument("--workers-alone", action="store_true", help="not in one process")
    parser.add_argument("--quality", nargs="+", default=["best", "fast"])
    parser.add_argument("--folder", type=Path, help="where files are made; some 150 bytes per triangle")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    asked = parser.parse_args()
    rows = []
    runs = [(int(asked.in_memory), 0, 0, 0)] if asked.in_memory else []
    for faces in asked.faces:
        if not asked.workers_alone:
            runs.append((int(faces), int(asked.memory), 0, 0))
        if asked.workers:
            runs += [(int(faces), int(asked.memory), 1, workers) for workers in (1, asked.workers)]
    written = 0
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        source, target = Path(folder) / "scan.ply", Path(folder) / "scan.nanite"
        for faces, memory, threads, workers in runs:
            if faces != written:
                write_scan(source, faces)
                written = faces
            for quality in asked.quality:
                given = {"source": str(source), "target": str(target), "memory": memory, "quality": quality}
                given |= {"threads": threads, "workers": workers}
                built = child("build", given)
                seen = child("look", given)
                row = {"quality": quality, "memory": f"{memory / 1e6:,.0f} MB" if memory else "as it takes"}
                row |= {"threads": threads or "all", "workers": workers or ""}
                row |= {"triangles": built["triangles"], "s": built["s"]}
                row |= {"k tri/s": built["triangles"] / built["s"] / 1e3, "peak MB": built["peak MB"]}
                row |= {key: value for key, value in seen.items() if key != "peak MB"}
                row |= {"check's MB": seen["peak MB"]}
                rows.append(row)
                print(row, flush=True)
    here = machine.describe()
    date = tables.today()
    lines = [
        f"# Builds in blocks, {date}",
        "",
        f"`python -m benchmarks.python.blocks {' '.join(sys.argv[1:])}`.",
        f"{here['processor']}, {here['cores']} cores, {here['memory_gib']} GiB. A generated scan, closed, in a",
        f"binary PLY; each build in a process of its own, those with a limit under {LIMIT} times that of data.",
        f"Peak: `RssAnon` beyond what loading the modules took, every {SAMPLED * 1000:.0f} ms. One run each.",
        "",
        tables.table(rows),
    ]
    tables.publish(lines, asked.output, "blocks")


if __name__ == "__main__":
    main()
