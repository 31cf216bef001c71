"""Shadows of lights that have a size, against rays of Embree to all of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import ndimage

import nanite_rs as nrs
from oracles.shadows import CAMERA, Rays, ball, plates, placed, points_of, scan, scene_of, sheets, street, terrain, trees

SIZE = 640, 360
RAYS = 16
"""Rays to the light along each side of its disk."""


def of_size(light, degrees):
    """A light that is seen at about an angle, and its radius, or that at distance 1."""
    radius = math.tan(math.radians(0.5 * degrees))
    if isinstance(light, nrs.DirectionalLight):
        return nrs.DirectionalLight(intensity=3.0, angle=math.radians(degrees)), radius
    radius *= 5.0
    if isinstance(light, nrs.SpotLight):
        return nrs.SpotLight(intensity=20.0, outerConeAngle=light.outerConeAngle, radius=radius), radius
    return nrs.PointLight(intensity=8.0, radius=radius), radius


def differences(make, degrees, number, **options):
    """Ours less theirs where a light is seen in part, so far inside that shadow's edge that a pixel beside it makes no
    difference; and where it is not seen in part, how many pixels are wrong by more than a tenth."""
    meshes, lights, pose = make()
    light, place = lights[number]
    light, radius = of_size(light, degrees)
    scene = scene_of(meshes, [(light, place)])
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERA, pose, shadows=True, outputs=["depth", "normal"], **options)
        source = renderer.render(
            scene_of(meshes, [], smooth=False), CAMERA, pose, pixel_error=0.0, outputs=["depth", "normal"]
        )
    ours = frame.shadow[..., 0]
    points, pixel = points_of(source, pose)
    normal = source.normal.astype(np.float64)
    normal[(normal * (pose[:3, 3] - points)).sum(-1) < 0] *= -1
    covered = (source.depth > 0) & (frame.depth > 0)
    # Rays where ours says that some of it is seen, and about it, and for a part of all others.
    near = ndimage.binary_dilation((ours > 0) & (ours < 1), iterations=6)
    asked = covered & (near | (np.random.default_rng(0).random(covered.shape) < 0.1))
    from_here = points[asked] + 0.02 * pixel[asked][:, None] * normal[asked]
    theirs = np.full(covered.shape, np.nan)
    theirs[asked] = Rays(meshes).share(from_here, light, place, radius, RAYS)
    partly = (theirs > 0) & (theirs < 1)
    inside = ndimage.binary_erosion(partly, iterations=2)
    return (ours - theirs)[inside], np.abs((ours - theirs)[asked & ~partly & ~near]) > 0.1


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("degrees", "number"), [(2.0, 0), (2.0, 1), (2.0, 2), (2.0, 3), (1.0, 1), (0.53, 1)])
def test_one_layer_is_as_rays_have_it(degrees, number):
    inside, wrong = differences(plates, degrees, number)
    print(f"{degrees}°, light {number}: rms {rms(inside):.4f} of {len(inside):,} pixels, {wrong.mean():.3%} wrong beside")
    assert len(inside) > 100
    assert rms(inside) <= 0.05
    assert abs(inside.mean()) < 0.01
    assert wrong.mean() < 1e-3


@pytest.mark.parametrize(
    ("make", "degrees", "number"),
    [(trees, 2.0, 0), (trees, 2.0, 1), (sheets, 2.0, 1), (street, 2.0, 0), (plates, 10.0, 0), (plates, 30.0, 3)],
)
def test_many_layers_and_large_lights_are_near_it(make, degrees, number):
    inside, wrong = differences(make, degrees, number)
    print(
        f"{make.__name__}, {degrees}°, light {number}: rms {rms(inside):.4f} of {len(inside):,} pixels, "
        f"{wrong.mean():.3%} wrong beside"
    )
    assert len(inside) > 100
    assert rms(inside) <= 0.12
    assert wrong.mean() < 1e-2
