"""Animations, skins and morph targets of glTF: where vertices are, computed anew here in float64."""

from __future__ import annotations

import copy
import itertools
import pickle

import numpy as np
import PIL.Image
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

import nanite_rs as nrs
from nanite_rs import cli
from oracles.distance import Surface
from oracles.documents import Document

RNG = np.random.default_rng(7)
CAMERA = nrs.PerspectiveCamera(yfov=0.8, znear=0.05)
POSE = nrs.look_at((0.3, 0.5, 6.0), (0, 0, 0))
TUBE, TUBE_FACES = nrs.shapes.icosphere(faces=500)
TUBE = (TUBE * np.array([0.4, 2.0, 0.4])).astype(np.float32)
TIMES = np.array([0.0, 0.5, 1.25, 2.0], np.float32)
INSTANTS = (-1.0, 0.0, 0.2, 0.5, 0.9, 1.25, 1.7, 2.0, 3.0)


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def matrix(translation=(0, 0, 0), rotation=(0, 0, 0, 1), scale=(1, 1, 1)):
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(rotation).as_matrix() * np.asarray(scale)
    out[:3, 3] = translation
    return out


def surface(document, **attributes):
    """A primitive of the tube."""
    return {
        "attributes": {
            "POSITION": document.accessor(TUBE),
            **{name: document.accessor(array) for name, array in attributes.items()},
        },
        "indices": document.accessor(TUBE_FACES.astype(np.uint16).reshape(-1)),
    }


def animate(document, *channels, name="move"):
    """An animation of channels: node, path, values, interpolation."""
    rows, samplers = [], []
    for node, path, values, kind in channels:
        normalized = values.dtype.kind != "f"
        output = document.accessor(values.reshape(-1) if path == "weights" else values, normalized=normalized)
        samplers.append({"input": document.accessor(TIMES), "output": output, "interpolation": kind})
        rows.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})
    document.row("animations", name=name, channels=rows, samplers=samplers)


def keys(path, kind):
    """Random keys: (K, C), of splines (3 K, C)."""
    width = {"translation": 3, "rotation": 4, "scale": 3, "weights": 2}[path]
    count = len(TIMES) * (3 if kind == "CUBICSPLINE" else 1)
    values = RNG.normal(size=(count, width))
    if path == "rotation":
        values = unit(values) if kind != "CUBICSPLINE" else values * 0.3 + [0, 0, 0, 1.0]
    if path == "scale":
        values = 1.0 + 0.3 * np.tanh(values)
    return values.astype(np.float32)


def expected(path, kind, values, time):
    """A property at a time, by SciPy."""
    time = float(np.clip(time, TIMES[0], TIMES[-1]))
    values = values.astype(np.float64)
    if kind == "STEP":
        return values[np.searchsorted(TIMES, time, side="right") - 1]
    if kind == "CUBICSPLINE":
        before, points, behind = values.reshape(len(TIMES), 3, -1).transpose(1, 0, 2)
        for k in range(len(TIMES) - 1):
            if TIMES[k] <= time <= TIMES[k + 1]:
                ends = slice(k, k + 2)
                slopes = np.stack([behind[k], before[k + 1]])
                return CubicHermiteSpline(TIMES[ends].astype(float), points[ends], slopes)(time)
    if path == "rotation":
        return Slerp(TIMES.astype(float), Rotation.from_quat(values))(time).as_quat()
    return np.array([np.interp(time, TIMES, column) for column in values.T])


def world(node):
    """Vertices of an instance as they are drawn."""
    pose = node.pose
    return node.mesh.vertices @ pose[:3, :3].T + pose[:3, 3]


