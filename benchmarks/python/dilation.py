"""`preserve_area` against meshoptimizer's dilated borders, both with one thread: coverage, error, time.

python -m benchmarks.python.dilation

clusterlod.h of the crate meshopt is compiled with its sources into target/. Its cuts are those of one threshold for
the whole mesh; ours have as many triangles. Distances are those of samples of both surfaces, ten-thousandths of the
diagonal.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

import nanite_rs as nrs

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from oracles import cards, data  # noqa: E402
from oracles.distance import Surface  # noqa: E402
from test_foliage import coverage  # noqa: E402
from test_leaf_cards import REAL  # noqa: E402

PARTS = (0.5, 0.25, 0.1, 0.03, 0.01)
SAMPLES = 20_000


def compiled() -> Path:
    """The peer's program, compiled once."""
    program = ROOT / "target" / "clusterlod"
    source = Path(__file__).with_suffix(".py").parent / "clusterlod.cpp"
    if program.exists() and program.stat().st_mtime > source.stat().st_mtime:
        return program
    call = ["cargo", "metadata", "--format-version", "1", "--locked"]
    found = json.loads(subprocess.run(call, cwd=ROOT, capture_output=True, check=True).stdout)
    crate = next(Path(p["manifest_path"]).parent for p in found["packages"] if p["name"] == "meshopt")
    vendor = crate / "vendor"
    program.parent.mkdir(exist_ok=True)
    files = [source, *sorted((vendor / "src").glob("*.cpp"))]
    flags = ["-O3", "-DNDEBUG", "-std=c++17", f"-I{vendor / 'src'}", f"-I{vendor / 'demo'}"]
    subprocess.run(["c++", *flags, *files, "-o", program], check=True)
    return program


class Peer:
    """Clusters of clusterlod.h."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, *, dilate: bool) -> None:
        with tempfile.TemporaryDirectory() as folder:
            given, made = Path(folder, "in"), Path(folder, "out")
            head = np.array([len(vertices), faces.size], np.uint32).tobytes()
            given.write_bytes(
                head + vertices.astype(np.float32).tobytes() + faces.astype(np.uint32).tobytes()
            )
            subprocess.run([compiled(), given, made, str(int(dilate))], check=True)
            content = made.read_bytes()
        (self.seconds,) = struct.unpack_from("d", content)
        at, self.rows, self.triangles = 8, [], []
        while at < len(content):
            _, _, coarser, own, count = struct.unpack_from("iiffI", content, at)
            at += 20
            self.rows.append((coarser, own))
            self.triangles.append(np.frombuffer(content, np.float32, 9 * count, at).reshape(-1, 3, 3))
            at += 36 * count
        self._errors = np.array(self.rows)

    def cut(self, threshold: float) -> np.ndarray:
        """Triangles of the clusters that one threshold draws."""
        drawn = (self._errors[:, 0] > threshold) & (self._errors[:, 1] <= threshold)
        return np.concatenate([self.triangles[k] for k in np.flatnonzero(drawn)])

    def nearest(self, count: int) -> np.ndarray:
        """The cut with the next more triangles."""
        best = self.cut(0.0)
        for threshold in np.unique(self._errors[:, 1]):
            cut = self.cut(max(threshold, 0.0))
            if len(cut) < count:
                return best
            best = cut
        return best


def meshes() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    out = {"generated leaves": nrs.shapes.foliage(faces=100_000, seed=1)}
    for kind in ("bent", "many"):
        arrays = cards.tree(kind, 60)
        made = nrs.foliage.to_geometry(nrs.io.Source(**{**arrays, "uvs": [arrays["uvs"]]}))
        out[f"generated cards, {kind}"] = made.vertices, made.faces
    for path in data.folder_models("foliage"):
        if path.suffix == ".gz" or "cards" in str(path):
            continue
        read = replace(nrs.io.from_trimesh(trimesh.load(path, process=False)), materials=())
        out[path.relative_to(data.shared()).parts[1]] = read.vertices, read.faces
    for name, given in REAL.items():
        path = data.shared() / "foliage" / name if data.shared() else None
        if path is None or "Vase" in name:
            continue
        textures = None if given is None else {given[0]: path.parents[1] / "Textures" / given[1]}
        made = nrs.foliage.to_geometry(path, textures=textures, tolerance=4.0)
        out[name.split("/")[0]] = made.vertices, made.faces
    return {name: welded(*arrays) for name, arrays in out.items()}


def welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One vertex for each place, as float32: neither has attributes to look at."""
    points, rows = np.unique(np.asarray(vertices, np.float32), axis=0, return_inverse=True)
    faces = rows.reshape(-1)[faces].astype(np.int64)
    different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return points, faces[different]


def main() -> None:
    ours: list[float] = []
    theirs: list[float] = []
    for name, (vertices, faces) in meshes().items():
        used = vertices[np.unique(faces)].astype(float)
        center, diagonal = (used.min(0) + used.max(0)) / 2, float(np.linalg.norm(np.ptp(used, axis=0)))
        before = coverage(vertices, faces, center, diagonal)
        exact = Surface(vertices, faces)
        peers = {f"clusterlod{' dilated' * d}": Peer(vertices, faces, dilate=d) for d in (False, True)}
        built = {}
        for label, options in {
            "ours": nrs.BuildOptions(error="quadric", threads=1),
            "preserve_area": nrs.BuildOptions(error="quadric", preserve_area=True, threads=1),
            "preserve_area fast": nrs.BuildOptions(
                error="quadric", quality="fast", preserve_area=True, threads=1
            ),
        }.items():
            start = time.perf_counter()
            built[label] = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
            built[label, "s"] = time.perf_counter() - start
        print(
            f"\n{name}: {len(faces):,} triangles; "
            + ", ".join(f"{k} {p.seconds:.2f} s" for k, p in peers.items())
            + ", "
            + ", ".join(f"{k} {built[k, 's']:.2f} s" for k in built if isinstance(k, str))
        )
        for part in PARTS:
            cells = []
            counted = len(peers["clusterlod dilated"].nearest(int(part * len(faces))))
            if counted > 1.5 * part * len(faces) + 20:
                print(f"  {part:5.0%}: clusterlod ends at {counted:,} triangles")
                continue
            for label in (*peers, "ours", "preserve_area", "preserve_area fast"):
                if label in peers:
                    soup = peers[label].nearest(counted)
                    points, triangles = welded(soup.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3))
                else:
                    cut = built[label].cut(target_faces=counted)
                    points, triangles = cut.vertices, cut.faces
                ratio = coverage(points, triangles, center, diagonal) / before
                one = Surface(points, triangles)
                apart = np.concatenate(
                    [one.nearest(exact.samples(SAMPLES))[0], exact.nearest(one.samples(SAMPLES))[0]]
                )
                error = float(np.sqrt((apart**2).mean())) / diagonal
                cells.append(f"{label} {ratio.mean() - 1:+.1%} ± {ratio.std():.0%}, rms {1e4 * error:.1f}")
                if label == "clusterlod dilated":
                    theirs.append(abs(float(ratio.mean()) - 1))
                if label == "preserve_area":
                    ours.append(abs(float(ratio.mean()) - 1))
            print(f"  {part:5.0%}, {counted:,}: " + "; ".join(cells))
    print("\nhow far coverage is off, mean and most:")
    for label, each in (("preserve_area", ours), ("dilated borders", theirs)):
        print(f"  {label}: {np.mean(each):.2%}, {np.max(each):.1%}")


if __name__ == "__main__":
    main()
