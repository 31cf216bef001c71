"""Memory and time of builds: each in a process of its own, on a mesh that it reads from a file.

The peak is the operating system's figure for the process (Linux: VmHWM), less what it held with the arrays in
place, so it holds everything: allocator, threads' buffers, and the mesh that is returned. The peer is the same mesh
halved again and again by fast-simplification, with all levels kept.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import nanite_rs as nrs

from .build import PEER, halved

METHODS = {
    "nanite_rs, fast, quadric": {"quality": "fast", "error": "quadric"},
    "nanite_rs, fast, bound": {"quality": "fast", "error": "bound"},
    "nanite_rs, best, bound": {"quality": "best", "error": "bound"},
    PEER: None,
}
PEAK = "peak B/tri"
STATUS = Path("/proc/self/status")


def run(*, quick: bool) -> dict[str, object]:
    """Bytes per triangle beyond the arrays given, and processor time, at two sizes; JSON-ready."""
    if not STATUS.exists():
        raise SystemExit("memory: needs /proc/self/status, which Linux has")
    sizes = (50_000, 100_000) if quick else (1_000_000, 10_000_000)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for faces in sizes:
            vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces)
            np.savez(f"{folder}/{faces}.npz", vertices=vertices, triangles=triangles)
            del vertices, triangles
        for method, options in METHODS.items():
            # In turn, and the least time of each: what else runs on the machine slows both sizes alike.
            least: dict[int, dict[str, float]] = {}
            for _ in range(3 if "quadric" in method and not quick else 1):
                for faces in sizes:
                    found = _child(f"{folder}/{faces}.npz", options)
                    known = least.setdefault(faces, found)
                    least[faces] = {key: min(value, known[key]) for key, value in found.items()}
                    least[faces][PEAK] = max(found[PEAK], known[PEAK])
            for faces in sizes:
                row = {"method": method, **least[faces]}
                row["processor s ÷ smaller"] = row["processor s"] / least[sizes[0]]["processor s"]
                row["s ÷ smaller"] = row["s"] / least[sizes[0]]["s"]
                rows.append(row)
    return {"rows": rows}


def _child(mesh: str, options: dict[str, str] | None) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.python.memory", mesh, json.dumps(options)]
    root = Path(__file__).resolve().parents[2]
    result = subprocess.run(command, check=True, capture_output=True, text=True, cwd=root)
    found: dict[str, float] = json.loads(result.stdout)
    return found


def _status(key: str) -> int:
    """Bytes that the system states for this process."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(f"{key}:"))
    return 1024 * int(line.split()[1])


def _measure(path: str, options: dict[str, str] | None) -> dict[str, float]:
    """Builds the mesh of a file once; without options, the levels of the peer."""
    with np.load(path) as arrays:
        vertices, triangles = arrays["vertices"], arrays["triangles"]
    # The system forgets the peak so far.
    Path("/proc/self/clear_refs").write_text("5")
    before, processor, start = _status("VmHWM"), time.process_time(), time.perf_counter()
    if options is None:
        levels = halved(vertices, triangles)
        held = sum(v.nbytes + f.nbytes for v, f in levels[1:])
    else:
        mesh = nrs.NaniteMesh.from_arrays(
            vertices, triangles, options=nrs.BuildOptions(**options), progress=False
        )
        held = mesh.nbytes
    seconds, processor = time.perf_counter() - start, time.process_time() - processor
    count = len(triangles)
    return {
        "triangles": count,
        PEAK: (_status("VmHWM") - before) / count,
        "of it the result": held / count,
        "processor s": processor,
        "s": seconds,
    }


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1], json.loads(sys.argv[2]))))
