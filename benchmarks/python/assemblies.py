"""A forest: ``python -m benchmarks.python.assemblies``.

A hundred thousand trees of ten thousand modelled leaves each are one assembly in a hundred thousand places. How
much memory opening takes, and frames from above, from its edge and from inside, with what became of the trees.
``--picture`` writes the three pictures.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import nanite_rs as nrs

SIZE = 1280, 720
TREES, LEAVES = 100_000, 10_000


def resident() -> int:
    """Bytes of this process in memory."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmRSS"))


def leaf() -> nrs.NaniteMesh:
    """A bent leaf of 12 cm, 240 triangles."""
    u, v = np.meshgrid(np.linspace(0, 1, 16), np.linspace(-1, 1, 9), indexing="ij")
    width = 0.03 * np.sin(np.pi * np.clip(u, 0.02, 0.98)) ** 0.8
    height = 0.02 * np.sin(3 * u) + 0.01 * v**2
    vertices = np.stack([0.12 * u, height, width * v], axis=-1).reshape(-1, 3)
    at = np.arange(16 * 9).reshape(16, 9)
    a, b, c, d = (x.reshape(-1) for x in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    green = nrs.Material(base_color=(0.10, 0.32, 0.05), double_sided=True, smooth=True)
    return nrs.NaniteMesh.from_arrays(vertices, faces, materials=green, progress=False)


def trunk() -> nrs.NaniteMesh:
    """A trunk of 5 m."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 33)[:-1], np.linspace(0, 5, 33), indexing="ij")
    radius = 0.22 - 0.035 * height + 0.01 * np.sin(5 * angle + height)
    vertices = np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=-1).reshape(-1, 3)
    at = np.arange(32 * 33).reshape(32, 33)
    a, b = at[:, :-1].reshape(-1), at[:, 1:].reshape(-1)
    d, c = np.roll(at, -1, 0)[:, :-1].reshape(-1), np.roll(at, -1, 0)[:, 1:].reshape(-1)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    brown = nrs.Material(base_color=(0.18, 0.10, 0.05), smooth=True)
    return nrs.NaniteMesh.from_arrays(vertices, faces, materials=brown, progress=False)


def turns(rng: np.random.Generator, count: int) -> np.ndarray:
    """Rotations, (N, 3, 3)."""
    return np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]


def tree(rng: np.random.Generator, leaves: int, far_triangles: int) -> nrs.Assembly:
    """A crown of leaves on a trunk."""
    points = rng.normal(size=(leaves, 3))
    points *= (rng.uniform(0.3, 1.0, (leaves, 1)) ** (1 / 3)) / np.linalg.norm(points, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (leaves, 1, 1))
    poses[:, :3, :3] = turns(rng, leaves)
    poses[:, :3, 3] = points * (1.8, 2.4, 1.8) + (0, 5.0, 0)
    return nrs.Assembly([(leaf(), poses), (trunk(), np.eye(4))], far_triangles=far_triangles, progress=False)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trees", type=int, default=TREES)
    parser.add_argument("--leaves", type=int, default=LEAVES)
    parser.add_argument("--far-triangles", type=int, default=500_000)
    parser.add_argument("--backend", default="cpu")
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(7)
    start, before = time.perf_counter(), resident()
    oak = tree(rng, options.leaves, options.far_triangles)
    built, parts = time.perf_counter() - start, resident() - before
    print(f"{oak!r}: {built:.1f} s, {oak.nbytes / 1e6:.0f} MB, memory grew by {parts / 1e6:.0f} MB")
    side = 5.0 * np.sqrt(options.trees)
    poses = np.tile(np.eye(4), (options.trees, 1, 1))
    angle, size = rng.uniform(0, 2 * np.pi, options.trees), rng.uniform(0.7, 1.3, options.trees)
    poses[:, 0, 0] = poses[:, 2, 2] = size * np.cos(angle)
    poses[:, 0, 2], poses[:, 2, 0] = size * np.sin(angle), -size * np.sin(angle)
    poses[:, 1, 1] = size
    poses[:, 0, 3], poses[:, 2, 3] = rng.uniform(-side / 2, side / 2, (2, options.trees))
    start, before = time.perf_counter(), resident()
    scene = nrs.Scene(ambient_light=(0.35, 0.38, 0.45), bg_color=(0.65, 0.78, 0.92))
    scene.add_many(oak, poses)
    scene.add(nrs.DirectionalLight(intensity=3.5), pose=nrs.look_at((3, 5, 2), (0, 0, 0)))
    half = side
    ground = nrs.TriangleMesh(
        np.array([[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]], np.float32),
        [[0, 2, 1], [0, 3, 2]],
    )
    scene.add(ground, material=nrs.Material(base_color=(0.16, 0.2, 0.08)))
    added, grown = time.perf_counter() - start, resident() - before
    print(
        f"{len(scene) - 1:,} trees, {(len(scene) - 1) * len(oak):,} meshes: {added:.2f} s, {grown / 1e6:.0f} MB"
    )
    camera = nrs.PerspectiveCamera(yfov=0.9, znear=0.1)
    nearest = poses[np.argmin(np.hypot(poses[:, 0, 3], poses[:, 2, 3])), :3, 3]
    views = {
        "inside": nrs.look_at(np.add(nearest, (0.6, 4.4, 3.0)), np.add(nearest, (0, 5, 0))),
        "at the edge": nrs.look_at((0, 4, side / 2 + 12), (0, 5, 0)),
        "from above": nrs.look_at((0, 120, side / 2 + 60), (0, 0, side / 4)),
    }
    with nrs.Renderer(*SIZE, backend=options.backend) as renderer:
        for name, pose in views.items():
            renderer.render(scene, camera, pose)
            times = []
            for step in range(3):
                moved = pose.copy()
                moved[0, 3] += 0.02 * step
                frame = renderer.render(scene, camera, moved)
                times.append(frame.stats.total_ms)
            print(f"{name}: {np.median(times):.0f} ms; {frame.stats.assemblies}")
            print(f"    {frame.stats.triangles:,} triangles, memory {resident() / 1e6:.0f} MB")
            if options.picture:
                frame.save(options.picture / f"{name.replace(' ', '_')}.png")


if __name__ == "__main__":
    main()
