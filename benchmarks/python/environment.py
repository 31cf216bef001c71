"""Shading beside VTK's physically based renderer, by a light and by an environment, and what a map costs.

Run as ``python -m benchmarks.python.environment [--pictures FOLDER] [scene.gltf …]`` with VTK, which the tests
need as well. A grid of balls, metallic 0, 0.5 and 1 down, roughness 0.1 to 1 to the right, and the
scenes given, as each package loads them. Both write light through the power 1/2.2 to 8 bits, without tone mapping;
pictures are compared as sRGB. Prints Markdown.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np

import nanite_rs as nrs

from . import machine

SIZE = (960, 480)
METALLIC = (0.0, 0.5, 1.0)
ROUGHNESS = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
BASE = (0.8, 0.5, 0.25)
RUNS = 9


def sky(rows: int, sun: float) -> np.ndarray:
    """A map: a blue sky, a brown ground, a window, and a sun of about 6 degrees."""
    height, turn = np.meshgrid(
        np.pi * (0.5 - (np.arange(rows) + 0.5) / rows),
        2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows) - np.pi,
        indexing="ij",
    )
    up = np.clip(0.5 + 4.0 * np.sin(height), 0.0, 1.0)[..., None]
    light = up * [0.25, 0.35, 0.5] + (1.0 - up) * [0.16, 0.12, 0.08]
    light[(np.abs(height - 0.5) < 0.3) & (np.abs(turn + 2.2) < 0.35)] = 1.2
    direction = np.stack(
        [np.cos(height) * np.cos(turn), np.sin(height), np.cos(height) * np.sin(turn)], axis=-1
    )
    towards = np.array([0.45, 0.6, 0.66]) / np.linalg.norm([0.45, 0.6, 0.66])
    light[direction @ towards > np.cos(np.radians(3.0))] += sun
    return light.astype(np.float32)


def balls() -> list[tuple[tuple[float, float, float], float, float]]:
    """Place, metallic and roughness of each."""
    return [
        ((2.1 * (column - 3.0), 2.1 * (1.0 - row), 0.0), metallic, roughness)
        for row, metallic in enumerate(METALLIC)
        for column, roughness in enumerate(ROUGHNESS)
    ]


class Vtk:
    """A scene in VTK."""

    def __init__(self) -> None:
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")
        import vtk

        self.vtk = vtk
        self.window = vtk.vtkRenderWindow()
        self.window.SetOffScreenRendering(1)
        self.window.SetMultiSamples(0)
        self.window.SetSize(*SIZE)
        self.renderer = vtk.vtkRenderer()
        self.window.AddRenderer(self.renderer)
        self.renderer.SetBackground(0.0, 0.0, 0.0)
        self.renderer.AutomaticLightCreationOff()

    def add_ball(self, vertices: Any, faces: Any, place: Any, metallic: float, roughness: float) -> None:
        from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

        vtk = self.vtk
        points = vtk.vtkPoints()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices, np.float32), deep=1))
        cells = vtk.vtkCellArray()
        cells.SetData(3, numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, np.int64).ravel(), deep=1))
        data = vtk.vtkPolyData()
        data.SetPoints(points)
        data.SetPolys(cells)
        data.GetPointData().SetNormals(numpy_to_vtk(np.ascontiguousarray(vertices, np.float32), deep=1))
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(data)
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.SetPosition(*place)
        look = actor.GetProperty()
        look.SetInterpolationToPBR()
        look.SetColor(*BASE)
        look.SetMetallic(metallic)
        look.SetRoughness(roughness)
        self.renderer.AddActor(actor)

    def load(self, path: Path) -> None:
        importer = self.vtk.vtkGLTFImporter()
        importer.SetFileName(os.fspath(path))
        importer.SetRenderWindow(self.window)
        importer.Update()
        self.renderer = importer.GetRenderer()
        self.renderer.AutomaticLightCreationOff()
        self.renderer.RemoveAllLights()
        self.renderer.SetBackground(0.0, 0.0, 0.0)

    def light(self, towards: Any, intensity: float) -> None:
        light = self.vtk.vtkLight()
        light.SetLightTypeToSceneLight()
        light.SetPositional(False)
        light.SetPosition(*towards)
        light.SetFocalPoint(0.0, 0.0, 0.0)
        light.SetIntensity(intensity)
        self.renderer.AddLight(light)

    def surround(self, image: np.ndarray) -> None:
        from vtk.util.numpy_support import numpy_to_vtk

        vtk = self.vtk
        data = vtk.vtkImageData()
        data.SetDimensions(image.shape[1], image.shape[0], 1)
        # Its rows go up.
        flat = np.ascontiguousarray(image[::-1].reshape(-1, 3), np.float32)
        data.GetPointData().SetScalars(numpy_to_vtk(flat, deep=1))
        texture = vtk.vtkTexture()
        texture.SetInputData(data)
        texture.SetColorModeToDirectScalars()
        texture.MipmapOn()
        texture.InterpolateOn()
        self.renderer.UseImageBasedLightingOn()
        # Nine coefficients ring where there is a sun.
        self.renderer.UseSphericalHarmonicsOff()
        self.renderer.SetEnvironmentTexture(texture, False)
        specular = self.renderer.GetEnvMapPrefiltered()
        specular.SetPrefilterMaxSamples(256)
        specular.SetPrefilterLevels(5)

    def render(self, distance: float, center: Any, yfov: float) -> np.ndarray:
        from vtk.util.numpy_support import vtk_to_numpy

        camera = self.renderer.GetActiveCamera()
        camera.SetPosition(center[0], center[1], center[2] + distance)
        camera.SetFocalPoint(*center)
        camera.SetViewUp(0.0, 1.0, 0.0)
        # Not parallel: VTK's highlights are then those of perspective all the same.
        camera.SetViewAngle(np.degrees(yfov))
        self.renderer.ResetCameraClippingRange()
        self.window.Render()
        grab = self.vtk.vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.ReadFrontBufferOff()
        grab.Update()
        pixels = vtk_to_numpy(grab.GetOutput().GetPointData().GetScalars())
        return pixels.reshape(SIZE[1], SIZE[0], -1)[::-1, :, :3].copy()


def facing(towards: Any) -> np.ndarray:
    """A pose whose +Z points there."""
    z = np.asarray(towards, float) / np.linalg.norm(towards)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return pose


def srgb(picture: np.ndarray) -> np.ndarray:
    """From the power 1/2.2 to sRGB."""
    light = (picture / 255.0) ** 2.2
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055).clip(0, 1)


def row(name: str, ours: np.ndarray, theirs: np.ndarray, covered: np.ndarray, folder: Path | None) -> None:
    """A row of the table: over the pixels well inside what is covered."""
    from PIL import Image
    from scipy import ndimage

    inside = ndimage.binary_erosion(covered, iterations=2)
    a, b = srgb(ours), srgb(theirs)
    a, b = np.where(inside[..., None], a, 0.0), np.where(inside[..., None], b, 0.0)
    found = nrs.compare(a, b)
    square = float(((a - b)[inside] ** 2).mean())
    light = [(p[inside].astype(float) / 255.0) ** 2.2 for p in (ours, theirs)]
    ratio = light[0].mean() / light[1].mean()
    psnr = -10.0 * np.log10(square)
    print(f"| {name} | {psnr:.1f} | {found.flip / inside.mean():.4f} | {ratio:.3f} |", flush=True)
    if folder:
        stem = name.replace(", ", "-").replace(" ", "_")
        both = np.concatenate([ours, theirs, (np.abs(a - b) * 255 * 4).clip(0, 255).astype(np.uint8)])
        Image.fromarray(both).save(folder / f"{stem}.png")


def grid(kind: str, folder: Path | None) -> None:
    vertices, faces = nrs.shapes.icosphere(faces=20_480)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, progress=False)
    scene = nrs.Scene(bg_color=(0, 0, 0))
    other = Vtk()
    for place, metallic, roughness in balls():
        pose = np.eye(4)
        pose[:3, 3] = place
        scene.add(mesh, pose=pose, material=nrs.Material(BASE, metallic=metallic, roughness=roughness))
        other.add_ball(vertices, faces, place, metallic, roughness)
    lit(scene, other, kind)
    pose = np.eye(4)
    pose[2, 3] = 10.0
    yfov = float(2.0 * np.arctan(0.4))
    camera = nrs.PerspectiveCamera(yfov=yfov)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, camera, pose, pixel_error=0.0, shading="gltf")
    picture = other.render(10.0, (0.0, 0.0, 0.0), yfov)
    row(f"balls, {kind}", frame.color, picture, frame.depth > 0, folder)
    print("\n| metallic | " + " | ".join(f"roughness {r}" for r in ROUGHNESS) + " |")
    print("|---|" + "---|" * len(ROUGHNESS))
    for row_of, metallic in enumerate(METALLIC):
        cells = []
        for column in range(len(ROUGHNESS)):
            inside = frame.instance_id == row_of * len(ROUGHNESS) + column
            ours, theirs = ((p[inside] / 255.0) ** 2.2 for p in (frame.color, picture))
            off = np.sqrt(((ours - theirs) ** 2).mean()) / theirs.mean()
            cells.append(f"{off:.3f}, {ours.mean() / theirs.mean():.3f}")
        print(f"| {metallic} | {' | '.join(cells)} |")
    print("\n| picture | PSNR, dB | FLIP | mean light, ours by VTK's |\n|---|---|---|---|")


def lit(scene: nrs.Scene, other: Vtk, kind: str) -> None:
    if kind == "light":
        towards = (0.5, 0.7, 0.8)
        scene.add(nrs.DirectionalLight(intensity=2.5), pose=facing(towards))
        other.light(towards, 2.5)
    else:
        image = sky(128, 30.0 if "sun" in kind else 0.0)
        other.surround(image)
        scene.environment = nrs.Environment(image)


def asset(path: Path, kind: str, folder: Path | None) -> None:
    loaded = nrs.load_scene(path)
    scene, other = loaded.scene, Vtk()
    for light in loaded.lights:
        light.remove()
    scene.bg_color = (0, 0, 0)
    other.load(path)
    lit(scene, other, kind)
    x0, x1, y0, y1, z0, z1 = other.renderer.ComputeVisiblePropBounds()
    center = np.array([x0 + x1, y0 + y1, z0 + z1]) / 2
    yfov = 0.6
    distance = (z1 - z0) / 2 + max(y1 - y0, (x1 - x0) * SIZE[1] / SIZE[0]) * 0.55 / np.tan(yfov / 2)
    pose = np.eye(4)
    pose[:3, 3] = center + np.array([0.0, 0.0, distance])
    camera = nrs.PerspectiveCamera(yfov=yfov, znear=distance * 0.01)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, camera, pose, pixel_error=0.0, shading="gltf")
    picture = other.render(distance, center, yfov)
    row(f"{path.stem}, {kind}", frame.color, picture, frame.depth > 0, folder)


def costs() -> None:
    print("\n| map, rows | made in, ms |\n|---|---|")
    nrs.Scene(environment=nrs.Environment(np.ones((2, 4), np.float32)))
    for rows in (32, 256, 1024, 2048):
        image = nrs.Image(sky(rows, 30.0))
        start = time.perf_counter()
        nrs.Scene(environment=nrs.Environment(image))
        print(f"| {rows:,} | {1e3 * (time.perf_counter() - start):.0f} |", flush=True)
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_480), progress=False)
    pose = np.eye(4)
    pose[2, 3] = 1.3
    print("\n| shading of 1280 × 720 | ms |\n|---|---|")
    maps = {"a light": None, "and an environment": nrs.Environment(sky(256, 30.0))}
    maps["seen behind it as well"] = nrs.Environment(sky(256, 30.0), background=True)
    with nrs.Renderer(1280, 720, backend="cpu") as renderer:
        for name, environment in maps.items():
            scene = nrs.Scene(environment=environment)
            scene.add(nrs.DirectionalLight(intensity=2.0))
            scene.add(mesh)
            times = []
            for _ in range(RUNS):
                frame = renderer.render(
                    scene, nrs.PerspectiveCamera(yfov=0.8), pose, outputs=["color"], shading="gltf"
                )
                times.append(frame.stats["shade"].ms)
            print(f"| {name} | {statistics.median(times):.1f} |", flush=True)


def main() -> None:
    """Compare, and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path, help="ours, VTK's, and four times the difference")
    parser.add_argument("scenes", nargs="*", type=Path)
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    print(f"{machine.describe()}\n")
    print("| picture | PSNR, dB | FLIP | mean light, ours by VTK's |\n|---|---|---|---|")
    kinds = ("light", "sky", "sky with a sun")
    for kind in kinds:
        grid(kind, options.pictures)
    for path in options.scenes:
        for kind in kinds[:2]:
            asset(path, kind, options.pictures)
    costs()


if __name__ == "__main__":
    main()
