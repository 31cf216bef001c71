"""Shadows against rays of Embree through the full source; what takes part in them; what they cost and keep."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from scipy import ndimage

import nanite_rs as nrs
from oracles.shadows import (
    CAMERA,
    MORE_SCENES,
    SCENES,
    SIZE,
    YFOV,
    Rays,
    ball,
    floor,
    lit_by_pyrender,
    placed,
    points_of,
    scene_of,
    street,
)

FINER = 3
"""Rays through so many points across and down a pixel: shadows have edges between its centre and the next."""
FEW = 1000
"""Instances that pyrender draws in less than a minute."""


def apart(depth, axis):
    """Whether a pixel and the one behind it along an axis show surfaces that are apart."""
    near, far = pairs(depth, axis)
    return np.abs(near - far) >= 0.05 * np.maximum(near, far)


def beside(pairs_, axis):
    """Both pixels of pairs along an axis."""
    sides = [[side if k == axis else (0, 0) for k in (0, 1)] for side in ((0, 1), (1, 0))]
    return np.pad(pairs_, sides[0]) | np.pad(pairs_, sides[1])


def between(differ, depth):
    """Pixels beside which a surface goes on otherwise: ``differ`` says of neighbours along an axis if they do."""
    first, second = (beside(differ(axis) & ~apart(depth, axis), axis) for axis in (0, 1))
    return first | second


def pairs(array, axis):
    """Values of pixels, and of those behind them along an axis."""
    count = array.shape[axis]
    return np.take(array, range(count - 1), axis), np.take(array, range(1, count), axis)


def outlines(depth):
    """Where a surface ends before another."""
    return beside(apart(depth, 0), 0) | beside(apart(depth, 1), 1)


def edges(lit, depth):
    """Where a surface goes from light to dark."""
    return between(lambda axis: np.not_equal(*pairs(lit, axis)), depth)


def creases(normal, depth):
    """Where a surface turns by more than a few degrees."""
    return between(lambda axis: np.multiply(*pairs(normal, axis)).sum(-1) < 0.99, depth)


@pytest.mark.parametrize("pixel_error", [1.0, 0.25])
@pytest.mark.parametrize("name", SCENES)
def test_rays_and_shadows_agree_but_for_a_band_about_edges(name, pixel_error, soak):
    """No pixel is wrong farther from a true edge than the offset, an error and a texel reach, but in creases."""
    check_against_rays(name, SCENES[name], pixel_error, beside_pyrender=soak and pixel_error == 1.0)


def test_more_scenes_agree_with_rays(soak):
    """`make soak` takes all of them."""
    for name, make in MORE_SCENES.items() if soak else [("sizes", MORE_SCENES["sizes"])]:
        check_against_rays(name, make, 1.0, in_creases=3e-3, beside_pyrender=soak)


def test_cascades_agree_with_rays_but_for_a_band_of_their_texels(soak):
    """`make soak` takes all scenes."""
    scenes = SCENES | MORE_SCENES if soak else {name: SCENES[name] for name in ("ball", "street")}
    for name, make in scenes.items():
        check_against_rays(name, make, 1.0, in_creases=3e-3, shadows="cascaded")


def texels_of(frame, light, distance):
    """Texels of a light's cascades at distances from the camera, world units; 0 of a light that has none."""
    texel = np.zeros(distance.shape)
    for cascade in frame.stats.shadows.cascades:
        if cascade.light == light:
            # A pixel beside an edge may fall into the next.
            texel = np.maximum(texel, np.where(distance >= 0.95 * cascade.begin, cascade.texel, 0.0))
    return texel


