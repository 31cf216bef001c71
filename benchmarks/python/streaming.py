"""Meshes that stay in their files: the first image of 10 M triangles, and a flight along 20 M with a small pool.

Each backend opens a file that no pool knows yet; the system has it in its cache, as a machine has a file that was
just written: reading costs decoding and not a disk. ``make bench-streaming`` also draws the flight as a plot.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import nanite_rs as nrs

from . import machine, tables
from .peer import SIZE, YFOV

POOL = 64 << 20
FRAMES = 600
#: Hold the image of a frame to 60 a second.
PACE = 1 / 60
PAGE_BYTES = 128 * 1024
CAMERA = nrs.PerspectiveCamera(yfov=YFOV, znear=0.001)


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera-to-world pose."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross((0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, eye
    return pose


def pose_at(t: float) -> np.ndarray:
    """Where a flight is after such a part of it: from a distance down to the surface, along it, and away again."""
    height = 0.06 + 2.5 * (0.5 + 0.5 * np.cos(2 * np.pi * t)) ** 3
    angle = 5.0 * t
    out = np.array([np.cos(angle), 0.25 * np.sin(3 * angle), np.sin(angle)])
    out /= np.linalg.norm(out)
    along = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    eye = (1.0 + height) * out
    return look_at(eye, (1.0 - 0.2 * height) * out + 0.5 * along / (1.0 + height))


def scene_of(mesh: nrs.NaniteMesh) -> nrs.Scene:
    """The mesh and a light."""
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    scene.add(mesh)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=look_at(np.array([3.0, 4, 5]), np.zeros(3)))
    return scene


def saved(folder: Path, faces: int) -> Path:
    """A file of a generated mesh."""
    path = folder / f"{faces}.nanite"
    options = nrs.BuildOptions(quality="fast", error="quadric")
    arrays = nrs.shapes.displaced_icosphere(faces=faces)
    nrs.NaniteMesh.from_arrays(*arrays, options=options, progress=False).save(path)
    return path


def backends() -> list[str]:
    """Those that are there."""
    try:
        nrs.Renderer(8, 8, backend="gpu").close()
    except nrs.BackendError:
        return ["cpu"]
    return ["cpu", "gpu"]


def first_image(path: Path, backend: str, runs: int) -> dict[str, object]:
    """Opening, the first frame, and the first that is complete, with an empty pool; medians of runs."""
    pose = look_at(np.array([0.0, 0.0, 3.0]), np.zeros(3))
    times = []
    for run in range(runs + 1):
        with nrs.Renderer(*SIZE, backend=backend, streaming=True) as renderer:
            # Kernels are compiled, threads started.
            small = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=2000), progress=False)
            renderer.render(scene_of(small), CAMERA, pose)
            start = time.perf_counter()
            mesh = nrs.NaniteMesh.open(path)
            opened = time.perf_counter()
            scene = scene_of(mesh)
            first = renderer.render(scene, CAMERA, pose, wait=False)
            drawn = time.perf_counter()
            frame = renderer.render(scene, CAMERA, pose)
            done = time.perf_counter()
            assert not first.stats.stream.settled
            assert frame.stats.stream.settled
        if run > 0:
            times.append((opened - start, drawn - opened, done - start))
    open_ms, first_ms, total_ms = np.median(np.array(times) * 1e3, axis=0)
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        whole = renderer.render(scene_of(mesh), CAMERA, pose)
    equal = all(
        np.array_equal(getattr(frame, n), getattr(whole, n)) for n in ("color", "depth", "triangle_id")
    )
    stream = frame.stats.stream
    return {
        "triangles": len(mesh),
        "backend": backend,
        "open ms": open_ms,
        "first frame ms": first_ms,
        "open to complete image ms": total_ms,
        "pages": stream.resident_pages,
        "MiB of the pool": stream.pool_bytes / 2**20,
        "frames until complete": stream.draws,
        "image of the whole mesh": equal,
    }


def fly(path: Path, backend: str, frames: int) -> tuple[dict[str, object], np.ndarray]:
    """A flight at a steady pace that waits for nothing; figures, and columns over frames."""
    mesh = nrs.NaniteMesh.open(path)
    scene = scene_of(mesh)
    rows = []
    with nrs.Renderer(*SIZE, backend=backend, streaming=True, pool_bytes=POOL) as renderer:
        for t in np.linspace(0.0, 1.0, frames):
            pose = pose_at(t)
            start = time.perf_counter()
            frame = renderer.render(scene, CAMERA, pose, wait=False)
            took = time.perf_counter() - start
            s = frame.stats.stream
            hit = 1.0 - s.missing_pages / max(s.needed_pages, 1)
            row = (took * 1e3, s.arrived_pages, s.evicted_pages, hit, s.coarsest_pixels, s.pool_bytes / 2**20)
            rows.append((*row, s.refused_pages, s.needed_pages))
            time.sleep(max(0.0, PACE - took))
    data = np.array(rows[1:])  # the first has nothing but the root
    return {
        "triangles": len(mesh),
        "backend": backend,
        "frames": frames,
        "median ms": float(np.median(data[:, 0])),
        "99 % ms": float(np.quantile(data[:, 0], 0.99)),
        "longest ms": float(data[:, 0].max()),
        "pages that arrived per frame": float(data[:, 1].mean()),
        "at most": int(data[:, 1].max()),
        "needed pages there, %": 100 * float(1 - (data[:, 7] * (1 - data[:, 3])).sum() / data[:, 7].sum()),
        "frames with all of them, %": 100 * float((data[:, 3] == 1.0).mean()),
        "refused": int(data[:, 6].sum()),
        "error median px": float(np.median(np.maximum(data[:, 4], 1.0))),
        "error 99 % px": float(np.quantile(np.maximum(data[:, 4], 1.0), 0.99)),
        "MiB of the pool, most": float(data[:, 5].max()),
    }, data


def plot(flights: dict[str, np.ndarray], path: Path) -> None:
    """Frame times, pages and hits over the frames."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(4, 1, figsize=(9, 9), sharex=True)
    for name, data in flights.items():
        at = np.arange(1, len(data) + 1)
        axes[0].plot(at, data[:, 0], label=name, linewidth=0.8)
        axes[1].plot(at, data[:, 1], label=name, linewidth=0.8)
        axes[2].plot(at, 100 * data[:, 3], label=name, linewidth=0.8)
        axes[3].plot(at, np.maximum(data[:, 4], 1.0), label=name, linewidth=0.8)
    labels = ("frame, ms", "pages arrived", "needed pages there, %", "error, pixels")
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_ylim(0, None)
    axes[3].set_yscale("log")
    axes[0].legend()
    axes[-1].set_xlabel("frame")
    figure.suptitle(
        f"20 M triangles, {SIZE[0]}×{SIZE[1]}, a pool of {POOL >> 20} MiB, 60 frames a second at most"
    )
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.streaming", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller meshes: to try it, not to quote")
    parser.add_argument("--files", type=Path, help="folder that keeps the files from run to run")
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parents[1] / "results")
    options = parser.parse_args()
    ten, twenty = (100_000, 200_000) if options.quick else (10_000_000, 20_000_000)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.files or Path(temporary)
        paths = {n: folder / f"{n}.nanite" for n in (ten, twenty)}
        paths = {n: path if path.exists() else saved(folder, n) for n, path in paths.items()}
        images = [first_image(paths[ten], backend, 5) for backend in backends()]
        flown = {backend: fly(paths[twenty], backend, FRAMES) for backend in backends()}
        info = nrs.NaniteMesh.file_info(paths[twenty])
    here = machine.describe()
    flights = [figures for figures, _ in flown.values()]
    date = tables.today()
    fill = 100 * info["page_bytes"] / (info["pages"] * PAGE_BYTES)
    lines = [
        f"# Streaming, {date}" + (" (quick: not to quote)" if options.quick else ""),
        "",
        f"`make bench-streaming`. {here['processor']}, {here['cores']} cores, {here['memory_gib']} GiB.",
        f"Files of displaced icospheres in the system's cache, {info['bytes'] / info['faces']:.2f} bytes per",
        f"triangle; 20 M triangles lie in {info['pages']:,} pages, {fill:.0f} % full.",
        "",
        "## First image, with an empty pool",
        "",
        tables.table(images),
        f"## A flight of {FRAMES} frames with a pool of {POOL >> 20} MiB",
        "",
        tables.table(flights),
    ]
    options.output.mkdir(parents=True, exist_ok=True)
    stem = options.output / f"{date}-streaming{'-quick' if options.quick else ''}"
    try:
        plot({name: data for name, (_, data) in flown.items()}, stem.with_suffix(".png"))
        lines += [f"![frames of the flight]({stem.name}.png)", ""]
    except ImportError as error:
        lines += [f"No plot: {error}.", ""]
    text = "\n".join(lines)
    stem.with_suffix(".md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