@pytest.mark.parametrize("kind", ["STEP", "LINEAR", "CUBICSPLINE"])
@pytest.mark.parametrize("path", ["translation", "rotation", "scale"])
def test_nodes_are_where_their_keys_say(kind, path, tmp_path):
    document = Document()
    child = document.mesh(surface(document), translation=[0.0, 1.0, 0.0], name="child")
    values = keys(path, kind)
    parent = document.row("nodes", children=[child], name="parent", translation=[0.5, 0.0, 0.0])
    document.row("scenes", nodes=[parent])
    animate(document, (parent, path, values, kind))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    assert [own.name for own in loaded.animations] == ["move"]
    assert loaded.animations[0].duration == 2.0
    (node,) = loaded.instances["child"]
    np.testing.assert_allclose(node.pose, matrix((0.5, 1, 0)))
    for time in INSTANTS:
        loaded.set_time(time)
        own = {"translation": (0.5, 0, 0), path: expected(path, kind, values, time)}
        np.testing.assert_allclose(node.pose, matrix(**own) @ matrix((0, 1, 0)), atol=1e-6)


def rig(document, sets=1):
    """A chain of four joints beside a mesh that hangs on them, one joint outside of the scene's root."""
    influences = []
    heights = (-1.0, 1.0, 1.0)
    joints = [
        document.row("nodes", translation=[0.0, y, 0.0], name=f"joint {k}") for k, y in enumerate(heights)
    ]
    for above, below in itertools.pairwise(joints):
        document.json["nodes"][above]["children"] = [below]
    joints.append(document.row("nodes", translation=[0.2, 0.0, 0.1], scale=[1.5, 0.5, 1.0], name="elsewhere"))
    places = [matrix((0, y, 0)) for y in (-1, 0, 1)] + [matrix((0.2, 0, 0.1), scale=(1.5, 0.5, 1))]
    inverse = np.linalg.inv(np.stack(places)).astype(np.float32)
    bound = document.accessor(inverse.transpose(0, 2, 1).reshape(-1, 16))
    skin = document.row("skins", joints=joints, inverseBindMatrices=bound)
    attributes = {}
    for k in range(sets):
        rows = RNG.integers(0, 4, (len(TUBE), 4)).astype(np.uint8 if k == 0 else np.uint16)
        weights = RNG.random((len(TUBE), 4)).astype(np.float32)
        influences.append((rows, weights))
        attributes[f"JOINTS_{k}"], attributes[f"WEIGHTS_{k}"] = rows, weights
    return joints, skin, inverse.astype(np.float64), influences, attributes


def skinned(positions, places, inverse, influences):
    """Blended vertices, one matrix for each of them."""
    matrices = np.stack(places) @ inverse
    rows = np.concatenate([rows for rows, _ in influences], 1)
    weights = np.concatenate([weights for _, weights in influences], 1).astype(np.float64)
    weights /= weights.sum(1, keepdims=True)
    blended = np.einsum("nk,nkij->nij", weights, matrices[rows])
    homogeneous = np.concatenate([positions, np.ones((len(positions), 1))], 1)
    return np.einsum("nij,nj->ni", blended, homogeneous)[:, :3], blended


@pytest.mark.parametrize("sets", [1, 2])
def test_skins_follow_their_joints_alone(sets, tmp_path):
    document = Document()
    joints, skin, inverse, influences, attributes = rig(document, sets)
    normals = unit(TUBE).astype(np.float32)
    body = document.mesh(
        surface(document, NORMAL=normals, **attributes), skin=skin, translation=[100.0, 0.0, 0.0], name="body"
    )
    document.row("scenes", nodes=[joints[0], body])
    turns, slides = keys("rotation", "LINEAR"), keys("translation", "LINEAR")
    animate(document, (joints[1], "rotation", turns, "LINEAR"), (joints[3], "translation", slides, "LINEAR"))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    (node,) = loaded.instances["body"]
    # At rest: where the joints are now, not where the mesh was stored.
    np.testing.assert_allclose(world(node), TUBE, atol=1e-5)
    for time in INSTANTS:
        loaded.set_time(time, "move")
        chain = [matrix((0, -1, 0))]
        turn = expected("rotation", "LINEAR", turns, time)
        chain.append(chain[0] @ matrix((0, 1, 0), turn))
        chain.append(chain[1] @ matrix((0, 1, 0)))
        free = matrix(expected("translation", "LINEAR", slides, time), scale=(1.5, 0.5, 1))
        places = [*chain, free]
        wanted, blended = skinned(TUBE.astype(np.float64), places, inverse, influences)
        np.testing.assert_allclose(world(node), wanted, atol=2e-6)
        turned = np.einsum("nij,nj->ni", np.linalg.inv(blended[:, :3, :3]).transpose(0, 2, 1), normals)
        turned *= np.sign(np.linalg.det(blended[:, :3, :3]))[:, None]
        np.testing.assert_allclose(node.mesh._normals, unit(turned), atol=1e-4)
    # As one mesh, too.
    flat = nrs.NaniteMesh.from_file(tmp_path / "a.glb").cut(error=0).vertices
    np.testing.assert_allclose([flat.min(0), flat.max(0)], [TUBE.min(0), TUBE.max(0)], atol=1e-5)


