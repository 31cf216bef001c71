"""Imposters against the cut for a pixel and the coarsest clusters: FLIP, silhouettes, memory, from 64 to 4 pixels.

python -m benchmarks.python.imposters [--only geometry]

All pictures have 16 samples a pixel, base colours lit by one light and some from everywhere, in linear light over
grey. The reference is full detail at 512 × 512, averaged down. FLIP is its mean over pixels that either covers.
A silhouette is the coverage of each pixel; its error the sum of all differences, by the reference's sum; the last
number of a cell is the difference of the sums. Names with "geometry" are trees of cards by `nrs.foliage`.

python -m benchmarks.python.imposters --cost [--counts 100_000 1_000_000] [--backend gpu]

The cost of so many instances, none before the other, each so many pixels large: depth alone of the mesh, of its
coarsest clusters, and of a quad, which is the least that an imposter costs. Each is drawn by a process of its own,
frame by frame in turn.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import nanite_rs as nrs
from nanite_rs import _colors

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from oracles import data  # noqa: E402

from . import foliage  # noqa: E402
from .memory import _status  # noqa: E402

if TYPE_CHECKING:
    from collections.abc import Iterator
    from multiprocessing.connection import Connection

SIZES = (64, 32, 16, 8, 4)
REFERENCE, SAMPLES = 512, 4
LIGHT = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
LEAVES = nrs.BuildOptions(preserve_area=True)
FILES = {
    "tree of cards": ("foliage/town_tree_cards/scene.gltf", LEAVES, False),
    "birch of cards": ("foliage/quaternius_birch_8_cards/OBJ/Birch_8.obj", LEAVES, False),
    "tree of modelled leaves": ("foliage/scatter_tree/tree.glb", LEAVES, False),
    "flowers in a vase": ("foliage/GlassVaseFlowers/GlassVaseFlowers.glb", LEAVES, True),
    "scan of a coral": (
        "scans/smithsonian_fossil_100k/USNM_1145291-150k-2048-medium-100k-2048_draco.glb",
        nrs.BuildOptions(),
        True,
    ),
}
COSTED = ("generated tree", "tree of modelled leaves", "geometry of quaternius_birch")
METHODS = ("imposter", "imposter, tested", "cut for a pixel", "coarsest clusters")


def directions(count: int, *, full: bool) -> np.ndarray:
    """Spread evenly over the sphere or its upper half: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    y = 1.0 - 2.0 * k / count if full else 1.0 - k / count
    around = np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - y * y)
    return np.stack([flat * np.cos(around), y, flat * np.sin(around)], axis=1)


def scenes(only: str) -> Iterator[tuple[str, nrs.Scene, bool]]:
    """Those with a part of their name: names, scenes, whether they are seen from below, too."""
    name = "generated tree, 40,000 triangles"
    if only in name:
        leaves = nrs.NaniteMesh.from_arrays(*nrs.shapes.foliage(faces=40_000), options=LEAVES)
        yield name, one(leaves, nrs.Material(base_color=(0.2, 0.45, 0.1), double_sided=True)), False
    shared = data.shared()
    if shared is None:
        print("real meshes are not there")
    for name, (path, options, full) in FILES.items() if shared is not None else ():
        if only not in name:
            continue
        scene = nrs.load_scene(shared / path, options=options).scene
        for node in scene.instances:
            looks = [node.material] if isinstance(node.material, nrs.Material) else node.material
            node.material = [tested(look) for look in looks]
        yield name, scene, full
    for name, make in foliage.sources().items():
        if only in f"geometry of {name}":
            tree = make()
            mesh = tree.build(progress=False)
            yield f"geometry of {name}", one(mesh, [tested(look) for look in tree.materials]), False


def one(mesh: nrs.NaniteMesh, material) -> nrs.Scene:
    scene = nrs.Scene()
    scene.add(mesh, material=material)
    return scene


