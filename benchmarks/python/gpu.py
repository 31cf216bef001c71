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
FULL_HD, FOUR_K = (1920, 1080), (3840, 2160)
#: Instances, and pixels of the picture.
SCENES = (
    (1, SIZE),
    (10, SIZE),
    (100, SIZE),
    (10_000, SIZE),
    (10, FULL_HD),
    (10_000, FULL_HD),
    (10, FOUR_K),
    (10_000, FOUR_K),
)
PEERS = 10, SIZE
DEVICE_STAGES = {"instance_cull", "node_cull", "cluster_cull", "raster_small", "raster_large", "hzb"}


def run(*, quick: bool) -> dict[str, object]:
    """One row per scene; JSON-ready."""
    vertices, faces = nrs.shapes.displaced_icosphere(faces=50_000 if quick else 1_000_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    with nrs.Renderer(8, 8, backend="gpu") as renderer:
        device = renderer.backend_reason.removeprefix("asked for: ")
    rows = [_row(mesh, vertices, faces, *scene) for scene in (SCENES[:4] if quick else SCENES)]
    by_scene = {(row["triangles"], row["size"]): row for row in rows}
    small, large = ((n * len(faces), "1280×720") for n in (10, 10_000))
    ratio = by_scene[large]["gpu ms"] / by_scene[small]["gpu ms"]
    return {"rows": rows, "device": device, "gpu, most triangles ÷ ten meshes": ratio}


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


def _row(mesh, vertices, faces, count: int, size: tuple[int, int]) -> dict[str, object]:
    scene, light = one_light()
    poses = crowd(count)
    for pose in poses:
        scene.add(mesh, pose=pose)
    camera = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)
    renderers = {name: nrs.Renderer(*size, backend=name) for name in ("cpu", "gpu")}

    def ours(name: str, step: int):
        pose = orbit(step % 8, distance)
        light.pose = pose
        frame = renderers[name].render(scene, camera, pose, pixel_error=1.0)
        return frame.color, frame.depth, frame

    distance = 1.0

    def share(distance: float) -> float:
        return float((renderers["cpu"].render(scene, camera, orbit(0, distance)).depth > 0).mean())

    distance = distance_for(COVERAGE, share, 1.5, 60.0)
    contestants = {name: (lambda step, n=name: ours(n, step)) for name in renderers}
    peers = _peers(vertices, faces, poses, distance) if (count, size) == PEERS else {}
    times = interleaved(contestants | {n: p for n, (p, _) in peers.items()}, runs=9, budget=90, warm_up=3)
    ms = {name: t["median"] * 1e3 for name, t in times.items()}
    _, depth, frame = ours("gpu", 1)
    on_device = sum(s.ms for s in frame.stats.stages if s.stage in DEVICE_STAGES)
    for renderer in renderers.values():
        renderer.close()
    for _, close in peers.values():
        close()
    return {
        "triangles": count * len(faces),
        "size": "×".join(str(n) for n in size),
        "coverage": float((depth > 0).mean()),
        "cpu ms": ms["cpu"],
        "gpu ms": ms["gpu"],
        "of it on the device": on_device,
        "clusters": frame.stats.clusters,
        "pyrender ÷ gpu": ms["pyrender"] / ms["gpu"] if peers else "",
        "pyrender ÷ cpu": ms["pyrender"] / ms["cpu"] if peers else "",
        "Embree's rays ÷ gpu": ms["rays"] / ms["gpu"] if peers else "",
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
        "pyrender": (lambda step: peer.render(orbit(step % 8, distance)), peer.close),
        "rays": (rays, lambda: None),
    }