def test_virtual_meshes_follow_joints(tmp_path):
    document = Document()
    joints, skin, _, _, attributes = rig(document)
    body = document.mesh(
        surface(document, NORMAL=unit(TUBE).astype(np.float32), **attributes), skin=skin, name="body"
    )
    document.row("scenes", nodes=[joints[0], body])
    animate(document, (joints[1], "rotation", keys("rotation", "LINEAR"), "LINEAR"))
    path = document.save(tmp_path / "a.glb")
    loaded, whole = nrs.load_scene(path, virtual="always"), nrs.load_scene(path, virtual="never")
    assert "1 virtual" in repr(loaded)
    (node,), (other,) = loaded.instances["body"], whole.instances["body"]
    assert isinstance(node.mesh, nrs.SkinnedMesh)
    assert isinstance(other.mesh, nrs.TriangleMesh)
    for time in (None, *INSTANTS):
        if time is not None:
            loaded.set_time(time)
            whole.set_time(time)
        cut, wanted = node.mesh.cut(error=0.0), other.mesh.vertices
        assert Surface(wanted, TUBE_FACES).nearest(cut.vertices)[0].max() < 2e-6
        assert Surface(cut.vertices, cut.faces).nearest(np.asarray(wanted, float))[0].max() < 2e-6


@pytest.mark.parametrize("virtual", ["always", "never"])
def test_a_mirrored_skin_shows_its_outside(virtual, tmp_path):
    pictures = []
    for is_skinned in (False, True):
        document = Document()
        joints, skin, _, _, attributes = rig(document)
        own = {"skin": skin} if is_skinned else {}
        row = surface(document, NORMAL=unit(TUBE).astype(np.float32), **attributes)
        body = document.mesh(row, name="body", **own)
        root = document.row("nodes", children=[joints[0], joints[3], body], scale=[-1.0, 1.0, 1.0])
        document.row("scenes", nodes=[root])
        loaded = nrs.load_scene(document.save(tmp_path / "a.glb"), virtual=virtual)
        assert isinstance(loaded.instances["body"][0].mesh, nrs.SkinnedMesh) == (
            is_skinned and virtual == "always"
        )
        with nrs.Renderer(96, 96, backend="cpu") as renderer:
            pictures.append(renderer.render(loaded.scene, CAMERA, POSE, pixel_error=0.0).depth)
    plain, skinned = pictures
    assert (plain > 0).sum() > 500
    assert ((plain > 0) != (skinned > 0)).sum() < 5
    assert np.abs(plain - skinned)[(plain > 0) & (skinned > 0)].max() < 0.001


def test_nodes_share_what_joints_bend(tmp_path):
    document = Document()
    joints, skin, _, _, attributes = rig(document)
    body = document.mesh(surface(document, **attributes), skin=skin, name="body")
    mesh = document.json["nodes"][body]["mesh"]
    more = [document.row("nodes", mesh=mesh, skin=skin, name=f"more {k}") for k in range(2)]
    document.row("scenes", nodes=[joints[0], body, *more])
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"), virtual="always")
    meshes = [own[0].mesh for own in loaded.instances.values()]
    assert len(meshes) == 3
    assert all(own.rest is meshes[0].rest for own in meshes)