def tested(look: nrs.Material) -> nrs.Material:
    """With holes where it blends, as imposters have them: blended surfaces have no depth."""
    return replace(look, alpha_mode="mask", alpha_cutoff=0.5) if look.alpha_mode == "blend" else look


def averaged(color: np.ndarray, alpha: np.ndarray, size: int) -> np.ndarray:
    """(size, size, 4) of larger pictures: light times alpha, and alpha."""
    light = np.concatenate([color * alpha[..., None], alpha[..., None]], axis=-1)
    times = len(light) // size
    return light.reshape(size, times, size, times, 4).mean(axis=(1, 3))


def lit(base: np.ndarray, normal: np.ndarray, *, unlit: bool) -> np.ndarray:
    return base if unlit else base * (0.3 + 0.7 * np.clip(normal @ LIGHT, 0.0, 1.0))[..., None]


def drawn(renderer: nrs.Renderer, scene: nrs.Scene, camera, pose, pixel_error: float, *, unlit: bool):
    """Lit colours and coverage of samples, and triangles."""
    outputs = ("depth", "base_color", "shading_normal")
    frame = renderer.render(scene, camera, pose, pixel_error=pixel_error, shading="gltf", outputs=outputs)
    covered = (frame.depth > 0).astype(np.float32)
    return lit(frame.base_color, frame.shading_normal, unlit=unlit), covered, frame.stats.triangles


