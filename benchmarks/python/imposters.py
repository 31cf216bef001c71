"""Imposters against the cut for a pixel and the coarsest clusters: FLIP, silhouettes, memory, from 64 to 4 pixels.

python -m benchmarks.python.imposters

All pictures have 16 samples a pixel, base colours lit by one light and some from everywhere, in linear light over
grey. The reference is full detail at 512 × 512, averaged down. FLIP is its mean over pixels that either covers.
A silhouette is the coverage of each pixel; its error the sum of all differences, by the reference's sum.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import nanite_rs as nrs
from nanite_rs import _colors

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from oracles import data  # noqa: E402

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
METHODS = ("imposter", "imposter, tested", "cut for a pixel", "coarsest clusters")


def directions(count: int, *, full: bool) -> np.ndarray:
    """Spread evenly over the sphere or its upper half: a Fibonacci lattice."""
    k = np.arange(count) + 0.5
    y = 1.0 - 2.0 * k / count if full else 1.0 - k / count
    around = np.pi * (1.0 + 5.0**0.5) * k
    flat = np.sqrt(1.0 - y * y)
    return np.stack([flat * np.cos(around), y, flat * np.sin(around)], axis=1)


def scenes() -> dict[str, tuple[nrs.Scene, bool]]:
    out = {}
    scene = nrs.Scene()
    leaves = nrs.NaniteMesh.from_arrays(*nrs.shapes.foliage(faces=40_000), options=LEAVES)
    scene.add(leaves, material=nrs.Material(base_color=(0.2, 0.45, 0.1), double_sided=True))
    out["generated tree, 40,000 triangles"] = scene, False
    shared = data.shared()
    if shared is None:
        print("real meshes are not there")
        return out
    for name, (path, options, full) in FILES.items():
        scene = nrs.load_scene(shared / path, options=options).scene
        for node in scene.instances:
            looks = [node.material] if isinstance(node.material, nrs.Material) else node.material
            node.material = [tested(look) for look in looks]
        out[name] = scene, full
    return out


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


def differences(ours: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """FLIP and the error of the silhouette."""
    pictures = []
    for light in (ours, reference):
        over = light[..., :3] + 0.5 * (1.0 - light[..., 3:])
        pictures.append(np.rint(255.0 * _colors.to_srgb(np.clip(over, 0.0, 1.0))).astype(np.uint8))
    either = (ours[..., 3] > 0) | (reference[..., 3] > 0)
    flip = float(nrs.compare(*pictures).flip_map[either].mean())
    alpha = ours[..., 3], reference[..., 3]
    return flip, float(np.abs(alpha[0] - alpha[1]).sum() / alpha[1].sum())


def root_bytes(scene: nrs.Scene) -> tuple[int, int]:
    """Triangles of the coarsest clusters of all meshes, and their bytes as plain arrays of 32 bits."""
    triangles = bytes_ = 0
    for mesh in {id(node.mesh): node.mesh for node in scene.instances}.values():
        cut = mesh.cut(error=np.inf)
        triangles += len(cut.faces)
        bytes_ += cut.faces.size * 4 + len(cut.vertices) * 4 * (6 + 2 * len(cut.uvs))
    return triangles, bytes_


def measure(
    name: str, scene: nrs.Scene, *, full: bool, count: int, views: int, size: int, unlit: bool
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
                near = drawn(renderers[at], scene, camera, pose, float(SAMPLES), unlit=unlit)
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
            flip, outline = np.mean(found[method][at], axis=0)
            cells.append(f"{flip:.3f}, {100 * outline:.1f} %")
        print(f"| {at} | {np.median(drawn_triangles[at]):,.0f} | " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.imposters", description=__doc__)
    parser.add_argument("--directions", type=int, default=100, help="(%(default)s)")
    parser.add_argument("--views", type=int, default=12, help="of a side (%(default)s)")
    parser.add_argument("--size", type=int, default=64, help="texels of a view (%(default)s)")
    parser.add_argument("--unlit", action="store_true", help="base colours alone")
    parser.add_argument("--only", default="", help="part of a name")
    options = parser.parse_args()
    for name, (scene, full) in scenes().items():
        if options.only in name:
            how = {"views": options.views, "size": options.size, "unlit": options.unlit}
            measure(name, scene, full=full, count=options.directions, **how)


if __name__ == "__main__":
    main()