@pytest.mark.parametrize("kind", ["STEP", "LINEAR", "CUBICSPLINE"])
def test_morph_targets_follow_their_weights(kind, tmp_path):
    document = Document()
    primitive = surface(document)
    moves = RNG.normal(size=(2, *TUBE.shape)).astype(np.float32) * 0.1
    sparse = np.zeros_like(TUBE)
    rows = np.arange(0, len(TUBE), 7, dtype=np.uint16)
    sparse[rows] = moves[1][rows]
    second = document.accessor(np.zeros_like(TUBE), sparse=(rows, moves[1][rows]), stored=False)
    primitive["targets"] = [{"POSITION": document.accessor(moves[0])}, {"POSITION": second}]
    mesh = document.row("meshes", primitives=[primitive], weights=[0.25, 0.5])
    still = document.row("nodes", mesh=mesh, name="still", translation=[1.0, 0.0, 0.0])
    moving = document.row("nodes", mesh=mesh, name="moving")
    document.row("scenes", nodes=[still, moving])
    values = keys("weights", kind)
    animate(document, (moving, "weights", values, kind))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"), virtual="never")
    ((first,), (second_,)) = loaded.instances["still"], loaded.instances["moving"]
    at_rest = TUBE + 0.25 * moves[0].astype(np.float64) + 0.5 * sparse
    np.testing.assert_allclose(first.mesh.vertices, at_rest, atol=1e-6)
    np.testing.assert_allclose(second_.mesh.vertices, at_rest, atol=1e-6)
    for time in INSTANTS:
        loaded.set_time(time)
        a, b = expected("weights", kind, values.reshape(-1, 2), time)
        np.testing.assert_allclose(second_.mesh.vertices, TUBE + a * moves[0] + b * sparse, atol=2e-6)
        np.testing.assert_allclose(first.mesh.vertices, at_rest, atol=1e-6)


def test_morphs_come_before_skins(tmp_path):
    document = Document()
    joints, skin, inverse, influences, attributes = rig(document)
    primitive = surface(document, **attributes)
    move = RNG.normal(size=TUBE.shape).astype(np.float32) * 0.1
    primitive["targets"] = [{"POSITION": document.accessor(move)}]
    mesh = document.row("meshes", primitives=[primitive], weights=[0.5])
    body = document.row("nodes", mesh=mesh, skin=skin, name="body")
    document.row("scenes", nodes=[body, joints[0], joints[3]])
    document.json["nodes"][joints[0]]["translation"] = [3.0, -1.0, 0.0]
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    places = [matrix((3, y, 0)) for y in (-1, 0, 1)] + [matrix((0.2, 0, 0.1), scale=(1.5, 0.5, 1))]
    wanted, _ = skinned(TUBE + 0.5 * move.astype(np.float64), places, inverse, influences)
    np.testing.assert_allclose(world(loaded.instances["body"][0]), wanted, atol=2e-6)
    assert loaded.animations == ()
    with pytest.raises(nrs.ArgumentError, match=r"^animation: there is no number 0 of 0"):
        loaded.set_time(0.0)