def check_against_rays(name, make, pixel_error, in_creases=3e-4, beside_pyrender=False, shadows="virtual"):
    meshes, lights, pose = make()
    scene, rays = scene_of(meshes, lights), Rays(meshes)
    # Of which normals are those of the triangles.
    facets = scene_of(meshes, [], smooth=False)
    outputs = ["depth", "normal"]
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(
            scene, CAMERA, pose, shadows=shadows, pixel_error=pixel_error, outputs=outputs
        )
    with nrs.Renderer(*(FINER * side for side in SIZE), backend="cpu") as renderer:
        fine = renderer.render(facets, CAMERA, pose, pixel_error=0.0, outputs=outputs)
    points, pixel = points_of(fine, pose)
    covered = fine.depth > 0
    normal = fine.normal.astype(np.float64)
    towards = pose[:3, 3] - points
    normal[(normal * towards).sum(-1) < 0] *= -1
    center = slice(FINER // 2, None, FINER)
    both = covered[center, center] & (frame.depth > 0)
    # What lies beyond the border is not known.
    border = np.minimum(
        *(np.minimum(k, n - 1 - k) for k, n in zip(np.indices(both.shape), both.shape, strict=True))
    )
    # Nor what lies behind an outline.
    outline = ndimage.distance_transform_edt(~outlines(fine.depth)) / FINER
    border = np.minimum(border, outline[center, center])
    crease = ndimage.distance_transform_edt(~creases(normal, fine.depth)) / FINER
    for number, (light, place) in enumerate(lights):
        # A fiftieth of a pixel off the surface, on the side that is seen.
        from_here = points + 0.02 * FINER * pixel[..., None] * normal
        lit = np.ones(covered.shape, bool)
        lit[covered] = rays.reach(from_here[covered], light, place)
        far = ndimage.distance_transform_edt(~edges(lit, fine.depth)) / FINER
        way = place[:3, 2] if isinstance(light, nrs.DirectionalLight) else place[:3, 3] - points
        cosine = np.abs((normal * way).sum(-1) / np.linalg.norm(way, axis=-1).clip(1e-30))
        # In pixels: what the receiver is moved by, the light's error and a texel, no larger in virtual maps.
        error = min(1.0, pixel_error)
        texel = texels_of(frame, number, np.linalg.norm(towards, axis=-1)) / (FINER * pixel).clip(1e-30)
        texel = np.where(texel > 0.0, texel, 1.0)
        offset = pixel_error + (error + 0.72) * texel
        band = 1.0 + (offset + (error + 1.0) * texel) / cosine.clip(1e-3)
        wrong = both & ((frame.shadow[..., number] > 0.5) != lit[center, center])
        outside = wrong & (np.minimum(far[center, center], border) > band[center, center])
        count, share = both.sum(), lit[center, center][both].mean()
        # Where the source is a plane as far as that reaches.
        flat = (crease > band)[center, center]
        in_crease = outside & ~flat
        outside &= flat
        print(
            f"{name}, {shadows}, {pixel_error} px, light {number}: {share:.0%} lit, {wrong.sum() / count:.3%} of "
            f"{count:,} pixels wrong; outside of the band, {np.median(band[covered]):.1f} px in the median: "
            f"{outside.sum()} of {(flat & both).sum():,} on flat ground, {in_crease.sum()} in creases"
        )
        if beside_pyrender and isinstance(light, nrs.DirectionalLight) and len(meshes) < FEW:
            theirs = both & (lit_by_pyrender(meshes, place, pose) != lit[center, center])
            print(f"    pyrender: {theirs.sum() / count:.3%} wrong")
            assert wrong.sum() < theirs.sum()
        assert 0.005 < share < 0.998
        assert not outside.any()
        assert in_crease.sum() <= in_creases * count
        assert wrong.sum() < (0.1 if shadows == "virtual" else 0.2) * count


def test_a_flight_keeps_its_pages_and_shows_what_new_ones_would(soak):
    """`make soak` flies 300 frames."""
    meshes, lights, _ = street()
    scene = scene_of(meshes, lights)
    wanted = drawn = 0
    with nrs.Renderer(*SIZE, backend="cpu") as kept:
        for step in range(300 if soak else 20):
            pose = nrs.look_at((3 + 0.05 * step, 6, 14 - 0.1 * step), (0.3 * np.sin(0.1 * step), 0, -20))
            frame = kept.render(scene, CAMERA, pose, shadows=True)
            with nrs.Renderer(*SIZE, backend="cpu") as fresh:
                new = fresh.render(scene, CAMERA, pose, shadows=True)
            assert np.array_equal(frame.color, new.color), step
            assert np.array_equal(frame.shadow, new.shadow), step
            assert frame.stats.shadows.wanted_pages == new.stats.shadows.drawn_pages
            if step:
                wanted += frame.stats.shadows.wanted_pages
                drawn += frame.stats.shadows.drawn_pages
    print(f"{drawn} of {wanted} pages drawn anew")
    assert drawn <= 0.05 * wanted


def test_nothing_flickers_as_the_camera_turns():
    """A point of a surface, away from edges, is lit or dark whichever way the camera looks."""
    meshes, lights, pose = ball()
    scene = scene_of(meshes, lights)
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        first = renderer.render(scene, CAMERA, pose, shadows=True)
        points, _ = points_of(first, pose)
        points[first.depth == 0] += 1.0  # not at the eye
        for turn in (0.003, 0.02, 0.1):
            turned = pose @ placed(turn=turn)
            frame = renderer.render(scene, CAMERA, turned, shadows=True)
            local = (points - turned[:3, 3]) @ turned[:3, :3]
            focal = 0.5 * SIZE[1] / np.tan(0.5 * YFOV)
            x, y = (
                SIZE[0] / 2 - focal * local[..., 0] / local[..., 2],
                SIZE[1] / 2 + focal * local[..., 1] / local[..., 2],
            )
            inside = (first.depth > 0) & (x >= 0) & (x < SIZE[0]) & (y >= 0) & (y < SIZE[1])
            column, row = x[inside].astype(int), y[inside].astype(int)
            same = np.abs(frame.depth[row, column] + local[inside][:, 2]) < 0.01 * frame.depth[row, column]
            assert same.mean() > 0.9
            for light in range(len(lights)):
                a, b = (f.shadow[..., light] > 0.5 for f in (first, frame))
                near = [
                    ndimage.binary_dilation(edges(lit, f.depth), iterations=3)
                    for lit, f in ((a, first), (b, frame))
                ]
                away = same & ~near[0][inside] & ~near[1][row, column]
                assert away.sum() > 10_000
                assert (a[inside] == b[row, column])[away].all(), (turn, light)


def small_scene():
    meshes, lights, pose = ball()
    meshes[0] = meshes[2] = (nrs.shapes.displaced_icosphere(faces=5_000), meshes[0][1])
    meshes[2] = (meshes[0][0], placed(1.6, -0.6, 0.5, scale=0.4))
    return scene_of(meshes, lights), pose


@pytest.fixture(scope="module")
def small():
    return small_scene()


def test_shadows_are_off_unless_asked_for(small):
    scene, pose = small
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        plain = renderer.render(scene, CAMERA, pose)
        assert plain.stats.shadows is None
        with pytest.raises(nrs.ArgumentError, match=r"^shadows: the frame was rendered without"):
            plain.shadow  # noqa: B018
        off, on, named = (
            renderer.render(scene, CAMERA, pose, shadows=how) for how in (False, True, "virtual")
        )
        assert np.array_equal(off.color, plain.color)
        assert not np.array_equal(on.color, plain.color)
        assert np.array_equal(on.color, named.color)
        # What is lit is as bright as without, and nothing is brighter.
        everywhere = (on.shadow == 1.0).all(axis=-1)
        assert np.array_equal(on.linear[everywhere], plain.linear[everywhere])
        assert (on.linear <= plain.linear).all()
        assert (on.linear < plain.linear).any()


def test_arrays_are_the_same_in_every_way(small):
    scene, pose = small
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERA, pose, shadows=True)
        assert frame.shadow.shape == (48, 64, 3)
        assert frame.shadow.dtype == np.float32
        assert set(np.unique(frame.shadow)) == {0.0, 1.0}
        assert (frame.shadow[frame.depth == 0] == 1.0).all()
        (other,) = renderer.render_views(scene, [(CAMERA, pose)], shadows=True)
        assert np.array_equal(other.shadow, frame.shadow)
        for shading in ("gltf", "pyrender"):
            shaded = renderer.render(scene, CAMERA, pose, shadows=True, shading=shading)
            assert np.array_equal(shaded.shadow, frame.shadow)
        smooth = renderer.render(scene, CAMERA, pose, shadows=True, samples=16)
        assert np.array_equal(smooth.shadow, frame.shadow)
        assert len(np.unique(smooth.color)) > len(np.unique(frame.color))
        alone = renderer.render(scene, CAMERA, pose, shadows=True, depth_only=True)
        assert np.array_equal(alone.depth, frame.depth)
        with pytest.raises(nrs.ArgumentError, match=r"^depth_only: "):
            alone.shadow  # noqa: B018
        # Of a light that is off there is nothing, of one that casts none all is lit.
        scene.lights[0].visible = False
        assert np.array_equal(
            renderer.render(scene, CAMERA, pose, shadows=True).shadow, frame.shadow[..., 1:]
        )
        scene.lights[0].visible = True
        scene.lights[0].light = nrs.DirectionalLight(intensity=3.0, casts_shadows=False)
        assert (renderer.render(scene, CAMERA, pose, shadows=True).shadow[..., 0] == 1.0).all()
        scene.lights[0].light = nrs.DirectionalLight(intensity=3.0)


