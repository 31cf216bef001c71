"""Thousands of small pictures, colour and depth, beside pyrender's and MuJoCo's renderers (both on OSMesa).

``python -m benchmarks.python.batches``. Scenes of 10 to 1,000 instances of four meshes; views from all around.
MuJoCo takes part where it is installed (``pip install mujoco``).
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "osmesa")

import numpy as np

import nanite_rs as nrs

from . import machine, tables
from .peer import YFOV

RESULTS = Path(__file__).resolve().parents[1] / "results"
VIEWS = 4096
PEER_VIEWS = 96
"""Of the peers so many are enough to tell their rate."""
FACES = 320
CAMERA = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)


def placed(count: int) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray, np.ndarray]:
    """Four shapes, the places of instances, and the poses of cameras around all of them."""
    rng = np.random.default_rng(count)
    shapes = [
        nrs.shapes.icosphere(faces=FACES),
        nrs.shapes.torus_knot(faces=FACES),
        nrs.shapes.displaced_icosphere(faces=FACES),
        nrs.shapes.cad_part(faces=FACES),
    ]
    places = rng.uniform(-1, 1, (count, 3)) * 0.9 * np.cbrt(count)
    radius = 2.2 * np.cbrt(count) + 2.0
    directions = rng.normal(size=(VIEWS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return shapes, places, directions * radius


def ours(count: int, size: int) -> float:
    """Pictures per second."""
    shapes, places, eyes = placed(count)
    meshes = [nrs.TriangleMesh(*shape) for shape in shapes]
    scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
    for k, place in enumerate(places):
        pose = np.eye(4)
        pose[:3, 3] = place
        scene.add(meshes[k % 4], pose=pose)
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))
    items = [(scene, CAMERA, nrs.look_at(eye, (0, 0, 0))) for eye in eyes]
    with nrs.Renderer(size, size, backend="cpu") as renderer:
        renderer.render_batch(items[:64])
        rates = []
        for _ in range(3):
            start = time.perf_counter()
            renderer.render_batch(items)
            rates.append(len(items) / (time.perf_counter() - start))
    return float(np.median(rates))


def pyrenders(count: int, size: int) -> float:
    """Pictures per second."""
    import pyrender
    import trimesh

    shapes, places, eyes = placed(count)
    scene = pyrender.Scene(ambient_light=(0.2, 0.2, 0.2))
    for k, shape in enumerate(shapes):
        poses = np.tile(np.eye(4), (len(places[k::4]), 1, 1))
        poses[:, :3, 3] = places[k::4]
        mesh = trimesh.Trimesh(*shape, process=False)
        scene.add(pyrender.Mesh.from_trimesh(mesh, poses=poses))
    scene.add(pyrender.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))
    camera = scene.add(pyrender.PerspectiveCamera(yfov=YFOV, znear=0.05))
    renderer = pyrender.OffscreenRenderer(size, size)
    rates = []
    for first in range(0, PEER_VIEWS, PEER_VIEWS // 3):
        start = time.perf_counter()
        own = eyes[first : first + PEER_VIEWS // 3]
        for eye in own:
            scene.set_pose(camera, nrs.look_at(eye, (0, 0, 0)))
            renderer.render(scene)
        rates.append(len(own) / (time.perf_counter() - start))
    renderer.delete()
    return float(np.median(rates))


def mujocos(count: int, size: int) -> float:
    """Pictures per second, without multisampling and shadows."""
    import mujoco

    shapes, places, eyes = placed(count)
    text = ['<mujoco><visual><quality offsamples="0"/></visual><asset>']
    for k, (vertices, faces) in enumerate(shapes):
        rows = " ".join(f"{x:.6g}" for x in np.asarray(vertices).ravel())
        corners = " ".join(map(str, np.asarray(faces).ravel()))
        text.append(f'<mesh name="m{k}" vertex="{rows}" face="{corners}" inertia="shell"/>')
    text.append('</asset><worldbody><light directional="true" pos="0 0 9" dir="-1 -1 -2"/>')
    for k, place in enumerate(places):
        at = " ".join(f"{x:.6g}" for x in place)
        text.append(f'<geom type="mesh" mesh="m{k % 4}" pos="{at}" contype="0" conaffinity="0"/>')
    text.append("</worldbody></mujoco>")
    model = mujoco.MjModel.from_xml_string("".join(text))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, size, size, max_geom=count + 10)
    camera = mujoco.MjvCamera()
    rates = []
    for first in range(0, PEER_VIEWS, PEER_VIEWS // 3):
        start = time.perf_counter()
        own = eyes[first : first + PEER_VIEWS // 3]
        for x, y, z in own:
            camera.distance = float(np.sqrt(x * x + y * y + z * z))
            camera.azimuth = float(np.degrees(np.arctan2(y, x))) + 180.0
            camera.elevation = -float(np.degrees(np.arcsin(z / camera.distance)))
            renderer.disable_depth_rendering()
            renderer.update_scene(data, camera)
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            renderer.render()
            renderer.enable_depth_rendering()
            renderer.render()
        rates.append(len(own) / (time.perf_counter() - start))
    renderer.close()
    return float(np.median(rates))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.batches", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the smallest alone: to try it, not to quote")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    peers = {"pyrender": pyrenders}
    if importlib.util.find_spec("mujoco") is not None:
        peers["MuJoCo"] = mujocos
    rows = []
    for size in (64,) if options.quick else (64, 128):
        for count in (10,) if options.quick else (10, 100, 1000):
            row: dict[str, object] = {"picture": f"{size}×{size}", "meshes": count}
            rate = ours(count, size)
            rates = {name: peer(count, size) for name, peer in peers.items()}
            row |= {"nanite_rs, 1/s": rate} | {f"{name}, 1/s": own for name, own in rates.items()}
            rows.append(row | {"÷ the better": rate / max(rates.values())})
    here = machine.describe()
    date = tables.today()
    lines = [
        f"# Batches of small pictures, {date}" + (" (quick: not to quote)" if options.quick else ""),
        "",
        f"`python -m benchmarks.python.batches`. {here['processor']}, {here['cores']} cores,",
        f"{here['memory_gib']} GiB. {VIEWS:,} views, colour and depth, of instances of four meshes of some {FACES}",
        f"triangles, on the CPU backend; the peers draw {PEER_VIEWS} of them on OSMesa, pyrender with instancing,",
        "MuJoCo without shadows and multisampling, colour and depth in two pictures. Medians of three runs.",
        "" if "MuJoCo" in peers else "MuJoCo is not installed.",
        "",
        tables.table(rows),
    ]
    tables.publish(lines, options.output, "batches", quick=options.quick)


if __name__ == "__main__":
    main()
