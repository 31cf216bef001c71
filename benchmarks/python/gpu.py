"""The GPU backend beside its CPU twin, pyrender on OSMesa and Embree's rays: 1 M to 10 G triangles.

A scene is a crowd: ten instances of a mesh of 1 M triangles in front, two rows of five, and as many more such tens
behind each other as its triangles take. The camera stands so far away that they cover the same share of the
picture, and moves a degree every frame. What a real GPU takes is measured by the same command there.
"""

from __future__ import annotations

import numpy as np

import nanite_rs as nrs

from .frames import distance_for, one_light
from .measure import interleaved
from .peer import SIZE, YFOV, Pyrender, orbit

COVERAGE = 0.229
#: Instances of the scene that others draw, too, and of the largest.
FEW, MANY = 10, 10_000
#: Pixels of the picture, and instances of the scenes that are drawn by turns.
SCENES = {SIZE: (1, FEW, 100, MANY), (1920, 1080): (FEW, MANY), (3840, 2160): (FEW, MANY)}
BACKENDS = "cpu", "gpu"
DEVICE_STAGES = {"instance_cull", "node_cull", "cluster_cull", "raster_small", "raster_large", "hzb"}


def run(*, quick: bool) -> dict[str, object]:
    """One row per scene, and what others take for one of them; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000 if quick else 1_000_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    with nrs.Renderer(8, 8, backend="gpu") as renderer:
        device = renderer.backend_reason.removeprefix("asked for: ")
    rows, quotients = [], {}
    for size, counts in SCENES.items():
        stands = [Stand(mesh, count, size) for count in counts]
        calls = {(s.count, b): (lambda step, s=s, b=b: s.draw(b, step)) for s in stands for b in BACKENDS}
        times = interleaved(calls, runs=100, budget=90, warm_up=5)
        ms = {call: of["median"] * 1e3 for call, of in times.items()}
        rows += [stand.row(*(ms[stand.count, backend] for backend in BACKENDS)) for stand in stands]
        for backend in BACKENDS:
            quotients[f"{backend}, {_name(size)}"] = ms[MANY, backend] / ms[FEW, backend]
        for stand in stands:
            stand.close()
        if quick:
            break
    many, few = (f"{count * len(faces):,}" for count in (MANY, FEW))
    return {
        "rows": rows,
        "device": device,
        f"{many} triangles ÷ {few}, drawn by turns": quotients,
        "beside others": _beside_others(mesh, vertices, faces),
    }


def crowd(count: int) -> list[np.ndarray]:
    """Poses: tens of five columns and two rows, one behind the other."""
    poses = []
    for k in range(count):
        pose = np.eye(4)
        ten, place = divmod(k, 10)
        row, column = divmod(place, 5)
        pose[:3, 3] = 2.2 * (column - 2), 2.2 * (0.5 - row), -2.2 * ten
        poses.append(pose if count > 1 else np.eye(4))
    return poses


class Stand:
    """A crowd, a camera that moves around it, and a renderer of each backend."""

    def __init__(self, mesh: nrs.NaniteMesh, count: int, size: tuple[int, int]) -> None:
        self.count, self.size = count, size
        self.poses = crowd(count)
        self.scene, self.light = one_light()
        for pose in self.poses:
            self.scene.add(mesh, pose=pose)
        self.triangles = count * len(mesh)
        self.camera = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)
        self.renderers = {name: nrs.Renderer(*size, backend=name) for name in BACKENDS}

        def covered(distance: float) -> float:
            frame = self.renderers["cpu"].render(self.scene, self.camera, orbit(0, distance))
            return float((frame.depth > 0).mean())

        self.distance = distance_for(COVERAGE, covered, 1.5, 60.0)

    def draw(self, backend: str, step: int) -> tuple[np.ndarray, np.ndarray, nrs.Frame]:
        """The picture of a step, by a backend."""
        pose = orbit(step % 8, self.distance)
        self.light.pose = pose
        frame = self.renderers[backend].render(self.scene, self.camera, pose, pixel_error=1.0)
        return frame.color, frame.depth, frame

    def row(self, cpu: float, gpu: float) -> dict[str, object]:
        """A row of the table, from the milliseconds of a frame."""
        _, depth, frame = self.draw("gpu", 1)
        return {
            "triangles": self.triangles,
            "size": _name(self.size),
            "coverage": float((depth > 0).mean()),
            "cpu ms": cpu,
            "gpu ms": gpu,
            "of it on the device": sum(s.ms for s in frame.stats.stages if s.stage in DEVICE_STAGES),
            "clusters": frame.stats.clusters,
        }

    def close(self) -> None:
        """Frees what its renderers hold."""
        for renderer in self.renderers.values():
            renderer.close()


def _name(size: tuple[int, int]) -> str:
    return "×".join(str(n) for n in size)


def _beside_others(mesh, vertices, faces) -> dict[str, float]:
    """What pyrender and Embree take for ten meshes, and what we take by turns with them."""
    stand = Stand(mesh, FEW, SIZE)
    ours = {f"{name} ms": (lambda step, name=name: stand.draw(name, step)) for name in BACKENDS}
    peers = _peers(vertices, faces, stand.poses, stand.distance)
    calls = ours | {name: call for name, (call, _) in peers.items()}
    times = interleaved(calls, runs=9, budget=90, warm_up=3)
    stand.close()
    for _, close in peers.values():
        close()
    ms = {name: of["median"] * 1e3 for name, of in times.items()}
    return ms | {
        f"{peer.removesuffix(' ms')} ÷ {name}": ms[peer] / ms[f"{name} ms"]
        for peer in peers
        for name in BACKENDS
    }


def _peers(vertices, faces, poses, distance):
    """What draws the same frame in other ways: a call with the number of a step, and what frees it."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    whole = np.concatenate([vertices @ pose[:3, :3].T + pose[:3, 3] for pose in poses])
    indices = np.concatenate([faces + k * len(vertices) for k in range(len(poses))])
    normals = np.tile(vertices / np.linalg.norm(vertices, axis=1, keepdims=True), (len(poses), 1))
    peer = Pyrender(whole, indices, normals)
    hit = rtcore_scene.EmbreeScene()
    corners = TriangleMesh(hit, whole[indices].astype(np.float32))
    rows, columns = np.mgrid[0.5 : SIZE[1], 0.5 : SIZE[0]].astype(np.float32)
    focal = SIZE[1] / 2 / np.tan(YFOV / 2)
    local = np.stack([columns - SIZE[0] / 2, SIZE[1] / 2 - rows, np.full_like(rows, -focal)], -1).reshape(
        -1, 3
    )

    def rays(step: int):
        pose = orbit(step % 8, distance)
        directions = np.ascontiguousarray(local @ pose[:3, :3].T, np.float32)
        return hit.run(np.broadcast_to(pose[:3, 3], directions.shape).astype(np.float32), directions), corners

    return {
        "pyrender ms": (lambda step: peer.render(orbit(step % 8, distance)), peer.close),
        "Embree's rays ms": (rays, lambda: None),
    }
