"""Virtual meshes that follow waves: never farther from the moved source than stated, closed, drawn where they are.

Beside the displacement written down in NumPy, distances by libigl, and `TriangleMesh`, which is told where each
vertex goes. `-s` prints how tight bounds are.
"""

from __future__ import annotations

import copy
import functools
import pickle

import numpy as np
import pytest

import nanite_rs as nrs
from conftest import SOAK
from oracles import camera, cards, compare, subjects, topology
from oracles.distance import Surface

NAMES = ("sphere", "knot", "part", *(("gyroid", "terrain", "sheets", "armadillo") if SOAK else ()))
KINDS = ("as one", "bent", "running", "patches")
SAMPLES = 20_000 if SOAK else 4_000
TIMES = (0.0, 0.13, 0.4, 1.7, -2.3) if SOAK else (0.13, 1.7)


def channels_of(vertices: np.ndarray) -> dict[str, np.ndarray]:
    """Weights that grow along the longest axis, patches with phases of their own, and both signs."""
    span = np.ptp(vertices, axis=0)
    x = (vertices[:, span.argmax()] - vertices[:, span.argmax()].min()) / span.max()
    rng = np.random.default_rng(5)
    places = vertices[rng.choice(len(vertices), 6, replace=False)]
    nearest = np.linalg.norm(vertices[:, None] - places, axis=2).argmin(axis=1)
    rows = {"bend": x**2, "phase": rng.random(6)[nearest], "signed": np.sin(7.0 * x)}
    return {name: row.astype(np.float32) for name, row in rows.items()}


def waves_of(kind: str, size: float) -> list[nrs.Wave]:
    a = 0.05 * size
    if kind == "as one":
        return [nrs.Wave((a, 0, 0), 0.5), nrs.Wave((0, a, 0.5 * a), 0.3)]
    if kind == "bent":
        return [nrs.Wave((a, 2 * a, 0), 0.5, weight="bend"), nrs.Wave((0, 0, a), 1.1, weight="signed")]
    if kind == "running":
        run = 2.0 / size
        return [nrs.Wave((0, a, 0), 0.5, (run, 0.3 * run, 0)), nrs.Wave((a, 0, a), 0.4, (0, run, 0), "bend")]
    return [
        nrs.Wave((0.2 * a, 0, 0), 0.7, weight="bend", offset="phase"),
        nrs.Wave((0, a, 0), 0.2, weight="bend"),
    ]


def moved(vertices: np.ndarray, channels: dict, waves: list[nrs.Wave], time: float) -> np.ndarray:
    """The displacement as it is written down."""
    out = vertices.copy()
    for wave in waves:
        weight = 1.0 if wave.weight is None else channels[wave.weight].astype(float)
        phase = 0.0 if wave.offset is None else channels[wave.offset].astype(float)
        turns = wave.frequency * time % 1.0 + phase + vertices @ np.array(wave.vector)
        out += (weight * np.sin(2 * np.pi * turns))[:, None] * np.array(wave.amplitude)
    return out


@functools.cache
def mesh_of(name: str, quality: str = "best") -> tuple[nrs.NaniteMesh, np.ndarray, np.ndarray, dict]:
    source = subjects.subject(name)
    vertices = np.asarray(source.vertices, float)
    channels = channels_of(vertices)
    options = nrs.BuildOptions(quality=quality)
    mesh = nrs.NaniteMesh.from_arrays(
        source.vertices, source.faces, channels=channels, options=options, progress=False
    )
    return mesh, vertices, np.asarray(source.faces), channels


@functools.cache
def body(name: str, kind: str, quality: str = "best") -> tuple[nrs.SwayingMesh, np.ndarray, np.ndarray, dict]:
    mesh, vertices, faces, channels = mesh_of(name, quality)
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return nrs.SwayingMesh(mesh, waves_of(kind, size)), vertices, faces, channels


