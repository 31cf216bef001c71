"""Meshes from a URL: opening, the first image, and a flight, over a simulated line.

``python -m benchmarks.python.remote``. A server of Python in a process of its own answers each request after
``--latency`` and sends all bodies through one line of ``--bandwidth``. Connections are open already when requests
come, as those of a browser are. The first image is drawn by a renderer with an empty pool and no cache on disk. A
flight holds to the clock: a frame that takes long shows a later moment. It is flown twice, with a new
``cache_dir``, and from what that keeps.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import nanite_rs as nrs

from . import machine, tables
from .peer import SIZE
from .streaming import CAMERA, look_at, pose_at, saved, scene_of

if TYPE_CHECKING:
    from collections.abc import Iterator

RESULTS = Path(__file__).resolve().parents[1] / "results"
ROOT = Path(__file__).resolve().parents[2]
PIECE = 16 << 10
"""Bytes that one answer sends before another has its turn."""
PACE = 1 / 30
"""Seconds of a frame of a flight, at least."""
ROUND_TRIPS = 12
"""Latencies that the first image may take beside the transfer."""
PIXELS = 2.0
"""What a frame of a flight may be off by."""


class Line:
    """A line of some bytes each second, which all answers share."""

    def __init__(self, bytes_per_second: float) -> None:
        self._rate, self._free, self._lock = bytes_per_second, 0.0, threading.Lock()

    def wait(self, size: int) -> None:
        """Return when so many bytes more have gone through."""
        with self._lock:
            self._free = max(self._free, time.perf_counter()) + size / self._rate
            until = self._free
        time.sleep(max(0.0, until - time.perf_counter()))


def serve(path: Path, latency: float, bandwidth: float, fail_every: int) -> None:
    """Serve a file until the standard input ends; says the port first."""
    data, line = path.read_bytes(), Line(bandwidth)
    count, lock = [0], threading.Lock()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        # Bodies go in pieces: none waits until an earlier one is acknowledged.
        disable_nagle_algorithm = True

        def log_message(self, *_: object) -> None:
            pass

        def do_GET(self) -> None:
            time.sleep(latency)
            with lock:
                count[0] += 1
                fails = fail_every > 0 and count[0] % fail_every == 0
            asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
            if fails or asked is None:
                self.send_response(503 if fails else 400)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            start, end = int(asked[1]), min(int(asked[2]) + 1, len(data))
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
            self.send_header("Content-Length", str(end - start))
            self.send_header("ETag", '"1"')
            self.end_headers()
            for at in range(start, end, PIECE):
                piece = data[at : min(at + PIECE, end)]
                line.wait(len(piece))
                self.wfile.write(piece)

    class Quiet(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:
            """Readers that go away are no news."""

    server = Quiet(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(server.server_port, flush=True)
    sys.stdin.read()


@contextmanager
def served(path: Path, asked: argparse.Namespace) -> Iterator[str]:
    """A server of a file in a process of its own; its URL."""
    numbers = asked.latency / 1e3, asked.bandwidth * 1e6 / 8, asked.fail_every
    command = [sys.executable, "-m", "benchmarks.python.remote", "serve", str(path), *map(str, numbers)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        yield f"http://127.0.0.1:{int(process.stdout.readline())}/{path.name}"
        process.stdin.close()


def warmed(renderer: nrs.Renderer) -> None:
    """Start threads, and compile what is compiled."""
    small = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2000), progress=False)
    renderer.render(scene_of(small), CAMERA, look_at(np.array([0.0, 0.0, 3.0]), np.zeros(3)))


def first_images(where: str, path: Path, asked: argparse.Namespace, near: bool) -> dict[str, object]:
    """Opening, and what is there when the first image is complete: medians of runs, each with an empty pool."""
    pose = pose_at(0.5) if near else look_at(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    rows = []
    for _ in range(asked.runs):
        with nrs.Renderer(*SIZE, backend=asked.backend, streaming=True) as renderer:
            warmed(renderer)
            start = time.perf_counter()
            mesh = nrs.NaniteMesh.open(where)
            opened, head = time.perf_counter(), mesh.traffic
            frame = renderer.render(scene_of(mesh), CAMERA, pose)
            done, traffic, stream = time.perf_counter(), mesh.traffic, frame.stats.stream
            assert stream.settled
        read = traffic.read_bytes - head.read_bytes
        # Pages that came and were not needed are not told by name: those that are have the mean size.
        pages = read - (traffic.joined_bytes - head.joined_bytes)
        needed = pages * min(1.0, stream.needed_pages / max(stream.resident_pages, 1))
        transfer = (head.read_bytes + needed) / (asked.bandwidth * 1e6 / 8)
        rows.append(
            {
                "open: requests": head.requests,
                "open kB": head.read_bytes / 1e3,
                "open ms": (opened - start) * 1e3,
                "image: requests": traffic.requests - head.requests,
                "draws": stream.draws,
                "MB": read / 1e6,
                "of needed": read / max(needed, 1),
                "open to image ms": (done - start) * 1e3,
                "allowed ms": ROUND_TRIPS * asked.latency + transfer * 1e3,
            }
        )
    local = nrs.NaniteMesh.open(path)
    with nrs.Renderer(*SIZE, backend=asked.backend, streaming=True) as renderer:
        warmed(renderer)
        start = time.perf_counter()
        same = renderer.render(scene_of(local), CAMERA, pose)
        disk = (time.perf_counter() - start) * 1e3
    equal = all(
        np.array_equal(getattr(frame, n), getattr(same, n)) for n in ("color", "depth", "triangle_id")
    )
    out: dict[str, object] = {"triangles": len(mesh), "camera": "near" if near else "at a distance"}
    for key in rows[0]:
        value = float(np.median([row[key] for row in rows]))
        out[key] = round(value) if "requests" in key or key == "draws" else value
    return out | {"image from disk ms": disk, "image of the local file": equal}


def fly(where: str, name: str, folder: Path, asked: argparse.Namespace) -> dict[str, object]:
    """A flight by the clock that waits for nothing, after its first image is complete."""
    rows = []
    with nrs.Renderer(
        *SIZE, backend=asked.backend, streaming=True, pool_bytes=int(asked.pool * 2**20)
    ) as renderer:
        warmed(renderer)
        start = time.perf_counter()
        mesh = nrs.NaniteMesh.open(where, cache_dir=folder)
        scene = scene_of(mesh)
        renderer.render(scene, CAMERA, pose_at(0.0))
        first = time.perf_counter() - start
        before, begun = mesh.traffic, time.perf_counter()
        while (now := time.perf_counter()) < begun + asked.seconds:
            stream = renderer.render(
                scene, CAMERA, pose_at((now - begun) / asked.seconds), wait=False
            ).stats.stream
            took = time.perf_counter() - now
            rows.append((took * 1e3, max(stream.coarsest_pixels, 1.0), stream.refused_pages))
            time.sleep(max(0.0, PACE - took))
        traffic = mesh.traffic
    data = np.array(rows)
    return {
        "triangles": len(mesh),
        "flight": name,
        "open to image ms": first * 1e3,
        "frames": len(rows),
        "median ms": float(np.median(data[:, 0])),
        "99 % ms": float(np.quantile(data[:, 0], 0.99)),
        f"off by ≤ {PIXELS:.0f} px, %": 100 * float((data[:, 1] <= PIXELS).mean()),
        "median px": float(np.median(data[:, 1])),
        "99 % px": float(np.quantile(data[:, 1], 0.99)),
        "refused": int(data[:, 2].sum()),
        "requests": traffic.requests - before.requests,
        "failed": traffic.failed_requests - before.failed_requests,
        "MB read": (traffic.read_bytes - before.read_bytes) / 1e6,
        "MB cached": (traffic.cached_bytes - before.cached_bytes) / 1e6,
        "Mbit/s": (traffic.read_bytes - before.read_bytes) * 8e-6 / asked.seconds,
        "latency ms": traffic.latency_ms,
    }


def command(arguments: list[str]) -> str:
    """What was called, without where files lay."""
    out = ["python", "-m", "benchmarks.python.remote"]
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if not {before, argument} & {"--files", "--output"}:
            out.append(argument)
    return " ".join(out)


def main() -> None:
    """Command line."""
    if len(sys.argv) == 6 and sys.argv[1] == "serve":
        serve(Path(sys.argv[2]), float(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5]))
        return
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.remote", description=__doc__)
    parser.add_argument("--faces", type=float, nargs="+", default=[2e6], help="triangles of meshes")
    parser.add_argument("--latency", type=float, default=50, help="ms before each answer (%(default)s)")
    parser.add_argument("--bandwidth", type=float, default=100, help="Mbit/s of the line (%(default)s)")
    parser.add_argument(
        "--fail-every", type=int, default=0, help="of so many requests one is answered by 503"
    )
    parser.add_argument("--seconds", type=float, default=20, help="of a flight (%(default)s)")
    parser.add_argument("--pool", type=float, default=64, help="MiB of pages in a flight (%(default)s)")
    parser.add_argument("--runs", type=int, default=5, help="of the first image (%(default)s)")
    parser.add_argument("--backend", default="cpu", help="(%(default)s)")
    parser.add_argument("--files", type=Path, help="folder that keeps files from run to run")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    asked = parser.parse_args()
    images, flights, files = [], [], []
    with tempfile.TemporaryDirectory() as temporary:
        for faces in map(int, asked.faces):
            path = (asked.files or Path(temporary)) / f"{faces}.nanite"
            if not path.exists():
                path = saved(path.parent, faces)
            with served(path, asked) as where:
                images += [first_images(where, path, asked, near) for near in (False, True)]
                cache = Path(temporary) / f"pages of {faces}"
                flights += [fly(where, name, cache, asked) for name in ("from the server", "from the cache")]
            info = nrs.NaniteMesh.file_info(path)
            files.append(f"{info['faces']:,} in {info['bytes'] / 1e6:.1f} MB and {info['pages']:,} pages")
    here = machine.describe()
    told = f"one of {asked.fail_every} requests is" if asked.fail_every else "no request is"
    date = tables.today()
    lines = [
        f"# Meshes from a URL, {date}",
        "",
        f"`{command(sys.argv[1:])}`.",
        f"{here['processor']}, {here['cores']} cores, {here['memory_gib']} GiB, load {here['load']}. Triangles:",
        f"{'; '.join(files)}. A server on the same machine,",
        f"{asked.latency:.0f} ms before each answer, {asked.bandwidth:.0f} Mbit/s for all of them together; {told}",
        f"answered by 503. {SIZE[0]}×{SIZE[1]}, backend {asked.backend}.",
        "",
        "## First image, with an empty pool and no cache",
        "",
        f"Medians of {asked.runs}. *of needed*: bytes that came after opening, of those of pages that the image",
        f"needs; the aim is 1.3. *allowed*: {ROUND_TRIPS} latencies and the transfer of the head and of what",
        "is needed.",
        "",
        tables.table(images),
        f"## A flight of {asked.seconds:.0f} seconds with a pool of {asked.pool:.0f} MiB",
        "",
        f"At most {1 / PACE:.0f} frames a second, `wait=False`. The aim is 95 % of the frames off by",
        f"{PIXELS:.0f} pixels at most.",
        "",
        tables.table(flights),
    ]
    tables.publish(lines, asked.output, "remote")


if __name__ == "__main__":
    main()
