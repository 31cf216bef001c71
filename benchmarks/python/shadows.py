"""Shadows: frames with a sun that stands or moves beside frames without, pyrender's, and Embree's rays.

``python -m benchmarks.python.shadows``. The camera moves in every frame: pages that it does not leave are kept.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import nanite_rs as nrs

from . import machine, tables
from .frames import vertex_normals
from .measure import interleaved
from .peer import SIZE, YFOV, Pyrender

RESULTS = Path(__file__).resolve().parents[1] / "results"
CAMERA = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)
SHADOWS = {"without": False, "standing": True, "moving": True, "cascades": "cascaded"}
"""Frames: without shadows, with a sun that stands or moves, and with one that stands and has cascades."""


def floor(half: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """A square."""
    corners = half * np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], np.float64)
    return corners + np.array([0.0, height, 0.0]), np.array([[0, 1, 2], [0, 2, 3]])


def sun(step: int) -> np.ndarray:
    """A degree a step."""
    around = np.radians(40.0 + step)
    return nrs.look_at((np.sin(around), 0.9, np.cos(around)), (0, 0, 0))


def eye(step: int, distance: float, height: float) -> np.ndarray:
    """A little to the side in every step."""
    return nrs.look_at((0.02 * step, height, distance), (0.02 * step, 0, 0))


def grid(count: int) -> list[np.ndarray]:
    """Tens of five columns and two rows, one behind the other."""
    poses = []
    for k in range(count):
        ten, row, column = k // 10, k % 10 // 5, k % 5
        pose = np.eye(4)
        if count > 1:
            pose[:3, 3] = 2.2 * (column - 2.0), 2.2 * (0.5 - row), -2.2 * ten
        poses.append(pose)
    return poses


class Ours:
    """A scene of instances on a floor, drawn in each of the ways."""

    def __init__(self, mesh: nrs.NaniteMesh, count: int, distance: float) -> None:
        self.scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
        for pose in grid(count):
            self.scene.add(mesh, pose=pose)
        self.scene.add(nrs.NaniteMesh.from_arrays(*floor(60.0, -2.3)))
        self.sun = self.scene.add(nrs.DirectionalLight(intensity=3.0), pose=sun(0))
        self.distance = distance
        self.renderers = {name: nrs.Renderer(*SIZE, backend="cpu") for name in SHADOWS}

    def frame(self, name: str, step: int, *, occlusion: bool = True) -> nrs.Frame:
        """A frame in one of the ways."""
        pose = sun(step if name == "moving" else 0)
        if name == "moving" or not np.array_equal(self.sun.pose, pose):
            self.sun.pose = pose
        view = eye(step, self.distance, 1.5)
        return self.renderers[name].render(
            self.scene, CAMERA, view, shadows=SHADOWS[name], occlusion=occlusion, outputs=["color"]
        )

    def processor_ms(self, name: str, runs: int, *, occlusion: bool = True) -> float:
        """What all cores together spend on a frame, whatever else runs."""
        times = []
        for step in range(runs + 2):
            start = time.process_time()
            self.frame(name, step, occlusion=occlusion).color  # noqa: B018
            times.append(time.process_time() - start)
        return float(np.median(times[2:])) * 1e3

    def row(self, what: str, runs: int) -> dict[str, object]:
        """Medians of all in turn, and what the last frames say."""
        names = list(self.renderers)
        calls = {name: (lambda step, name=name: self.frame(name, step).color) for name in names}
        times = interleaved(calls, runs=runs, warm_up=2, budget=60)
        ms = {name: times[name]["median"] * 1e3 for name in names}
        kept, drawn, cascades = (self.frame(name, runs).stats.shadows for name in names[1:])
        self.cascades = {
            "scene": what,
            "pages": cascades.drawn_pages,
            "texels, of a unit": ", ".join(f"1/{1 / cascade.texel:g}" for cascade in cascades.cascades),
            "instances left out": cascades.culled_instances,
            "clusters left out": cascades.culled_clusters,
            "clusters drawn": cascades.clusters,
            "triangles drawn": cascades.triangles,
            "drawing ms": cascades.draw_ms,
        }
        # Without what is known of the frame before, then without any of it.
        self.renderers["cascades"].close()
        self.renderers["cascades"] = nrs.Renderer(*SIZE, backend="cpu")
        for name, occlusion in (("first frame", True), ("all", False)):
            stats = self.frame("cascades", runs, occlusion=occlusion).stats.shadows
            self.cascades |= {f"{name}: clusters": stats.clusters, f"{name}: ms": stats.draw_ms}
        for name in names:
            self.cascades[f"{name}: processor ms"] = self.processor_ms(name, runs)
        self.cascades["all: processor ms"] = self.processor_ms("cascades", runs, occlusion=False)
        return {
            "scene": what,
            "without ms": ms["without"],
            "standing sun ms": ms["standing"],
            "× without": ms["standing"] / ms["without"],
            "moving sun ms": ms["moving"],
            "moving × without": ms["moving"] / ms["without"],
            "cascades ms": ms["cascades"],
            "cascades × without": ms["cascades"] / ms["without"],
            "pages wanted": drawn.wanted_pages,
            "of them kept": f"{1 - kept.drawn_pages / kept.wanted_pages:.0%}",
            "triangles into pages": drawn.triangles,
        }


def soft(mesh: nrs.NaniteMesh, count: int, runs: int) -> list[dict[str, object]]:
    """The same scene under suns of several sizes and numbers of rays, standing."""
    ours = Ours(mesh, count, 9.0 if count > 1 else 4.0)
    suns = [(0.0, 1), *((angle, samples) for angle in (0.53, 2.0) for samples in (8, 32))]
    renderers = {key: nrs.Renderer(*SIZE, backend="cpu") for key in suns}

    def frame(step: int, angle: float, samples: int) -> nrs.Frame:
        ours.sun.light = nrs.DirectionalLight(intensity=3.0, angle=np.radians(angle))
        return renderers[angle, samples].render(
            ours.scene,
            CAMERA,
            eye(step, ours.distance, 1.5),
            shadows=True,
            shadow_samples=samples,
            outputs=["color"],
        )

    calls = {str(key): (lambda step, key=key: frame(step, *key).color) for key in suns}
    times = interleaved(calls, runs=runs, warm_up=2, budget=90)
    sharp = times[str((0.0, 1))]["median"] * 1e3
    rows = []
    for angle, samples in suns:
        shadow = frame(runs, angle, samples).shadow
        ms = times[str((angle, samples))]["median"] * 1e3
        rows.append(
            {
                "sun": f"{angle}°" if angle else "sharp",
                "rays": samples,
                "ms": ms,
                "more than sharp, ms": ms - sharp,
                "of pixels in penumbra": f"{((shadow > 0) & (shadow < 1)).mean():.1%}",
            }
        )
    return rows


class Embree:
    """A ray from each pixel, and one from what it hits to the sun."""

    def __init__(self, parts: list[tuple[np.ndarray, np.ndarray]]) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.scene = rtcore_scene.EmbreeScene()
        self.mesh = TriangleMesh(self.scene, np.concatenate([v[f] for v, f in parts]).astype(np.float32))

    def render(self, pose: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Which pixels the sun reaches."""
        high, wide = SIZE[1], SIZE[0]
        focal = 0.5 * high / np.tan(0.5 * YFOV)
        y, x = np.mgrid[:high, :wide] + 0.5
        local = np.stack([(x - wide / 2) / focal, (high / 2 - y) / focal, -np.ones_like(x)], -1).reshape(
            -1, 3
        )
        ways = np.ascontiguousarray(local @ pose[:3, :3].T, np.float32)
        origins = np.ascontiguousarray(np.broadcast_to(pose[:3, 3], ways.shape), np.float32)
        hit = self.scene.run(origins, ways, output=True)
        rows = np.flatnonzero(np.asarray(hit["primID"]) >= 0)
        points = origins[rows] + ways[rows] * np.asarray(hit["tfar"])[rows, None] * np.float32(0.9999)
        suns = np.ascontiguousarray(np.broadcast_to(towards, points.shape), np.float32)
        return np.asarray(self.scene.run(np.ascontiguousarray(points, np.float32), suns)) == -1


