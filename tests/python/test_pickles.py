"""Scenes, nodes, frames and renderers that are pickled and copied."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import subjects
from oracles.camera import at

LENS = nrs.PerspectiveCamera(yfov=0.8)
WAYS = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "copy": copy.copy, "deepcopy": copy.deepcopy}


def made() -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.2, 0.1, 0.3), bg_color=(0.1, 0.5, 0.5))
    mesh = subjects.built("small sphere")
    gone = scene.add(mesh)
    scene.add(mesh, pose=at(0.5, 0, 0), material=nrs.Material(base_color=(1, 0, 0)))
    scene.add(mesh, pose=at(-0.5, 0, 0)).visible = False
    scene.add(nrs.DirectionalLight(intensity=3.0))
    lost = scene.add(nrs.PointLight(intensity=5.0), pose=at(0, 3, 0))
    scene.add(nrs.SpotLight(intensity=5.0), pose=at(0, 0, 3)).visible = False
    gone.remove()
    lost.remove()
    scene.add(mesh, pose=at(0, 0.6, 0))  # in the place of the first
    return scene


@pytest.fixture(scope="module")
def renderer() -> nrs.Renderer:
    return nrs.Renderer(64, 48, backend="cpu", threads=1)


@pytest.mark.parametrize("way", WAYS)
def test_scenes_show_the_same_and_go_their_own_ways(way: str, renderer: nrs.Renderer) -> None:
    scene = made()
    node, light = scene.instances[0], scene.lights[1]
    other, (its_node, its_light) = (
        WAYS[way]((scene, (node, light))) if way == "pickle" else (None, (None, None))
    )
    if other is None:
        other = WAYS[way](scene)
        its_node, its_light = other.instances[0], other.lights[1]
    before, after = (renderer.render(s, LENS, at(0, 0, 4)) for s in (scene, other))
    assert np.array_equal(before.color, after.color)
    assert np.array_equal(before.instance_id, after.instance_id)
    assert [n.instance_id for n in scene.instances] == [n.instance_id for n in other.instances]
    assert [n.visible for n in scene.instances] == [n.visible for n in other.instances]
    assert [(n.light, n.visible) for n in scene.lights] == [(n.light, n.visible) for n in other.lights]
    assert its_node.scene is other
    assert its_light.scene is other
    assert its_node.instance_id == node.instance_id
    other.clear()
    assert (len(scene), len(scene.lights)) == (3, 2)
    assert np.array_equal(renderer.render(scene, LENS, at(0, 0, 4)).color, before.color)


def test_nodes_that_are_gone_cannot_come_back() -> None:
    node = made().instances[0]
    stored = pickle.dumps(node)
    assert pickle.loads(stored).instance_id == node.instance_id
    node.remove()
    with pytest.raises(nrs.StaleHandleError):
        pickle.loads(pickle.dumps(node))


@pytest.mark.parametrize("way", WAYS)
def test_frames_keep_their_arrays(way: str, renderer: nrs.Renderer, tmp_path) -> None:
    frame = renderer.render(made(), LENS, at(0, 0, 4))
    looked_at = frame.linear
    asked_for = renderer.render(made(), LENS, at(0, 0, 4), outputs=["base_color", "orm"])
    assert np.array_equal(WAYS[way](asked_for).orm, asked_for.orm)
    other = WAYS[way](frame)
    for name in ("color", "depth", "normal", "instance_id", "cluster_id", "triangle_id", "linear", "rgba"):
        assert np.array_equal(getattr(frame, name), getattr(other, name)), name
    assert (other.width, other.height, other.stats) == (frame.width, frame.height, frame.stats)
    assert other.metadata == frame.metadata
    other.save(tmp_path / "frame.png")
    assert (other.linear is looked_at) == (way == "copy")
    if way == "pickle":
        with pytest.raises(nrs.ArgumentError, match=r"^overdraw: this frame was pickled without it"):
            _ = other.overdraw
        with pytest.raises(nrs.ArgumentError, match="pickled without"):
            other.view("clusters")
        assert np.array_equal(WAYS[way](other).linear, looked_at)
    else:
        assert np.array_equal(other.overdraw, frame.overdraw)


def test_frames_of_depth_alone(renderer: nrs.Renderer) -> None:
    frame = renderer.render(made(), LENS, at(0, 0, 4), depth_only=True)
    assert np.array_equal(pickle.loads(pickle.dumps(frame)).depth, frame.depth)


@pytest.mark.parametrize("way", WAYS)
def test_renderers_are_made_anew(way: str) -> None:
    first = nrs.Renderer(31, 17, backend="cpu", streaming=True, pool_bytes=1 << 22, threads=2)
    other = WAYS[way](first)
    assert (other.width, other.height, other.backend) == (31, 17, "cpu")
    first.close()
    assert other.render(made(), LENS, at(0, 0, 4)).color.shape == (17, 31, 3)