def differences(ours: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """FLIP, the error of the silhouette, and that of all that is covered."""
    pictures = []
    for light in (ours, reference):
        over = light[..., :3] + 0.5 * (1.0 - light[..., 3:])
        pictures.append(np.rint(255.0 * _colors.to_srgb(np.clip(over, 0.0, 1.0))).astype(np.uint8))
    either = (ours[..., 3] > 0) | (reference[..., 3] > 0)
    flip = float(nrs.compare(*pictures).flip_map[either].mean())
    alpha = ours[..., 3], reference[..., 3]
    whole = float(alpha[1].sum())
    return flip, float(np.abs(alpha[0] - alpha[1]).sum()) / whole, float(alpha[0].sum()) / whole - 1.0


def root_bytes(scene: nrs.Scene) -> tuple[int, int]:
    """Triangles of the coarsest clusters of all meshes, and their bytes as plain arrays of 32 bits."""
    triangles = bytes_ = 0
    for mesh in {id(node.mesh): node.mesh for node in scene.instances}.values():
        cut = mesh.cut(error=np.inf)
        triangles += len(cut.faces)
        bytes_ += cut.faces.size * 4 + len(cut.vertices) * 4 * (6 + 2 * len(cut.uvs))
    return triangles, bytes_


def measure(
    name: str,
    scene: nrs.Scene,
    *,
    full: bool,
    count: int,
    views: int,
    size: int,
    unlit: bool,
    pixel_error: float,
) -> None:
    start = time.perf_counter()
    imposter = nrs.bake_imposter(scene, views=views, size=size, full_sphere=full)
    seconds = time.perf_counter() - start
    triangles, root = root_bytes(scene)
    whole = sum(len(node.mesh) for node in scene.instances)
    print(f"\n{name}: {whole:,} triangles; {imposter}, {imposter.nbytes:,} bytes, baked in {seconds:.1f} s; ")
    print(f"coarsest clusters: {triangles:,} triangles, {root:,} bytes")
    found = {method: {at: [] for at in SIZES} for method in METHODS}
    drawn_triangles = {at: [] for at in SIZES}
    camera = imposter.camera
    renderers = {at: nrs.Renderer(SAMPLES * at, SAMPLES * at, backend="cpu") for at in SIZES}
    with nrs.Renderer(REFERENCE, REFERENCE, backend="cpu") as fine:
        for direction in directions(count, full=full):
            pose = imposter.pose(direction)
            color, covered, _ = drawn(fine, scene, camera, pose, 0.0, unlit=unlit)
            for at in SIZES:
                reference = averaged(color, covered, at)
                picture = imposter.picture(camera, pose, SAMPLES * at, SAMPLES * at)
                light = lit(picture.base_color, picture.normal, unlit=unlit)
                near = drawn(renderers[at], scene, camera, pose, SAMPLES * pixel_error, unlit=unlit)
                coarse = drawn(renderers[at], scene, camera, pose, 1e30, unlit=unlit)
                drawn_triangles[at].append(near[2])
                pictures = {
                    "imposter": (light, picture.alpha),
                    "imposter, tested": (light, (picture.alpha >= 0.5).astype(np.float32)),
                    "cut for a pixel": near[:2],
                    "coarsest clusters": coarse[:2],
                }
                for method, layers in pictures.items():
                    found[method][at].append(differences(averaged(*layers, at), reference))
    for renderer in renderers.values():
        renderer.close()
    print("| pixels | triangles for a pixel | " + " | ".join(METHODS) + " |")
    print("|---|---|" + "---|" * len(METHODS))
    for at in SIZES:
        cells = []
        for method in METHODS:
            flip, outline, whole = np.mean(found[method][at], axis=0)
            cells.append(f"{flip:.3f}, {100 * outline:.1f} %, {100 * whole:+.1f} %")
        print(f"| {at} | {np.median(drawn_triangles[at]):,.0f} | " + " | ".join(cells) + " |", flush=True)


# -------------------------------------------------------------------------------------------- cost of instances

DRAWN = ("cut for a pixel", "coarsest clusters", "quad, opaque", "quad, tested")
SIDE_FROM = np.array([0.6, 0.5, 0.8])


def quad(imposter: nrs.Imposter, *, holes: bool) -> nrs.Scene:
    """Two triangles as large as a view of an imposter, facing `SIDE_FROM`, with its picture or without."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * imposter.radius
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    turn = imposter.pose(SIDE_FROM)[:3, :3]
    at = corners @ turn.T + imposter.center
    mesh = nrs.NaniteMesh.from_arrays(at, [[0, 1, 2], [0, 2, 3]], uvs=uvs, progress=False)
    near = np.unravel_index(np.argmax(imposter.directions @ SIDE_FROM), (imposter.views, imposter.views))
    texture = nrs.Texture(np.ascontiguousarray(imposter.layer("base_color")[near]))
    mask = nrs.Material(base_color_texture=texture, alpha_mode="mask", double_sided=True)
    return one(mesh, mask if holes else nrs.Material(double_sided=True))


def drawer(pipe: Connection, what: str, only: str, at: int, count: int, backend: str) -> None:
    """A process that draws so many instances whenever it is asked for a frame; then it says how long that took."""
    name, source, full = next(scenes(only))
    imposter = nrs.bake_imposter(source, views=12, size=64, full_sphere=full)
    if what.startswith("quad"):
        source = quad(imposter, holes=what == "quad, tested")
    pose, radius = imposter.pose(SIDE_FROM), imposter.radius
    nodes = [(node.mesh, node.material, node.pose) for node in source.instances]
    side = int(np.ceil(np.sqrt(count)))
    before, start = _status("VmRSS"), time.perf_counter()
    scene = nrs.Scene()
    for k in range(count):
        x, y = k % side - (side - 1) / 2, k // side - (side - 1) / 2
        for mesh, material, own in nodes:
            moved = own.copy()
            moved[:3, 3] += 2 * radius * (x * pose[:3, 0] + y * pose[:3, 1])
            scene.add(mesh, pose=moved, material=material)
    made = time.perf_counter() - start
    camera = nrs.OrthographicCamera(side * radius, side * radius, znear=radius / 2)
    error = 1e30 if what == "coarsest clusters" else 1.0
    with nrs.Renderer(side * at, side * at, backend=backend) as renderer:
        for step in iter(pipe.recv, None):
            # A picture of its own each time, by a part of a pixel.
            eye = pose.copy()
            eye[:3, 3] += 0.1 * step * radius / at * (pose[:3, 0] + pose[:3, 1])
            start = time.perf_counter()
            frame = renderer.render(scene, camera, eye, pixel_error=error, depth_only=True)
            assert (frame.depth > 0).any()
            seconds = time.perf_counter() - start
            stats = frame.stats
            rows = {"seconds": seconds, "clusters": stats.clusters, "triangles": stats.triangles}
            rows |= {"made": made, "grown": _status("VmRSS") - before, "name": name}
            if backend != "cpu" and step == 0:
                with nrs.Renderer(side * at, side * at, backend="cpu") as other:
                    theirs = other.render(scene, camera, eye, pixel_error=error, depth_only=True).depth
                rows["like the CPU's"] = bool(np.array_equal(frame.depth, theirs))
            rows["stages"] = {s.stage: stats[s.stage].ms for s in stats}
            del frame
            pipe.send(rows)


def cost(only: str, at: int, count: int, frames: int, backend: str) -> None:
    """A table of one mesh, size and number of instances."""
    context = multiprocessing.get_context("spawn")
    children = {}
    for what in DRAWN:
        ours, theirs = context.Pipe()
        child = context.Process(target=drawer, args=(theirs, what, only, at, count, backend))
        child.start()
        children[what] = child, ours
    found: dict[str, list[dict]] = {what: [] for what in DRAWN}
    for step in range(frames + 1):
        for what, (_, pipe) in children.items():
            pipe.send(step)
            found[what].append(pipe.recv())
    for child, pipe in children.values():
        pipe.send(None)
        child.join()
    name = found[DRAWN[0]][0]["name"]
    print(f"\n{name}, {count:,} instances of {at} pixels, {backend} backend, {frames} frames in turn")
    print("| drawn | frame, ms | µs an instance | beside the cut | clusters | triangles | memory |")
    print("|---|---|---|---|---|---|---|")
    times = {what: statistics.median(row["seconds"] for row in rows[1:]) for what, rows in found.items()}
    for what, rows in found.items():
        last, seconds = rows[-1], times[what]
        print(
            f"| {what} | {1e3 * seconds:,.0f} | {1e6 * seconds / count:.2f} | {seconds / times[DRAWN[0]]:.2f} "
            f"| {last['clusters']:,} | {last['triangles']:,} | {last['grown'] / 1e6:,.0f} MB |",
            flush=True,
        )
    for what, rows in found.items():
        stages = ", ".join(f"{stage} {ms:.0f}" for stage, ms in rows[-1]["stages"].items() if ms >= 0.5)
        alike = "".join(f", {k}: {rows[0][k]}" for k in rows[0] if k == "like the CPU's")
        print(f"  {what}: made in {rows[-1]['made']:.1f} s; {stages} ms{alike}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.imposters", description=__doc__)
    parser.add_argument("--directions", type=int, default=100, help="(%(default)s)")
    parser.add_argument("--views", type=int, default=12, help="of a side (%(default)s)")
    parser.add_argument("--size", type=int, default=64, help="texels of a view (%(default)s)")
    parser.add_argument("--unlit", action="store_true", help="base colours alone")
    parser.add_argument("--pixel-error", type=float, default=1.0, help="of the cut (%(default)s)")
    parser.add_argument("--only", default="", help="part of a name")
    parser.add_argument("--cost", action="store_true", help="instances instead of pictures")
    parser.add_argument("--counts", type=int, nargs="+", default=[100_000, 1_000_000], help="of instances")
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 4], help="pixels of an instance")
    parser.add_argument("--frames", type=int, default=5, help="(%(default)s)")
    parser.add_argument("--backend", default="cpu", help="of instances (%(default)s)")
    options = parser.parse_args()
    if options.cost:
        for name in [options.only] if options.only else COSTED:
            for count in options.counts:
                for at in options.sizes:
                    cost(name, at, count, options.frames, options.backend)
        return
    for name, scene, full in scenes(options.only):
        how = {"views": options.views, "size": options.size, "unlit": options.unlit}
        how["pixel_error"] = options.pixel_error
        measure(name, scene, full=full, count=options.directions, **how)


if __name__ == "__main__":
    main()
