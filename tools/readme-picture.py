"""Draw the README's picture, docs/field.jpg: a field of knots, shaded and with a colour for each cluster.

`python tools/readme-picture.py [file]`, in an environment that has nanite_rs; prints what the caption says.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import nanite_rs as nrs

SIDE = 40
"""Instances along and across."""
BACKGROUND = (0.92, 0.93, 0.95)


def main(path: Path) -> None:
    """Build, draw, save and tell."""
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=1_000_000))
    random = np.random.default_rng(1)
    scene = nrs.Scene(ambient_light=(0.25, 0.25, 0.28), bg_color=(*BACKGROUND, 1.0))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((2.0, 4.0, 3.0), (0.0, 0.0, 0.0)))
    spacing = 1.5 * float(np.ptp(mesh.bounds, axis=0).max())
    for z in range(SIDE):
        for x in range(SIDE):
            about = nrs.look_at(random.normal(size=3), (0.0, 0.0, 0.0))[:3, :3]
            pose = np.eye(4)
            pose[:3, :3] = about
            pose[:3, 3] = ((x - SIDE / 2) * spacing, 0.0, -z * spacing)
            base = np.array((0.7, 0.55, 0.4)) + 0.1 * random.normal(size=3)
            color = (*np.clip(base, 0.05, 1.0), 1.0)
            material = nrs.Material(base_color=color, metallic=0.0, roughness=0.5)
            scene.add(mesh, pose=pose, material=material)
    eye = np.array((0.35 * spacing, 1.9 * spacing, 2.3 * spacing))
    pose = nrs.look_at(eye, eye + np.array((-0.15, -0.55, -2.0)))
    with nrs.Renderer(720, 480) as renderer:
        frame = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.7), pose, pixel_error=1.0, samples=4)
        stats = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.7), pose, pixel_error=1.0).stats
    shaded, clusters = frame.view("shaded"), frame.view("clusters")
    clusters[frame.instance_id < 0] = np.multiply(BACKGROUND, 255.0)
    Image.fromarray(np.concatenate([shaded, clusters], axis=1)).save(path, quality=88)
    total = SIDE**2 * len(mesh)
    print(f"{SIDE**2:,} knots of {len(mesh):,} triangles, {total:,} in all; drawn {stats.triangles:,}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/field.jpg"))