def against_peers(faces: int, runs: int) -> list[dict[str, object]]:
    """One mesh on a floor, by all."""
    import pyrender

    mesh = nrs.shapes.displaced_icosphere(faces=faces)
    ground = floor(60.0, -2.3)
    ours = Ours(nrs.NaniteMesh.from_arrays(*mesh, progress=False), 1, 4.0)
    peer = Pyrender(*mesh, vertex_normals(*mesh))
    square = pyrender.Primitive(
        positions=ground[0].astype(np.float32),
        normals=np.tile(np.float32([0, 1, 0]), (4, 1)),
        indices=ground[1],
    )
    peer.scene.add(pyrender.Mesh([square]))
    rays = Embree([mesh, ground])

    def theirs(step: int, flags: int) -> object:
        peer.scene.set_pose(peer.camera, eye(step, 4.0, 1.5))
        peer.scene.set_pose(peer.light, sun(0))
        return peer.renderer.render(peer.scene, flags=flags)

    calls = {
        "nanite_rs, no shadows": lambda step: ours.frame("without", step).color,
        "nanite_rs, a standing sun": lambda step: ours.frame("standing", step).color,
        "nanite_rs, a moving sun": lambda step: ours.frame("moving", step).color,
        "nanite_rs, cascades": lambda step: ours.frame("cascades", step).color,
        "pyrender, no shadows": lambda step: theirs(step, 0),
        "pyrender, shadows": lambda step: theirs(step, pyrender.RenderFlags.SHADOWS_DIRECTIONAL),
        "Embree, a ray to see and one to the sun": lambda step: rays.render(
            eye(step, 4.0, 1.5), sun(0)[:3, 2]
        ),
    }
    times = interleaved(calls, runs=runs, warm_up=2, budget=90)
    peer.close()
    still = times["nanite_rs, a standing sun"]["median"]
    return [
        {"what": name, "ms": time["median"] * 1e3, "× a standing sun": time["median"] / still}
        for name, time in times.items()
    ]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.shadows", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="smaller meshes: to try it, not to quote")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    faces, runs = (50_000, 3) if options.quick else (1_000_000, 15)
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=faces), progress=False)
    rows, cascades = [], []
    for count, distance in ((1, 4.0), (10, 9.0), (10_000, 9.0)):
        ours = Ours(mesh, count, distance)
        rows.append(ours.row(f"{count:,} instances, {count * faces / 1e6:,.4g} M triangles", runs))
        cascades.append(ours.cascades)
    sizes = soft(mesh, 10, runs)
    peers = against_peers(faces // 4, runs)
    here = machine.describe()
    date = tables.today()
    lines = [
        f"# Shadows, {date}" + (" (quick: not to quote)" if options.quick else ""),
        "",
        f"`python -m benchmarks.python.shadows`. {here['processor']}, {here['cores']} cores,",
        f"{here['memory_gib']} GiB. {SIZE[0]}×{SIZE[1]}, one pixel of error, sharp shadows of one sun, on the CPU",
        "backend. The camera moves in every frame. Medians of runs in turn.",
        "",
        tables.table(rows),
        "## Cascades, and what they leave out",
        "",
        tables.table(cascades),
        "## Soft shadows: 10 instances, a sun that stands",
        "",
        tables.table(sizes),
        f"## One mesh of {faces // 4:,} triangles on a floor, against peers",
        "",
        tables.table(peers),
    ]
    tables.publish(lines, options.output, "shadows", quick=options.quick)


if __name__ == "__main__":
    main()
