"""Shadows of lights that have a size, against rays of Embree to all of it."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
from scipy import ndimage

import nanite_rs as nrs
from oracles.shadows import CAMERA, Rays, ball, placed, plates, points_of, scene_of, sheets, street, trees

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
    """Ours less theirs where a light is seen in part, two pixels and more inside of the penumbra; and which pixels
    elsewhere are wrong by more than a tenth."""
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
    near = ndimage.binary_dilation((ours > 0) & (ours < 1), iterations=5)
    asked = covered & (near | (np.random.default_rng(0).random(covered.shape) < 0.04))
    from_here = points[asked] + 0.02 * pixel[asked][:, None] * normal[asked]
    theirs = np.full(covered.shape, np.nan)
    theirs[asked] = Rays(meshes).share(from_here, light, place, radius, RAYS)
    partly = (theirs > 0) & (theirs < 1)
    inside = ndimage.binary_erosion(partly, iterations=2)
    there, wrong = (ours - theirs)[inside], np.abs((ours - theirs)[asked & ~partly & ~near]) > 0.1
    print(
        f"{make.__name__}, {degrees}°, light {number}: rms {rms(there):.4f}, mean {there.mean():+.4f} of "
        f"{len(there):,} pixels, {wrong.mean():.3%} of {len(wrong):,} wrong elsewhere"
    )
    return there, wrong


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


ONE_LAYER = [(2.0, 1), (2.0, 3), (2.0, 0), (2.0, 2), (1.0, 1), (0.53, 1)]
"""Degrees, and the number of the light of `plates`: of a short run the first two."""
MANY_LAYERS = [
    (trees, 2.0, 0),
    (plates, 30.0, 3),
    (trees, 2.0, 1),
    (sheets, 2.0, 1),
    (street, 2.0, 0),
    (plates, 10.0, 0),
]


def test_one_layer_is_as_rays_have_it(soak):
    for degrees, number in ONE_LAYER if soak else ONE_LAYER[:2]:
        inside, wrong = differences(plates, degrees, number)
        assert len(inside) > 100
        assert rms(inside) <= 0.05
        assert abs(inside.mean()) < 0.025
        assert wrong.mean() < 2e-3


def test_many_layers_and_large_lights_are_near_it(soak):
    for make, degrees, number in MANY_LAYERS if soak else MANY_LAYERS[:2]:
        inside, wrong = differences(make, degrees, number)
        assert len(inside) > 100
        assert rms(inside) <= 0.12
        assert wrong.mean() < 1e-2


@pytest.fixture(scope="module")
def softly():
    """Balls under soft lights of each kind."""
    meshes, lights, pose = ball()
    mesh = nrs.shapes.displaced_icosphere(faces=5_000)
    meshes[0], meshes[2] = (mesh, meshes[0][1]), (mesh, meshes[2][1])
    return scene_of(meshes, [(of_size(light, 12.0)[0], place) for light, place in lights]), pose


def test_soft_shadows_are_shares_and_the_same_in_every_frame(softly):
    scene, pose = softly
    with nrs.Renderer(160, 90, backend="cpu") as renderer:
        first, second = (renderer.render(scene, CAMERA, pose, shadows=True) for _ in range(2))
        assert np.array_equal(first.color, second.color)
        assert np.array_equal(first.shadow, second.shadow)
        for light in range(3):
            values = first.shadow[..., light]
            assert ((values >= 0) & (values <= 1)).all()
            partly = (values > 0) & (values < 1)
            assert partly.sum() > 20, light
            assert np.allclose(32 * values, np.round(32 * values))
        coarse = renderer.render(scene, CAMERA, pose, shadows=True, shadow_samples=5).shadow
        assert np.allclose(5 * coarse, np.round(5 * coarse))
        assert np.abs(coarse - first.shadow).mean() < 0.01
        # Much memory less makes texels larger, and shadows none the wilder.
        tight = renderer.render(scene, CAMERA, pose, shadows=True, shadow_memory=28 << 16)
        assert tight.stats.shadows.coarser > 0
        assert np.abs(tight.shadow - first.shadow).mean() < 0.05


def test_a_smaller_light_comes_to_the_sharp_one(softly):
    scene, pose = softly
    with nrs.Renderer(160, 90, backend="cpu") as renderer:
        shares = []
        for angle in (0.0, 1e-9, 1e-3, 0.05):
            scene.lights[0].light = nrs.DirectionalLight(intensity=3.0, angle=angle)
            shadow = renderer.render(scene, CAMERA, pose, shadows=True).shadow[..., 0]
            shares.append(((shadow > 0) & (shadow < 1)).mean())
            if angle == 0.0:
                sharp = shadow
            elif angle < 1e-6:
                assert (np.abs(shadow - sharp) > 0.5).mean() < 0.02
        assert shares[0] == 0.0
        assert shares[1] <= shares[2] < shares[3]


def test_a_flight_of_soft_lights_is_what_new_pages_would_show(softly):
    scene, pose = softly
    with nrs.Renderer(160, 90, backend="cpu") as kept:
        for step in range(4):
            moved = pose @ placed(0.1 * step, 0.0, -0.2 * step, turn=0.05 * step)
            frame = kept.render(scene, CAMERA, moved, shadows=True)
            with nrs.Renderer(160, 90, backend="cpu") as fresh:
                assert np.array_equal(frame.shadow, fresh.render(scene, CAMERA, moved, shadows=True).shadow)
    assert frame.stats.shadows.drawn_pages < frame.stats.shadows.wanted_pages


def test_sizes_are_kept_and_checked(softly):
    scene, pose = softly
    for other in (pickle.loads(pickle.dumps(scene)), copy.copy(scene)):
        assert [node.light for node in other.lights] == [node.light for node in scene.lights]
    for bad in (-0.1, math.nan, 2.0):
        with pytest.raises(nrs.ArgumentError, match=r"^angle: must be from 0 to π/2"):
            nrs.DirectionalLight(angle=bad)
    with pytest.raises(nrs.ArgumentError, match=r"^angle: .*radians\(30\)"):
        nrs.DirectionalLight(angle=30)
    with pytest.raises(nrs.DtypeError, match=r"^angle: "):
        nrs.DirectionalLight(angle="wide")
    for kind in (nrs.PointLight, nrs.SpotLight):
        for bad in (-1.0, math.inf, math.nan):
            with pytest.raises(nrs.ArgumentError, match=r"^radius: must be finite and not negative"):
                kind(radius=bad)
    with nrs.Renderer(32, 24, backend="cpu") as renderer:
        for bad in (0, 257):
            with pytest.raises(nrs.ArgumentError, match=r"^shadow_samples: must be from 1 to 256"):
                renderer.render(scene, CAMERA, pose, shadows=True, shadow_samples=bad)
        with pytest.raises(nrs.DtypeError, match=r"^shadow_samples: "):
            renderer.render(scene, CAMERA, pose, shadows=True, shadow_samples=1.5)