def test_frames_and_scenes_keep_shadows_in_pickles():
    scene, pose = small_scene()
    scene.instances[0].casts_shadows = False
    scene.instances[1].receives_shadows = False
    scene.lights[1].light = nrs.SpotLight(intensity=20.0, outerConeAngle=0.5, casts_shadows=False)
    for other in (pickle.loads(pickle.dumps(scene)), copy.copy(scene)):
        flags = [(node.casts_shadows, node.receives_shadows) for node in other.instances]
        assert flags == [(False, True), (True, False), (True, True)]
        assert [node.light.casts_shadows for node in other.lights] == [True, False, True]
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERA, pose, shadows=True)
    shadow, stats = frame.shadow, frame.stats.shadows
    kept = pickle.loads(pickle.dumps(frame))
    assert np.array_equal(kept.shadow, shadow)
    assert kept.stats.shadows == stats


def test_a_still_scene_draws_no_page_again(small):
    scene, pose = small
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        first, second = (renderer.render(scene, CAMERA, pose, shadows=True).stats.shadows for _ in range(2))
        assert first.drawn_pages == first.wanted_pages == first.kept_pages > 0
        assert first.clusters > 0
        assert (second.drawn_pages, second.clusters, second.kept_pages) == (0, 0, first.kept_pages)
        assert f"{first.wanted_pages:,} pages wanted" in str(first)
        frame = renderer.render(scene, CAMERA, pose, shadows=True)
        assert str(frame.stats.shadows) in str(frame.stats)
        assert frame.stats.as_dict()["shadow_wanted_pages"] == first.wanted_pages
        tight = renderer.render(scene, CAMERA, pose, shadows=True, shadow_memory=48 << 16)
        assert tight.stats.shadows.coarser > 0
        assert tight.stats.shadows.kept_pages <= 48
        assert "times as large" in str(tight.stats.shadows)