@pytest.mark.parametrize("quality", ["best", "fast"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_stated_errors_hold_at_any_time(name: str, kind: str, quality: str) -> None:
    mesh, vertices, faces, channels = body(name, kind, quality)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    ratios = []
    for time in TIMES:
        mesh.move(time)
        source = Surface(moved(vertices, channels, mesh.waves, time), faces)
        shown = set()
        for error in (0.003, 0.01, 0.03, 0.1, 0.3):
            cut = mesh.cut(error=error * diagonal)
            assert cut.error <= error * diagonal
            if len(cut) in shown:
                continue
            shown.add(len(cut))
            drawn = Surface(cut.vertices, cut.faces)
            out = source.nearest(drawn.samples(SAMPLES, 1))[0].max()
            back = drawn.nearest(source.samples(SAMPLES, 1))[0].max()
            worst = max(out, back)
            assert worst <= cut.error + 1e-6 * diagonal, f"{time} s: {worst} is stated as {cut.error}"
            if worst > 1e-5 * diagonal:
                ratios.append(cut.error / worst)
    if ratios:
        print(
            f"\n{name} | {kind} | {quality} | {min(ratios):.2f} | {np.median(ratios):.2f} | {max(ratios):.1f}"
        )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["sphere", "part"])
def test_full_detail_is_the_moved_source(name: str, kind: str) -> None:
    mesh, vertices, faces, channels = body(name, kind)
    mesh.move(0.77)
    cut, expected = mesh.cut(error=0.0), moved(vertices, channels, mesh.waves, 0.77)
    span = np.ptp(expected, axis=0).max()
    assert len(cut) == len(faces)
    assert cut.error < 1e-6 * span
    assert Surface(expected, faces).nearest(cut.vertices)[0].max() < 1e-6 * span
    assert Surface(cut.vertices, cut.faces).nearest(expected)[0].max() < 1e-6 * span
    gone = np.linalg.norm(expected - vertices, axis=1).max()
    assert 0 < gone <= mesh.largest


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["sphere", "knot", "part"])
def test_no_time_opens_a_cut(name: str, kind: str) -> None:
    mesh, vertices, faces, _ = body(name, kind)
    if not topology.is_closed(topology.by_position(vertices, faces)):
        pytest.fail(f"{name} is open")
    for time in (0.1, 0.6, 5.3):
        mesh.move(time)
        for error in (0.003, 0.02, 0.1, 0.5):
            cut = mesh.cut(error=error)
            assert topology.is_closed(topology.by_position(cut.vertices, cut.faces))


def test_bounds_hold_at_all_times() -> None:
    mesh, vertices, _, channels = body("knot", "running")
    low, high = mesh.bounds
    for step in range(200):
        points = moved(vertices, channels, mesh.waves, 0.037 * step)
        assert (points >= low).all()
        assert (points <= high).all()


def test_all_at_once_costs_nothing() -> None:
    mesh, _, _, _ = body("sphere", "as one")
    assert mesh.lipschitz == 0.0
    for time in (0.0, 0.4):
        mesh.move(time)
        for error in (0.005, 0.02, 0.1):
            there, at_rest = mesh.cut(error=error), mesh.rest.cut(error=error)
            assert abs(len(there) - len(at_rest)) <= 0.02 * len(at_rest)


def test_lipschitz_is_as_written() -> None:
    mesh, _, _, channels = body("part", "running")
    slopes = [
        2
        * np.pi
        * np.linalg.norm(wave.amplitude)
        * np.linalg.norm(wave.vector)
        * (1.0 if wave.weight is None else np.abs(channels[wave.weight]).max())
        for wave in mesh.waves
    ]
    assert mesh.lipschitz == pytest.approx(sum(slopes), rel=1e-6)


def stage(shape: nrs.SwayingMesh | nrs.TriangleMesh) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    scene.add(shape, material=nrs.Material(base_color=(0.8, 0.7, 0.6)))
    floor = np.array([[-4, -1.5, -4], [4, -1.5, -4], [4, -1.5, 4], [-4, -1.5, 4]], float)
    scene.add(nrs.TriangleMesh(floor, [[0, 2, 1], [0, 3, 2]]))
    scene.add(nrs.DirectionalLight(intensity=2.0), pose=camera.look_at((2, 3, 3), (0, 0, 0)))
    return scene


LENS, SEEN = nrs.PerspectiveCamera(yfov=0.9), camera.look_at((0.5, 1.0, 7.0), (0.0, 0.0, 0.0))


def picture(shape: nrs.SwayingMesh | nrs.TriangleMesh, **options) -> nrs.Frame:
    with nrs.Renderer(320, 240, backend="cpu") as renderer:
        return renderer.render(stage(shape), LENS, SEEN, **options)


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_those_of_every_vertex_where_it_goes(kind: str) -> None:
    mesh, vertices, faces, channels = body("part", kind)
    mesh.move(0.4)
    assert len(mesh.rest.cut(error=0.0).vertices) == len(vertices)
    whole = nrs.TriangleMesh(moved(vertices, channels, mesh.waves, 0.4), faces)
    ours, theirs = picture(mesh, pixel_error=0.0), picture(whole)
    both = (ours.depth > 0) & (theirs.depth > 0)
    assert ((ours.depth > 0) != (theirs.depth > 0)).sum() < 20
    assert np.percentile(np.abs(ours.depth - theirs.depth)[both], 99) < 1e-4
    coarse = picture(mesh)
    assert coarse.stats.triangles <= ours.stats.triangles
    assert compare.psnr(coarse.color, ours.color) > 30


