"""Frames: a displaced icosphere over 22.9 % of 1280×720, against pyrender on OSMesa.

Colour and depth are read back by both; the camera moves one degree every frame; both see the same normals
and one directional light. Runs are interleaved: first one renders the pose, then the other.
"""

from __future__ import annotations

import time

import numpy as np

import nanite_rs as nrs

from .measure import interleaved
from .peer import SIZE, YFOV, Pyrender, orbit

COVERAGE = 0.229
SIZES = (70_000, 250_000, 1_000_000, 5_000_000, 10_000_000)


def run(*, quick: bool) -> dict[str, object]:
    """One row per size; JSON-ready."""
    rows = [_row(size, runs=3 if quick else 9) for size in (SIZES[:2] if quick else SIZES)]
    drivers = {row.pop("driver") for row in rows}
    return {
        "width": SIZE[0],
        "height": SIZE[1],
        "pyrender's driver": ", ".join(sorted(drivers)),
        "rows": rows,
    }


def _row(size: int, *, runs: int) -> dict[str, object]:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=size)
    start = time.perf_counter()
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    build = time.perf_counter() - start
    start = time.perf_counter()
    normals = vertex_normals(vertices, faces)
    peer = Pyrender(vertices, faces, normals)
    scene, light = one_light()
    scene.add(mesh)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        camera = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)

        def ours(step: int, pixel_error: float = 1.0):
            pose = orbit(step, distance)
            light.pose = pose
            return renderer.render(scene, camera, pose, pixel_error=pixel_error)

        distance = 1.0
        distance = distance_for(COVERAGE, lambda d: _covered(renderer, scene, camera, d), 1.5, 12.0)
        peer.render(orbit(0, distance))
        driver = peer.driver()
        upload = time.perf_counter() - start
        times = interleaved(
            {
                "nanite_rs": lambda step: _read(ours(step)),
                "nanite_rs full detail": lambda step: _read(ours(step, 0.0)),
                "pyrender": lambda step: peer.render(orbit(step, distance)),
            },
            runs=runs,
            budget=90,
        )
        frame = ours(0)
        row = {
            "triangles": len(faces),
            "coverage": float((frame.depth > 0).mean()),
            "nanite_rs ms": times["nanite_rs"]["median"] * 1e3,
            "pyrender ms": times["pyrender"]["median"] * 1e3,
            "times faster": times["pyrender"]["median"] / times["nanite_rs"]["median"],
            "full detail ms": times["nanite_rs full detail"]["median"] * 1e3,
            "build s": build,
            "pyrender set-up s": upload,
            "runs": times["nanite_rs"]["runs"],
            "stats": stats(frame),
            "driver": driver,
        }
    peer.close()
    return row


def one_light():
    """A scene with the light that pyrender's side has too."""
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1), bg_color=(0.0, 0.0, 0.0))
    light = scene.add(nrs.DirectionalLight(intensity=3.0), pose=np.eye(4))
    return scene, light


def stats(frame: nrs.Frame) -> dict[str, float]:
    """What the frame says about itself."""
    return frame.stats.as_dict()


def distance_for(coverage: float, covered, low: float, high: float) -> float:
    """The distance at which ``covered(distance)`` is the given share of the image, by bisection."""
    for _ in range(18):
        middle = (low + high) / 2
        if covered(middle) > coverage:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _covered(renderer, scene, camera, distance: float) -> float:
    return float((renderer.render(scene, camera, orbit(0, distance)).depth > 0).mean())


def _read(frame) -> tuple[np.ndarray, np.ndarray]:
    return frame.color, frame.depth


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted vertex normals, float32."""
    t = vertices[faces]
    face = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    total = np.stack(
        [sum(np.bincount(faces[:, c], face[:, k], len(vertices)) for c in range(3)) for k in range(3)], axis=1
    )
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)).astype(np.float32)