def test_cascades_are_drawn_for_each_frame(small):
    scene, pose = small
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        first, second = (renderer.render(scene, CAMERA, pose, shadows="cascaded") for _ in range(2))
        assert np.array_equal(first.shadow, second.shadow)
        assert np.array_equal(first.color, second.color)
        all_drawn = renderer.render(scene, CAMERA, pose, shadows="cascaded", occlusion=False)
        assert np.array_equal(first.shadow, all_drawn.shadow)
        virtual = renderer.render(scene, CAMERA, pose, shadows=True)
        assert 0 < (first.shadow != virtual.shadow).mean() < 0.02
        # Those of the sun are drawn each time, those of the two other lights are kept.
        a, b = first.stats.shadows, second.stats.shadows
        assert 0 < b.drawn_pages < b.wanted_pages == a.wanted_pages
        assert all_drawn.stats.shadows.clusters >= b.clusters
        assert 1 <= len(a.cascades) <= 4
        assert {cascade.light for cascade in a.cascades} == {0}
        assert all(cascade.begin < cascade.end and cascade.texel > 0 for cascade in a.cascades)
        assert f"{len(a.cascades)} cascades" in str(a)
        assert "shadow_cascades" not in first.stats.as_dict()
        assert pickle.loads(pickle.dumps(first)).stats.shadows == a
        levels = first.view("shadow_levels")[first.instance_id == 1]
        assert 2 <= len(np.unique(levels, axis=0)) <= 5
        for other in renderer.render_views(scene, [(CAMERA, pose)] * 2, shadows="cascaded"):
            assert np.array_equal(other.shadow, first.shadow)
        camera = nrs.OrthographicCamera(2.8, 1.6)
        parallel = renderer.render(scene, camera, pose, shadows="cascaded", samples=4)
        assert 0.02 < (parallel.shadow == 0).mean() < 0.9