def test_lights_cameras_and_flat_nodes_follow(tmp_path):
    document = Document()
    ball = document.mesh(surface(document), name="ball", scale=[0.0, 0.0, 0.0])
    camera = document.row("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.1})
    document.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "directional"}]}}
    document.json["extensionsUsed"] = ["KHR_lights_punctual"]
    eye = document.row("nodes", camera=camera, translation=[0.0, 0.0, 5.0])
    lamp = document.row("nodes", extensions={"KHR_lights_punctual": {"light": 0}})
    document.row("scenes", nodes=[ball, eye, lamp])
    slides, turns = keys("translation", "LINEAR"), keys("rotation", "LINEAR")
    sizes = np.array([[0, 0, 0], [1, 1, 1], [1, 1, 1], [0, 0, 0]], np.float32)
    animate(
        document,
        (eye, "translation", slides, "LINEAR"),
        (lamp, "rotation", turns, "LINEAR"),
        (ball, "scale", sizes, "STEP"),
    )
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    (node,) = loaded.instances["ball"]
    assert not node.visible
    for time, seen in ((0.1, False), (0.7, True), (1.5, True), (2.5, False)):
        loaded.set_time(time)
        assert node.visible == seen
        wanted = matrix(expected("translation", "LINEAR", slides, time))
        np.testing.assert_allclose(loaded.cameras[0][1], wanted, atol=1e-6)
        wanted = matrix(rotation=expected("rotation", "LINEAR", turns, time))
        np.testing.assert_allclose(loaded.lights[0].pose, wanted, atol=1e-6)
    # Who hides it keeps it hidden.
    loaded.set_time(0.7)
    node.visible = False
    loaded.set_time(2.5)
    loaded.set_time(0.7)
    assert not node.visible


def test_fixed_point_keys_are_read(tmp_path):
    document = Document()
    ball = document.mesh(surface(document), name="ball")
    document.row("scenes", nodes=[ball])
    turns = unit(RNG.normal(size=(4, 4)))
    stored = np.round(turns * 32767).astype(np.int16)
    animate(document, (ball, "rotation", stored, "LINEAR"))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    loaded.set_time(0.5)
    np.testing.assert_allclose(loaded.instances["ball"][0].pose, matrix(rotation=turns[1]), atol=1e-4)


def test_pictures_are_those_of_meshes_made_so(tmp_path, backend):
    document = Document()
    joints, skin, _, _, attributes = rig(document)
    body = document.mesh(surface(document, **attributes), skin=skin, name="body")
    document.row("scenes", nodes=[joints[0], joints[3], body])
    animate(document, (joints[1], "rotation", keys("rotation", "LINEAR"), "LINEAR"))
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    loaded.scene.ambient_light = (0.5, 0.5, 0.5)
    (node,) = loaded.instances["body"]
    with nrs.Renderer(160, 120, backend=backend) as renderer:
        for time in (0.0, 0.4, 1.1):
            loaded.set_time(time)
            frame = renderer.render(loaded.scene, CAMERA, POSE)
            fresh = nrs.Scene(ambient_light=(0.5, 0.5, 0.5))
            fresh.add(nrs.TriangleMesh(node.mesh.vertices, TUBE_FACES), material=node.material)
            other = renderer.render(fresh, CAMERA, POSE)
            np.testing.assert_array_equal(frame.color, other.color)
            np.testing.assert_array_equal(frame.face_id, other.face_id)
            assert (frame.depth > 0).sum() > 500


