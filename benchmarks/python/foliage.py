"""Trees as geometry against their cards: coverage from 1,000 pixels down to 8, and frames of 1,000 trees.

python -m benchmarks.python.foliage [--trees N]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import nanite_rs as nrs

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from oracles import cards, data  # noqa: E402
from oracles.camera import spread  # noqa: E402
from test_leaf_cards import REAL, outlines_within_a_pixel  # noqa: E402

SIZES = (1000, 256, 64, 32, 16, 8)
WHITE = nrs.Material(base_color=(1, 1, 1), unlit=True)


def sources() -> dict[str, nrs.foliage.Foliage]:
    out = {}
    for kind in ("bent", "many"):
        arrays = cards.tree(kind, 60)
        source = nrs.io.Source(**{**arrays, "uvs": [arrays["uvs"]]})
        out[f"generated, {kind}"] = lambda source=source: nrs.foliage.to_geometry(source)
    folder = data.shared()
    for name, given in REAL.items() if folder is not None else ():
        path = folder / "foliage" / name
        textures = None if given is None else {given[0]: path.parents[1] / "Textures" / given[1]}
        out[path.parts[len(folder.parts) + 1]] = lambda path=path, textures=textures: nrs.foliage.to_geometry(
            path, textures=textures
        )
    return out


def masked(tree: nrs.foliage.Foliage, mipmaps: str | None) -> dict:
    """The cards, alpha-tested."""
    source = tree._source
    looks = []
    for look, row in zip(source.materials, tree.report.materials, strict=True):
        if row.leaf:
            cutoff = look.alpha_cutoff if look.alpha_mode == "mask" else 0.5
            texture = replace(look.base_color_texture, mipmaps=mipmaps)
            look = replace(look, alpha_mode="mask", alpha_cutoff=cutoff, base_color_texture=texture)  # noqa: PLW2901
        looks.append(look)
    return drawn({**source.arrays(), "materials": tuple(looks)})


def drawn(arrays: dict) -> dict:
    return {k: v for k, v in arrays.items() if k not in ("channels", "face_channels")}


def white(looks: tuple) -> list:
    """As bright as nothing is behind them: pictures are coverage."""
    out = []
    for look in looks:
        made = WHITE
        if look.alpha_mode == "mask":
            texture = look.base_color_texture
            pixels = texture.image.pixels.copy()
            pixels[..., :-1] = np.iinfo(pixels.dtype).max
            texture = replace(texture, image=nrs.Image(pixels))
            made = replace(
                WHITE, alpha_mode="mask", alpha_cutoff=look.alpha_cutoff, base_color_texture=texture
            )
        out.append(replace(made, double_sided=True))
    return out


class Views:
    def __init__(self, vertices: np.ndarray) -> None:
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        self.center, self.size = (low + high) / 2, float(np.linalg.norm(high - low))

    def pictures(self, mesh, looks: tuple, pixels: int, pixel_error: float, samples: int) -> list[np.ndarray]:
        scene = nrs.Scene(bg_color=(0, 0, 0))
        scene.add(mesh, material=white(looks))
        lens = nrs.OrthographicCamera(0.55 * self.size, 0.55 * self.size, znear=0.01 * self.size)
        out = []
        with nrs.Renderer(pixels, pixels, backend="cpu") as renderer:
            for direction in spread(24):
                eye = self.center + 2 * self.size * direction
                pose = nrs.look_at(eye, self.center, (0.1, 1.0, 0.2))
                frame = renderer.render(scene, lens, pose, pixel_error=pixel_error, samples=samples)
                out.append(frame.linear[..., 0])
        return out


def coverage(name: str, make) -> nrs.NaniteMesh:
    start = time.perf_counter()
    tree = make()
    converted = time.perf_counter() - start
    start = time.perf_counter()
    mesh = tree.build(progress=False)
    built = time.perf_counter() - start
    before = sum(row.before for row in tree.report.materials)
    print(f"\n{name}: {before:,} triangles of cards, {len(tree.faces):,} made in {converted:.1f} s")
    print(tree.report)
    print(f"{len(mesh):,} faces built in {built:.1f} s, root {len(mesh.cut(error=np.inf)):,}")
    source = masked(tree, None)
    shots = Views(tree._source.vertices[np.unique(tree._source.faces)])
    exact = shots.pictures(nrs.TriangleMesh(**source), source["materials"], 1000, 0.0, 1)
    whole = shots.pictures(nrs.TriangleMesh(**drawn(tree.arrays())), tree.materials, 1000, 0.0, 1)
    parts = [outlines_within_a_pixel(a > 0.5, b > 0.5) for a, b in zip(exact, whole, strict=True)]
    ratios = [b.mean() / a.mean() for a, b in zip(exact, whole, strict=True)]
    print(
        f"full detail, 1000 px: coverage {min(ratios) - 1:+.2%} to {max(ratios) - 1:+.2%}, "
        f"outlines within a pixel {min(parts):.1%} or more"
    )
    for pixels in SIZES:
        ours = shots.pictures(mesh, tree.materials, pixels, 1.0, 16)
        mips = masked(tree, "linear")
        theirs = shots.pictures(nrs.TriangleMesh(**mips), mips["materials"], pixels, 0.0, 16)
        # The picture of 1,000 pixels averaged down covers the same part.
        each = [[b.mean() / a.mean() - 1 for a, b in zip(exact, c, strict=True)] for c in (ours, theirs)]
        print(
            f"  {pixels:5} px: levels {np.mean(each[0]):+.1%} ± {np.std(each[0]):.1%}, "
            f"cards with mip levels {np.mean(each[1]):+.1%} ± {np.std(each[1]):.1%}"
        )
    return mesh


def frames(name: str, make, count: int) -> None:
    """Medians of frames of so many trees on a plain: as geometry, as cards."""
    tree = make()
    options = nrs.BuildOptions(preserve_area=True)
    cards_ = masked(tree, "linear")
    meshes = {
        "geometry": tree.build(options=options, progress=False),
        "cards": nrs.NaniteMesh.from_arrays(**cards_, progress=False),
    }
    low, high = meshes["cards"].bounds
    size = float(np.linalg.norm(high - low))
    side = int(np.ceil(np.sqrt(count)))
    for shadows in (False, True):
        times, shown = {}, {}
        for what, mesh in meshes.items():
            scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3), bg_color=(0.8, 0.85, 0.9))
            rng = np.random.default_rng(0)
            for k in range(count):
                pose = np.eye(4)
                turn = rng.uniform(0, 2 * np.pi)
                pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
                pose[:3, 3] = (k % side - side / 2) * 0.7 * size, 0, -(k // side) * 0.7 * size
                scene.add(mesh, pose=pose)
            scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((3, 5, 2), (0, 0, 0)))
            eye = np.array([0, 0.6 * size, 1.2 * size])
            pose = nrs.look_at(eye, eye + np.array([0, -0.25, -1.0]))
            camera = nrs.PerspectiveCamera(yfov=0.8, znear=0.01 * size)
            with nrs.Renderer(1280, 720, backend="cpu") as renderer:
                spent = []
                for step in range(9):
                    moved = pose.copy()
                    moved[0, 3] += 0.002 * size * step
                    start = time.perf_counter()
                    frame = renderer.render(scene, camera, moved, shadows=shadows)
                    spent.append(time.perf_counter() - start)
            times[what] = statistics.median(spent[2:])
            shown[what] = frame
        ratio = times["geometry"] / times["cards"]
        print(
            f"{name}, {count:,} trees, shadows {shadows}: "
            + ", ".join(
                f"{k} {1e3 * v:.0f} ms ({shown[k].stats.triangles:,} triangles)" for k, v in times.items()
            )
            + f": {ratio:.2f}×"
        )
        folder = ROOT / "target" / "report" / "foliage"
        folder.mkdir(parents=True, exist_ok=True)
        for what, frame in shown.items():
            frame.save(folder / f"{name.replace(', ', '_')}_{what}_{'shadows' if shadows else 'plain'}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trees", type=int, default=1000)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    for name, make in sources().items():
        if arguments.only in name:
            coverage(name, make)
            frames(name, make, arguments.trees)


if __name__ == "__main__":
    main()