def test_culling_changes_nothing() -> None:
    mesh, _, _, _ = body("knot", "running")
    mesh.move(0.9)
    culled, all_drawn = picture(mesh), picture(mesh, occlusion=False)
    assert (culled.color == all_drawn.color).all()
    assert (culled.depth == all_drawn.depth).all()


def test_shadows_follow() -> None:
    """What a renderer that has seen other times draws is what a new one draws."""
    mesh, _, _, _ = body("part", "bent")
    scene = stage(mesh)
    with nrs.Renderer(320, 240, backend="cpu") as renderer:
        for time in (0.0, 0.3, 0.5, 2.0):
            mesh.move(time)
            frame = renderer.render(scene, LENS, SEEN, shadows=True)
            assert (frame.color == picture(mesh, shadows=True).color).all()
            assert frame.stats.shadows.drawn_pages > 0
        still = renderer.render(scene, LENS, SEEN, shadows=True)
    assert still.stats.shadows.drawn_pages == 0
    assert (still.color == frame.color).all()
    assert not (frame.color == picture(mesh).color).all()


def test_device_draws_the_same() -> None:
    try:
        device = nrs.Renderer(160, 120, backend="gpu")
    except nrs.BackendError as error:
        pytest.skip(str(error))
    mesh, _, _, _ = body("knot", "patches")
    scene, uploaded = stage(mesh), []
    with device, nrs.Renderer(160, 120, backend="cpu") as host:
        for step in range(12):
            mesh.move(0.21 * step)
            frames = [r.render(scene, LENS, SEEN, shadows=step % 2 == 1) for r in (device, host)]
            for name in ("depth", "instance_id", "triangle_id"):
                assert (getattr(frames[0], name) == getattr(frames[1], name)).all(), name
            assert compare.psnr(frames[0].color, frames[1].color) > 45
            uploaded.append(frames[0].stats.uploaded_mesh_bytes)
    # Positions alone, of a mesh that is there.
    assert min(uploaded[1:]) > 0
    assert max(uploaded[1:]) < 0.8 * uploaded[0]


def test_motion_is_where_vertices_went() -> None:
    mesh = nrs.SwayingMesh(mesh_of("sphere")[0], [nrs.Wave((0.25, 0, 0), 0.25)])
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    lens, pose = nrs.OrthographicCamera(xmag=2.0, ymag=2.0), camera.at(0, 0, 5)
    with nrs.Renderer(128, 128, backend="cpu") as renderer:
        renderer.render(scene, lens, pose, motion=True)
        mesh.move(1.0)
        frame = renderer.render(scene, lens, pose, motion=True)
    assert np.abs(frame.motion[frame.depth > 0] - (8.0, 0.0)).max() < 0.02


