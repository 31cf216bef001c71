"""Frames of depth alone, on both backends: depth bit for bit that of others, nothing besides, and pyrender's."""

from __future__ import annotations

import numpy as np
import pytest

import nanite_rs as nrs
from conftest import SOAK
from oracles import compare, subjects
from oracles.camera import at
from oracles.setup import setup

SIZE = 320, 180
LENS = nrs.PerspectiveCamera(yfov=0.8)
OTHERS = ("color", "normal", "instance_id", "cluster_id", "triangle_id", "face_id", "overdraw")
VIEWS = ("shaded", "triangles", "clusters", "groups", "levels", "rasterizers", "overdraw")


@pytest.fixture
def renderer(backend):
    with nrs.Renderer(*SIZE, backend=backend) as renderer:
        yield renderer


def scene() -> nrs.Scene:
    out = nrs.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0, 0, 0.5))
    mesh = subjects.built("small sphere")
    for k in range(9):
        out.add(mesh, pose=at(1.5 * (k % 3) - 1.5, 1.5 * (k // 3) - 1.5, -k))
    return out


@pytest.mark.parametrize("occlusion", [False, True], ids=["whole", "occlusion"])
@pytest.mark.parametrize("pixel_error", [0.0, 1.0])
def test_depth_is_that_of_other_frames_by_turns(renderer, occlusion, pixel_error) -> None:
    shown = scene()
    lenses = (LENS, nrs.OrthographicCamera(xmag=3.2, ymag=1.8, zfar=6.5))
    how = {"occlusion": occlusion, "pixel_error": pixel_error}
    for lens in lenses:
        for eye in (at(0, 0, 4), at(0.2, 0.1, 4.1), at(0.2, 0.1, 1.2)):
            whole = renderer.render(shown, lens, eye, **how)
            alone = renderer.render(shown, lens, eye, depth_only=True, **how)
            assert (alone.depth.dtype, alone.depth.shape) == (np.float32, SIZE[::-1])
            assert alone.depth.flags.writeable
            assert alone.depth is alone.depth
            np.testing.assert_array_equal(alone.depth, whole.depth)
            assert alone.stats.covered_pixels == whole.stats.covered_pixels == (whole.depth > 0).sum() > 0
            if not occlusion:
                ours, theirs = alone.stats, whole.stats
                assert (ours.clusters, ours.triangles) == (theirs.clusters, theirs.triangles)
            assert "shade" not in {stage.stage for stage in alone.stats}


def test_several_views_are_as_alone(renderer) -> None:
    shown = scene()
    views = [
        (LENS, at(0, 0, 4)),
        (LENS, at(0, 0, -40)),
        (nrs.OrthographicCamera(xmag=3.0, ymag=2.0), at(0, 0, 5)),
    ]
    frames = renderer.render_views(shown, views, depth_only=True)
    for frame, (lens, eye) in zip(frames, views, strict=True):
        np.testing.assert_array_equal(frame.depth, renderer.render(shown, lens, eye).depth)
    # It stays a frame's own while the renderer goes on.
    first = frames[0].depth.copy()
    renderer.render(nrs.Scene(), LENS, at(0, 0, 4), depth_only=True)
    del frames[0].depth
    np.testing.assert_array_equal(frames[0].depth, first)


def test_there_is_nothing_besides(renderer, tmp_path) -> None:
    frame = renderer.render(scene(), LENS, at(0, 0, 4), depth_only=True)
    for name in OTHERS:
        with pytest.raises(nrs.ArgumentError, match=f"depth_only: the frame has depth alone, and no {name}"):
            getattr(frame, name)
    for view in VIEWS:
        with pytest.raises(nrs.ArgumentError, match="depth_only"):
            frame.view(view)
    with pytest.raises(nrs.ArgumentError, match="depth_only"):
        frame.save(tmp_path / "nothing.png")
    assert not list(tmp_path.iterdir())
    assert frame._repr_png_() is None
    assert "pixels" in repr(frame)


def test_nothing_besides_may_be_asked_for(renderer) -> None:
    shown = scene()
    for outputs in ("color", ("color", "depth"), ["depth", "levels"]):
        with pytest.raises(
            nrs.ArgumentError, match=r'outputs: with depth_only there is "depth" alone, not "'
        ):
            renderer.render(shown, LENS, at(0, 0, 4), outputs=outputs, depth_only=True)
        with pytest.raises(nrs.ArgumentError, match="outputs: "):
            renderer.render_views(shown, [(LENS, at(0, 0, 4))], outputs=outputs, depth_only=True)
    expected = renderer.render(shown, LENS, at(0, 0, 4)).depth
    for outputs in ("depth", ("depth",), ()):
        frame = renderer.render(shown, LENS, at(0, 0, 4), outputs=outputs, depth_only=True)
        np.testing.assert_array_equal(frame.depth, expected)


@pytest.mark.parametrize("name", ["bunny", "gyroid", *(["fine knot"] if SOAK else [])])
def test_depth_is_that_of_pyrenders_pass_of_depth_alone(backend, name, tmp_path) -> None:
    """At full detail, with the bounds of `test_images.py`."""
    s = setup(name)
    theirs = s.oracle().depth(s.view)
    lens = nrs.PerspectiveCamera(yfov=s.view.yfov, znear=s.view.znear)
    with nrs.Renderer(s.view.width, s.view.height, backend=backend) as renderer:
        ours = renderer.render(s.scene(), lens, s.view.pose, pixel_error=0.0, depth_only=True).depth
    with compare.evidence(tmp_path / f"{name}.png", ours > 0, theirs > 0):
        assert np.count_nonzero((ours > 0) ^ (theirs > 0)) <= 1e-4 * (theirs > 0).sum() + 2
    inside = compare.away_from_silhouettes(theirs, 1 / s.view.focal) & (ours > 0)
    relative = np.abs(ours - theirs)[inside] / theirs[inside]
    assert np.quantile(relative, 0.999) < 2e-4
    assert np.median(relative) < 1e-5
