"""What textures cost beside layers, triangles and materials, and how textured scenes look with fewer triangles.

Run as ``python -m benchmarks.python.materials [scene.glb …]``: the scenes given are drawn at several pixel errors
and compared with full detail. Prints Markdown.
"""

from __future__ import annotations

import statistics
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np

import nanite_rs as nrs

from . import machine

SIZE = (1280, 720)
RUNS = 9


def image(seed: int) -> nrs.Image:
    return nrs.Image(np.random.default_rng(seed).integers(0, 255, (512, 512, 3), np.uint8))


def textured(number: int) -> nrs.Material:
    """All five textures, of two images that no other material has."""
    colors, rest = nrs.Texture(image(2 * number)), nrs.Texture(image(2 * number + 1))
    return nrs.Material(
        base_color=(1, 1, 1),
        base_color_texture=colors,
        metallic_roughness_texture=rest,
        normal_texture=rest,
        occlusion_texture=rest,
        emissive_texture=colors,
        emissive=(0.1, 0.1, 0.1),
    )


def sheet(quads: int, materials: int = 1) -> nrs.NaniteMesh:
    """A square from -1 to 1, its columns of as many materials."""
    line = np.linspace(-1.0, 1.0, quads + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line))
    at = np.arange((quads + 1) ** 2).reshape(quads + 1, quads + 1)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    column = np.tile(np.arange(quads).repeat(2), quads)
    return nrs.NaniteMesh.from_arrays(
        np.stack([x, y, 0.05 * np.sin(9 * x) * np.cos(7 * y)], axis=1),
        faces,
        uvs=[np.stack([x, y], axis=1).astype(np.float32) * 2.0],
        face_materials=(column * materials // quads).astype(np.int32) if materials > 1 else None,
    )


def shade(scene: nrs.Scene, backend: str, **options: object) -> tuple[float, float]:
    """Milliseconds of shading, and of the frame: medians."""
    pose = np.eye(4)
    pose[2, 3] = 1.25
    shading, whole = [], []
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        for _ in range(RUNS):
            frame = renderer.render(
                scene, nrs.PerspectiveCamera(yfov=0.8), pose, outputs=["color"], shading="gltf", **options
            )
            shading.append(sum(s.ms for s in frame.stats.stages if s.stage == "shade"))
            whole.append(frame.stats.total_ms)
    return statistics.median(shading), statistics.median(whole)


def lit(*items: tuple[nrs.NaniteMesh, object, float]) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
    scene.add(nrs.DirectionalLight(intensity=3.0))
    for mesh, material, depth in items:
        pose = np.eye(4)
        pose[2, 3] = -depth
        # As large on the picture.
        pose[:2, :2] *= 1.0 + depth / 1.25
        scene.add(mesh, pose=pose, material=material)
    return scene


def table(title: str, head: list[str], rows: list[list[object]]) -> None:
    print(f"\n## {title}\n\n| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(f'{v:.1f}' if isinstance(v, float) else str(v) for v in row)} |")


def costs() -> None:
    plain, one = nrs.Material(), textured(0)
    mesh = sheet(60)
    rows = []
    for label, material in (("plain", plain), ("five textures", one)):
        scene = lit((mesh, material, 0.0))
        rows += [[label, backend, *shade(scene, backend)] for backend in ("cpu", "gpu")]
    for anisotropy in (1, 4, 16):
        texture = nrs.Texture(one.base_color_texture.image, anisotropy=anisotropy)
        material = nrs.Material(base_color_texture=texture)
        rows.append(
            [f"one texture, {anisotropy} samples at most", "cpu", *shade(lit((mesh, material, 0.0)), "cpu")]
        )
    table("Textures", ["material", "backend", "shading, ms", "frame, ms"], rows)
    rows = []
    for layers in (1, 10, 100):
        scene = lit(*((mesh, one, 0.02 * k) for k in range(layers)))
        rows.append([layers, *shade(scene, "cpu", occlusion=False), *shade(scene, "cpu")])
    head = ["layers", "shading, ms", "frame, ms", "with occlusion: shading, ms", "frame, ms"]
    table("Layers", head, rows)
    rows = []
    for quads in (30, 100, 300, 1000):
        scene = lit((sheet(quads), one, 0.0))
        rows.append([f"{2 * quads * quads:,}", *shade(scene, "cpu", pixel_error=0.0)])
    table("Triangles, at full detail", ["triangles", "shading, ms", "frame, ms"], rows)
    rows = []
    for count in (1, 10, 50, 200):
        scene = lit((sheet(200, count), [textured(k) for k in range(count)], 0.0))
        rows.append([count, *shade(scene, "cpu"), *shade(scene, "gpu")])
    head = ["materials", "CPU: shading, ms", "frame, ms", "GPU backend: shading, ms", "frame, ms"]
    table("Materials", head, rows)


def drawn(
    renderer: nrs.Renderer, scene: nrs.Scene, camera: nrs.Camera, pose: np.ndarray, error: float
) -> nrs.Frame:
    return renderer.render(scene, camera, pose, pixel_error=error, shading="gltf", transfer="srgb")


def coarser(paths: list[Path]) -> None:
    rows = []
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = nrs.load_scene(path)
        scene = loaded.scene
        scene.ambient_light = (0.25, 0.25, 0.25)
        camera, pose = loaded.view()
        scene.add(nrs.DirectionalLight(intensity=3.0), pose=pose)
        with nrs.Renderer(*SIZE, backend="cpu") as renderer:
            draw = partial(drawn, renderer, scene, camera, pose)
            whole = draw(0.0)
            row: list[object] = [path.stem, f"{whole.stats.triangles:,}"]
            near = draw(1.0)
            row += [f"{near.stats.triangles / whole.stats.triangles:.0%}", flip(near, whole)]
            for part in (0.5, 0.1):
                low, high = 1e-3, 1e3
                for _ in range(18):
                    middle = float(np.sqrt(low * high))
                    fewer = draw(middle).stats.triangles <= part * whole.stats.triangles
                    low, high = (low, middle) if fewer else (middle, high)
                frame = draw(high)
                row += [
                    f"{frame.stats.triangles / whole.stats.triangles:.0%} at {high:.2g} px",
                    flip(frame, whole),
                ]
        rows.append(row)
    head = ["scene", "triangles drawn", "at 1 px", "FLIP", "half", "FLIP", "a tenth", "FLIP"]
    table("Textured scenes with fewer triangles", head, rows)


def flip(frame: nrs.Frame, whole: nrs.Frame) -> str:
    """Mean over what is covered."""
    found = nrs.compare(frame.color, whole.color)
    return f"{found.flip_map[(frame.depth > 0) | (whole.depth > 0)].mean():.4f}"


if __name__ == "__main__":
    print(machine.describe())
    costs()
    coarser([Path(name) for name in sys.argv[1:]])