def test_views_show_pages(small):
    scene, pose = small
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        first, second = (renderer.render(scene, CAMERA, pose, shadows=True) for _ in range(2))
        plain = renderer.render(scene, CAMERA, pose)
    covered = first.depth > 0
    # Of one brightness: the floor.
    floor = first.instance_id == 1
    pages = first.view("shadow_pages")
    assert not pages[~covered].any()
    colors = len(np.unique(pages[floor], axis=0))
    assert 5 < colors < first.stats.shadows.wanted_pages
    levels = len(np.unique(first.view("shadow_levels")[floor], axis=0))
    assert 2 <= levels < colors
    drawn, kept = first.view("shadow_kept")[floor].astype(int), second.view("shadow_kept")[floor].astype(int)
    assert (drawn[:, 0] > drawn[:, 1]).all()
    assert (kept[:, 0] < kept[:, 1]).all()
    # Warm colours where the light's cut is fine: a page of the ball's shadow against one of the floor alone.
    cut = first.view("shadow_cut")[floor].astype(int)
    assert 2 <= len(np.unique(cut, axis=0)) < colors
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        coarse = renderer.render(scene, CAMERA, pose, shadows=True, pixel_error=4).view("shadow_cut")[floor]
    warmth = [(picture[:, 0] - picture[:, 2]).mean() for picture in (cut, coarse.astype(int))]
    assert first.stats.shadows.triangles > 0
    assert warmth[0] >= warmth[1], warmth
    for view in ("shadow_pages", "shadow_levels", "shadow_kept", "shadow_cut"):
        with pytest.raises(nrs.ArgumentError, match=r"^shadows: the frame was rendered without"):
            plain.view(view)


def test_mistakes_are_named(small):
    scene, pose = small
    with nrs.Renderer(32, 24, backend="cpu") as renderer:
        with pytest.raises(nrs.ArgumentError, match=r'^shadows: .*"virtual"'):
            renderer.render(scene, CAMERA, pose, shadows="hard")
        with pytest.raises(nrs.DtypeError, match=r"^shadows: "):
            renderer.render(scene, CAMERA, pose, shadows=1.5)
        for bytes_ in (-1, 1 << 63):
            with pytest.raises(nrs.ArgumentError, match=r"^shadow_memory: "):
                renderer.render(scene, CAMERA, pose, shadows=True, shadow_memory=bytes_)
        with pytest.raises(nrs.ArgumentError, match=r"^shadow_memory: "):
            renderer.render(scene, CAMERA, pose, shadows=True, shadow_memory=0)
        # Nothing is lost.
        assert renderer.render(scene, CAMERA, pose, shadows=True).stats.shadows.wanted_pages > 0


def test_flags_of_pyrender_say_which_lights_cast():
    pyrender = pytest.importorskip("pyrender")
    script = pyrender.Scene()
    script.add(pyrender.PerspectiveCamera(yfov=0.8))
    for light in (pyrender.DirectionalLight(), pyrender.SpotLight(), pyrender.PointLight()):
        script.add(light)
    flags = pyrender.RenderFlags
    kinds = {"DirectionalLight", "SpotLight", "PointLight"}

    def casting(**given):
        view = nrs.from_pyrender(script, **given)
        return view.shadows, {
            type(node.light).__name__ for node in view.scene.lights if node.light.casts_shadows
        }

    assert casting() == (False, kinds)
    assert casting(flags=flags.NONE) == (False, set())
    assert casting(flags=flags.SHADOWS_DIRECTIONAL | flags.OFFSCREEN) == (True, {"DirectionalLight"})
    assert casting(flags=flags.SHADOWS_ALL) == (True, kinds)


