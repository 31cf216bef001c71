"""Instances: 1, 10, 100 and 1,000 of one large mesh, together covering the same number of pixels.

The instances stand on a grid facing the camera, scaled so that the covered share of the image stays that of
one. pyrender on OSMesa draws the same as instances of one primitive, up to ten: beyond that a frame takes seconds.
"""

from __future__ import annotations

import numpy as np

import nanite_rs as nrs

from .frames import distance_for, one_light, stats, vertex_normals
from .measure import interleaved
from .peer import SIZE, YFOV, Pyrender, orbit

COVERAGE = 0.229
COUNTS = (1, 10, 100, 1000)
PEER_COUNTS = (1, 10)


def run(*, quick: bool) -> dict[str, object]:
    """One row per number of instances; all counts are timed in turn; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000 if quick else 1_000_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    camera = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)
    normals = vertex_normals(vertices, faces)
    scenes, renderers, distances, peers = {}, {}, {}, {}
    for count in COUNTS:
        scene, _ = one_light()
        for pose in _grid(count):
            scene.add(mesh, pose=pose)
        renderer = nrs.Renderer(*SIZE, backend="cpu")
        distances[count] = distance_for(
            COVERAGE,
            lambda d, s=scene, r=renderer: float((r.render(s, camera, _pose(0, d)).depth > 0).mean()),
            1.5,
            30.0,
        )
        scenes[count], renderers[count] = scene, renderer
        if count in PEER_COUNTS:
            peers[count] = Pyrender(vertices, faces, normals, _grid(count))

    def frame(count: int, step: int):
        result = renderers[count].render(scenes[count], camera, _pose(step, distances[count]))
        return result.color, result.depth, result

    times = interleaved(
        {str(count): (lambda step, c=count: frame(c, step)) for count in COUNTS}
        | {f"pyrender {c}": (lambda step, c=c: peers[c].render(_pose(step, distances[c]))) for c in peers},
        runs=3 if quick else 15,
        budget=60,
        warm_up=2,
    )
    rows = []
    for count in COUNTS:
        _, depth, last = frame(count, 0)
        rows.append(
            {
                "instances": count,
                "triangles in scene": count * len(faces),
                "coverage": float((depth > 0).mean()),
                "ms": times[str(count)]["median"] * 1e3,
                "times one": times[str(count)]["median"] / times["1"]["median"],
                "pyrender ms": times[f"pyrender {count}"]["median"] * 1e3 if count in peers else "",
                "stats": stats(last),
            }
        )
    for renderer in (*renderers.values(), *peers.values()):
        renderer.close()
    return {"mesh triangles": len(faces), "rows": rows}


def _grid(count: int) -> list[np.ndarray]:
    """Poses of ``count`` instances, scaled to fit, 16:9 columns to rows, without overlap."""
    columns = max(int(np.ceil(np.sqrt(count * 16 / 9))), 1) if count > 1 else 1
    rows = -(-count // columns)
    scale = 1 / np.sqrt(count)
    poses = []
    for i in range(count):
        pose = np.eye(4)
        pose[:3, :3] *= scale
        row, column = divmod(i, columns)
        pose[:3, 3] = 2.4 * scale * np.array([column - (columns - 1) / 2, (rows - 1) / 2 - row, 0.0])
        poses.append(pose)
    return poses


def _pose(step: int, distance: float) -> np.ndarray:
    """A camera that sways by a few degrees, so that no two frames are the same."""
    return orbit(step % 8, distance)