DAMAGE = {
    "a node that is not there": lambda d: d["animations"][0]["channels"][0]["target"].update(node=99),
    "a sampler that is not there": lambda d: d["animations"][0]["channels"][0].update(sampler=9),
    "an interpolation nobody knows": lambda d: d["animations"][0]["samplers"][0].update(interpolation="BEST"),
    "keys of another path": lambda d: d["animations"][0]["channels"][0]["target"].update(path="scale"),
    "times that are values": lambda d: d["animations"][0]["samplers"][0].update(
        input=d["animations"][0]["samplers"][0]["output"]
    ),
    "joints that are not there": lambda d: d["skins"][0].update(joints=[0, 99]),
    "no joints": lambda d: d["skins"][0].update(joints=[]),
    "fewer joints than are named": lambda d: d["skins"][0].update(joints=d["skins"][0]["joints"][:1]),
    "matrices of another kind": lambda d: d["skins"][0].update(inverseBindMatrices=1),
    "nodes below themselves": lambda d: d["nodes"][2].update(children=[0]),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_is_named(what, tmp_path):
    document = Document()
    joints, skin, _, _, attributes = rig(document)
    body = document.mesh(surface(document, **attributes), skin=skin, name="body")
    document.row("scenes", nodes=[joints[3], body])
    animate(document, (joints[1], "rotation", keys("rotation", "LINEAR"), "LINEAR"))
    DAMAGE[what](document.json)
    with pytest.raises(nrs.FormatError, match=r"a\.glb"):
        nrs.load_scene(document.save(tmp_path / "a.glb"))


def test_mistakes_are_named(tmp_path):
    document = Document()
    ball = document.mesh(surface(document), name="ball")
    animate(document, (ball, "rotation", keys("rotation", "LINEAR"), "LINEAR"), name="spin")
    animate(document, (ball, "translation", keys("translation", "LINEAR"), "LINEAR"), name="slide")
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    assert str(loaded.animations) == "(<Animation 'spin': 2 s>, <Animation 'slide': 2 s>)"
    loaded.set_time(0.3, "slide")
    assert np.allclose(loaded.instances["ball"][0].pose[:3, :3], np.eye(3))
    loaded.set_time(0.3, 0)
    assert np.allclose(loaded.instances["ball"][0].pose[:3, 3], 0)
    for arguments, message in (
        ((np.nan,), "^time: must be finite"),
        ((0.0, "walk"), r"^animation: there is no 'walk' among \['spin', 'slide'\]"),
        ((0.0, 2), "^animation: there is no number 2 of 2"),
        ((0.0, -1), "^animation: there is no number -1 of 2"),
    ):
        with pytest.raises(nrs.ArgumentError, match=message):
            loaded.set_time(*arguments)
    with pytest.raises(nrs.DtypeError, match=r"^time: "):
        loaded.set_time("now")
    loaded.instances["ball"][0].remove()
    with pytest.raises(nrs.StaleHandleError):
        loaded.set_time(0.0)


def test_the_command_line_shows_a_time(tmp_path):
    document = Document()
    ball = document.mesh(surface(document), name="ball")
    slides = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 3, 0]], np.float32)
    animate(document, (ball, "translation", slides, "LINEAR"), name="up")
    other = document.mesh(surface(document), translation=[2.0, 0.0, 0.0])
    document.row("scenes", nodes=[ball, other])
    path = document.save(tmp_path / "a.glb")
    pictures = []
    for options in (["--materials"], ["--time", "0"], ["--time", "2", "--animation", "up"]):
        output = tmp_path / f"{len(pictures)}.png"
        arguments = ["render", str(path), "-o", str(output), "--size", "96x64", "--backend", "cpu", "-q"]
        assert cli.main([*arguments, *options]) == 0
        pictures.append(np.asarray(PIL.Image.open(output)).astype(int))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert np.abs(pictures[2] - pictures[0]).max() > 50
    assert (
        cli.main(["render", str(path), "-o", str(tmp_path / "b.png"), "--time", "1", "--animation", "x"]) != 0
    )


def test_copies_and_pickles_play_by_themselves(tmp_path):
    document = Document()
    joints, skin, _, _, attributes = rig(document)
    body = document.mesh(surface(document, **attributes), skin=skin, name="body")
    ball = document.mesh(surface(document), name="ball")
    document.row("scenes", nodes=[joints[0], joints[3], body, ball])
    animate(
        document,
        (joints[1], "rotation", keys("rotation", "LINEAR"), "LINEAR"),
        (ball, "translation", keys("translation", "LINEAR"), "LINEAR"),
    )
    loaded = nrs.load_scene(document.save(tmp_path / "a.glb"))
    loaded.set_time(1.1)
    expected = {name: world(node) for name, (node,) in loaded.instances.items()}
    loaded.set_time(0.0)
    for other in (pickle.loads(pickle.dumps(loaded)), copy.deepcopy(loaded)):
        at_rest = {name: world(node) for name, (node,) in loaded.instances.items()}
        other.set_time(1.1)
        for name, (node,) in other.instances.items():
            assert node.scene is other.scene is not loaded.scene
            np.testing.assert_array_equal(world(node), expected[name])
            np.testing.assert_array_equal(world(loaded.instances[name][0]), at_rest[name])