def leaf(side=256):
    """An image whose alpha falls evenly from its middle: a cutoff of a half leaves a disc of half its width."""
    at = (np.arange(side) + 0.5) / side - 0.5
    image = np.full((side, side, 4), 255, np.uint8)
    image[..., 3] = np.round(255 * np.clip(1.0 - 2.0 * np.hypot(at, at[:, None]), 0.0, 1.0))
    return image


def leaves(count, size, rng):
    """Cards of leaves above a floor: corners of each, origin and two sides."""
    middle = rng.uniform((-2.0, 0.4, -2.0), (2.0, 2.2, 2.0), (count, 3))
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    return middle - size / 2 * (turn[:, 0] + turn[:, 1]), size * turn[:, 0], size * turn[:, 1]


def covered_by_leaves(points, towards, cards):
    """Whether rays meet the disc that is left of any card, each by hand."""
    covered = np.zeros(len(points), bool)
    for origin, u, v in zip(*cards, strict=True):
        # From a point of the floor the ray comes by no farther from the middle than the card's corners.
        middle = origin + (u + v) / 2
        foot = middle - towards * middle[1] / towards[1]
        reach = np.linalg.norm(u) / towards[1]
        near = np.flatnonzero((np.abs(points - foot) < reach).all(axis=1))
        across = np.cross(u, v)
        way = ((origin - points[near]) @ across) / (towards @ across)
        hit = points[near] + way[:, None] * towards - origin
        at = np.stack([hit @ u / (u @ u), hit @ v / (v @ v)], -1) - 0.5
        covered[near] |= (way > 0.0) & (np.hypot(*at.T) < 0.25)
    return covered


@pytest.mark.parametrize(("count", "size", "most"), [(60, 0.8, 0.02), (500, 0.25, 0.05), (4000, 0.09, 0.15)])
def test_leaves_cast_what_their_alpha_leaves(count, size, most):
    """Shadows of cards with an alpha test against rays that are tested by hand; of leaves of a few pixels, too."""
    cards = leaves(count, size, np.random.default_rng(4))
    origin, u, v = cards
    vertices = np.stack([origin, origin + u, origin + u + v, origin + v], 1).reshape(-1, 3)
    faces = (4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    uvs = np.tile([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], (count, 1))
    texture = nrs.Texture(leaf(), wrap="clamp")
    look = nrs.Material(base_color_texture=texture, alpha_mode="mask", double_sided=True)
    scene = nrs.Scene()
    scene.add(nrs.NaniteMesh.from_arrays(vertices, faces, uvs=uvs), material=look)
    scene.add(nrs.NaniteMesh.from_arrays(*floor(9.0)))
    place = nrs.look_at((1.0, 2.0, 0.7), (0, 0, 0))
    scene.add(nrs.DirectionalLight(intensity=3.0), pose=place)
    pose = nrs.look_at((2.0, 5.0, 6.0), (0, 0, 0))
    with nrs.Renderer(*SIZE, backend="cpu") as renderer:
        frame = renderer.render(scene, CAMERA, pose, shadows=True, pixel_error=0.25)
    points, _ = points_of(frame, pose)
    seen = (frame.depth > 0) & (np.abs(points) < (2.5, 1e-3, 2.5)).all(axis=-1)
    lit = np.ones(seen.shape, bool)
    lit[seen] = ~covered_by_leaves(points[seen], place[:3, 2], cards)
    wrong = seen & ((frame.shadow[..., 0] > 0.5) != lit)
    # Beside what hides the floor its edges are not known.
    far = ndimage.distance_transform_edt(~(edges(lit, frame.depth) | outlines(frame.depth)))
    outside = (wrong & (far > 3.0)).sum()
    print(
        f"{count} leaves: {lit[seen].mean():.0%} lit, {wrong.sum() / seen.sum():.2%} wrong, {outside} beyond edges"
    )
    assert 0.3 < lit[seen].mean() < 0.97
    assert outside == 0
    assert wrong.sum() < most * seen.sum()