def test_copies_have_times_of_their_own(tmp_path) -> None:
    mesh, _, _, _ = body("sphere", "bent")
    mesh.move(0.6)
    cut = mesh.cut(error=0.02)
    for other in (copy.copy(mesh), copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        assert other.time == 0.6
        assert (other.cut(error=0.02).vertices == cut.vertices).all()
        other.move(0.1)
        assert not np.array_equal(other.cut(error=0.02).vertices, cut.vertices)
    assert mesh.time == 0.6
    assert (mesh.cut(error=0.02).vertices == cut.vertices).all()
    mesh.rest.save(tmp_path / "body.nanite")
    stored = nrs.SwayingMesh(nrs.NaniteMesh.open(tmp_path / "body.nanite"), mesh.waves)
    stored.move(0.6)
    there = stored.cut(error=0.02)
    assert Surface(cut.vertices, cut.faces).nearest(there.vertices)[0].max() < cut.error + there.error


def test_far_times_and_wide_waves_do_no_harm() -> None:
    rest, vertices, _, channels = mesh_of("sphere")
    for amplitude, time in ((0.1, 1e12), (1e-30, 0.3), (1e12, 0.3), (0.0, 0.3)):
        mesh = nrs.SwayingMesh(rest, [nrs.Wave((amplitude, 0, 0), 0.5, weight="bend")])
        mesh.move(time)
        cut = mesh.cut(error=0.0)
        expected = moved(vertices, channels, mesh.waves, time)
        assert np.abs(np.sort(cut.vertices[:, 0]) - np.sort(expected[:, 0])).max() <= cut.error + 1e-7
        picture(mesh)
    with pytest.raises(nrs.ArgumentError, match="beyond what float64 holds"):
        nrs.SwayingMesh(rest, [nrs.Wave((1e308, 1e308, 0)), nrs.Wave((1e308, 1e308, 0))])
    resting = nrs.SwayingMesh(rest, [])
    assert (resting.largest, resting.lipschitz) == (0.0, 0.0)
    assert len(resting.cut(error=0.02)) == len(rest.cut(error=0.02))


def test_mistakes_are_named() -> None:
    mesh, _, _, _ = body("sphere", "bent")
    mesh.move(0.25)
    with pytest.raises(nrs.ArgumentError, match='waves: the mesh has no channel "wind"'):
        nrs.SwayingMesh(mesh.rest, [nrs.Wave((1, 0, 0), weight="wind")])
    with pytest.raises(nrs.DtypeError, match="mesh: expected a NaniteMesh"):
        nrs.SwayingMesh(nrs.TriangleMesh(*nrs.shapes.icosphere(faces=20)), [])
    with pytest.raises(nrs.DtypeError, match=r"waves\[1\]: expected a Wave, not tuple"):
        nrs.SwayingMesh(mesh.rest, [nrs.Wave((1, 0, 0)), (1, 0, 0)])
    with pytest.raises(nrs.DtypeError, match="waves: expected a sequence of Wave, not Wave"):
        nrs.SwayingMesh(mesh.rest, nrs.Wave((1, 0, 0)))
    with pytest.raises(nrs.ArgumentError, match="amplitude: must be finite"):
        nrs.Wave((np.nan, 0, 0))
    with pytest.raises(nrs.ArgumentError, match=r"amplitude: expected shape \(3,\), found \(2,\)"):
        nrs.Wave((1, 0))
    with pytest.raises(nrs.ArgumentError, match="frequency: must be finite"):
        nrs.Wave((1, 0, 0), np.inf)
    with pytest.raises(nrs.DtypeError, match="weight: expected the name of a channel, not int"):
        nrs.Wave((1, 0, 0), weight=3)
    with pytest.raises(nrs.ArgumentError, match="time: must be finite"):
        mesh.move(np.nan)
    assert mesh.time == 0.25
    points, faces = nrs.shapes.icosphere(faces=20)
    given = {
        "label": np.arange(12),
        "pair": np.zeros((12, 2), np.float32),
        "far": np.full(12, 1e6, np.float32),
    }
    wrong = nrs.NaniteMesh.from_arrays(points, faces, channels=given)
    for name, message in (("label", "found 1 of int64"), ("pair", "found 2 of float32")):
        with pytest.raises(nrs.ArgumentError, match=f'waves: channel "{name}": .*{message}'):
            nrs.SwayingMesh(wrong, [nrs.Wave((1, 0, 0), weight=name)])
    with pytest.raises(nrs.ArgumentError, match="wave 1 has an offset of 1000000 turns"):
        nrs.SwayingMesh(wrong, [nrs.Wave((1, 0, 0)), nrs.Wave((1, 0, 0), offset="far")])


def test_trees_in_a_breeze() -> None:
    arrays = cards.tree("bent", 8)
    tree = nrs.foliage.to_geometry(nrs.TriangleMesh(**arrays), wind=True)
    bend, flutter = tree.channels["wind_bend"], tree.channels["wind_flutter"]
    assert (bend.min(), bend.max()) == (0.0, 1.0)
    trunk = np.unique(tree.faces[tree.face_materials == 0])
    assert (flutter[trunk] == 0).all()
    leaves = np.setdiff1d(np.arange(len(flutter)), trunk)
    away = np.linalg.norm(tree.vertices - tree.channels["wind_pivot"], axis=1)
    assert flutter[leaves] == pytest.approx(away[leaves], abs=1e-5)
    mesh = tree.build(progress=False)
    swaying = nrs.SwayingMesh(mesh, nrs.foliage.breeze(mesh))
    assert 0 < swaying.largest < 0.2 * np.ptp(mesh.bounds[:, 1])
    still = swaying.cut(error=0.0).vertices
    swaying.move(0.7)
    gone = np.linalg.norm(swaying.cut(error=0.0).vertices - still, axis=1)
    assert 0 < gone.max() <= 2 * swaying.largest
    calm = nrs.SwayingMesh(mesh, nrs.foliage.breeze(mesh, strength=0.0))
    assert calm.largest == 0.0
    with pytest.raises(nrs.ArgumentError, match="mesh: has no channel 'wind_bend'"):
        nrs.foliage.breeze(body("sphere", "bent")[0].rest)
    with pytest.raises(nrs.ArgumentError, match="direction: must not be 0"):
        nrs.foliage.breeze(mesh, direction=(0, 0, 0))
