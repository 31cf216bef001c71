"""The viewer: its state and pictures by themselves, on canvases without a screen, and in a window under Xvfb."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import nanite_rs as nrs
from nanite_rs import _paint
from nanite_rs._canvas import Budget, stepped
from nanite_rs._frozen import cut_of
from nanite_rs._picking import projected
from oracles.camera import at
from oracles.desk import Desk, screen

SIZE = {"width": 200, "height": 150}


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=60_000))


@pytest.fixture
def viewer(mesh):
    with nrs.Viewer(mesh, **SIZE, backend="cpu") as made:
        yield made


def scene_of(mesh: nrs.NaniteMesh) -> nrs.Scene:
    """Instances that are moved, turned, mirrored and scaled, and one behind the others."""
    scene = nrs.Scene(ambient_light=(0.3, 0.3, 0.3))
    turned = at(1.4) @ np.diag([-0.7, 0.7, 0.7, 1.0])
    c, s = np.cos(0.7), np.sin(0.7)
    turned[:3, :3] = turned[:3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    scene.add(mesh, pose=at(-1.4))
    scene.add(mesh, pose=turned, material=nrs.Material(base_color=(0.8, 0.3, 0.2), double_sided=True))
    scene.add(mesh, pose=at(-2.9, 0, -12) @ np.diag([0.05, 0.05, 0.05, 1.0]))
    return scene


def covered(viewer: nrs.Viewer) -> np.ndarray:
    return viewer.frame().depth > 0


# ------------------------------------------------------------------------------------------------- camera


def test_turning_keeps_the_distance_and_the_pivot_in_the_middle(viewer) -> None:
    orbit = viewer.orbit
    distance, pivot = orbit.distance, orbit.pivot.copy()
    for right, upward in ((0.3, 0.2), (3.0, -0.9), (-1.0, 5.0)):
        before = orbit.pose
        orbit.turn(right, upward)
        pose = orbit.pose
        assert not np.allclose(pose, before)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert np.linalg.norm(pose[:3, 3] - pivot) == pytest.approx(distance)
        np.testing.assert_allclose(pose[:3, 3] - pose[:3, 2] * distance, pivot, atol=1e-12)
    # It ends above: what is up in the picture never turns over.
    assert orbit.elevation == np.pi / 2
    assert orbit.pose[1, 2] == pytest.approx(1.0)


@pytest.mark.parametrize(("up", "above"), [("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_up_is_up(mesh, up, above) -> None:
    with nrs.Viewer(mesh, **SIZE, up=up, elevation=0.0, backend="cpu") as viewer:
        for azimuth in (0.0, 2.0):
            viewer.orbit.azimuth = azimuth
            np.testing.assert_allclose(viewer.orbit.pose[:3, 1], above, atol=1e-12)


def test_panning_moves_the_surface_with_the_pointer(viewer) -> None:
    """By a tenth of the height: what was in the middle is a tenth farther to the left and down."""
    viewer.center_on(100, 75)
    found = viewer.pick(100, 75)
    assert found.position == pytest.approx(viewer.orbit.pivot, abs=0.02)
    pivot, distance = viewer.orbit.pivot.copy(), viewer.orbit.distance
    viewer.orbit.pan(0.1, 0.1)
    assert viewer.orbit.distance == distance
    moved = viewer.orbit.pivot - pivot
    assert np.linalg.norm(moved) == pytest.approx(np.hypot(0.1, 0.1) * 2 * distance * np.tan(np.pi / 8))
    assert moved @ viewer.orbit.pose[:3, 2] == pytest.approx(0.0, abs=1e-12)
    again = viewer.pick(100 - 15, 75 + 15)
    assert again.position == pytest.approx(found.position, abs=0.02)


def test_zooming_divides_the_distance(viewer) -> None:
    distance, pixels = viewer.orbit.distance, covered(viewer).sum()
    viewer.orbit.zoom(0.5)
    assert viewer.orbit.distance == pytest.approx(2 * distance)
    assert 0 < covered(viewer).sum() < 0.4 * pixels
    viewer.orbit.zoom(1e300)
    assert 0.0 < viewer.orbit.distance < 1e-20


def test_everything_is_in_sight_at_first_and_after_a_reset(mesh) -> None:
    for shown in (mesh, scene_of(mesh)):
        with nrs.Viewer(shown, **SIZE, backend="cpu") as viewer:
            first = viewer.image()
            shows = covered(viewer)
            assert shows.any()
            assert not shows[[0, -1]].any()
            assert not shows[:, [0, -1]].any()
            viewer.orbit.turn(1.0, 0.5)
            viewer.orbit.zoom(3.0)
            viewer.orbit.pan(0.2, 0.1)
            assert (viewer.image() != first).any()
            viewer.reset()
            np.testing.assert_array_equal(viewer.image(), first)


def test_centering_keeps_what_is_seen_at_its_distance(viewer) -> None:
    found = viewer.pick(60, 60)
    assert viewer.center_on(60, 60)
    np.testing.assert_allclose(viewer.orbit.pivot, found.position)
    assert viewer.orbit.distance == pytest.approx(found.depth)
    middle = viewer.pick(100, 75)
    assert middle.position == pytest.approx(found.position, abs=0.02)
    before = viewer.orbit.pivot.copy()
    assert not viewer.center_on(0, 0)
    np.testing.assert_array_equal(viewer.orbit.pivot, before)


# ------------------------------------------------------------------------------------------------ pictures


@pytest.mark.parametrize("name", ["triangles", "clusters", "groups", "levels", "rasterizers", "overdraw"])
def test_views_of_frames_are_those_of_the_frame(viewer, name) -> None:
    viewer.view = name
    shows = covered(viewer)
    picture = viewer.image()
    np.testing.assert_array_equal(picture[shows], viewer.frame().view(name)[shows])
    background = np.rint(255 * np.array(viewer.scene.bg_color))
    assert (picture[~shows] == background).all()


def test_the_shaded_view_is_the_frame_of_several_samples(mesh, viewer) -> None:
    still, moving = viewer.image(), viewer.image(moving=True)
    for picture, samples in ((still, 4), (moving, 1)):
        frame = viewer.frame(samples=samples)
        assert frame.stats.samples == samples
        np.testing.assert_array_equal(picture, frame.color)
    assert (still != moving).any()


def test_other_views_show_what_they_say(mesh) -> None:
    with nrs.Viewer(scene_of(mesh), **SIZE, backend="cpu", elevation=0, azimuth=0) as viewer:
        frame, shows = viewer.frame(), covered(viewer)
        pictures = {}
        for viewer.view in ("normals", "pages", "instances", "sizes"):
            pictures[viewer.view] = viewer.image()
        expected = np.rint(127.5 * frame.normal[shows] + 127.5)
        np.testing.assert_array_equal(pictures["normals"][shows], expected)

        # Facing only darkens: what has one colour has one ratio of channels.
        def kinds(name: str, of: np.ndarray) -> None:
            found = {}
            for what, color in zip(of[shows].tolist(), pictures[name][shows].astype(float), strict=True):
                found.setdefault(what, []).append(color / color.max())
            assert len(found) > 1
            means = []
            for colors in found.values():
                assert np.ptp(colors, axis=0).max() < 0.03
                means.append(np.mean(colors, axis=0))
            distance = np.abs(np.array(means)[:, None] - np.array(means)).max(axis=-1)
            assert (distance + np.eye(len(means)) > 0.01).all()

        kinds("instances", frame.instance_id)
        kinds("pages", frame.instance_id * 1000 + (frame.cluster_id >> 8).astype(int))


def test_sizes_count_the_pixels_of_triangles() -> None:
    ids = [np.array(a, np.uint32) for a in ([0, 0, 0, 0, 1], [5, 5, 5, 5, 5], [1, 1, 1, 2, 1])]
    colors = _paint.sizes(*ids)
    assert (colors[0] == colors[1]).all()
    assert (colors[0] == colors[2]).all()
    assert (colors[3] == colors[4]).all()
    np.testing.assert_allclose(colors[3], [0.97, 0.12, 0.12], atol=1e-6)  # one pixel: red
    assert colors[0, 1] > colors[3, 1]


def test_the_pixel_error_chooses_the_cut(viewer) -> None:
    triangles = []
    for viewer.pixel_error in (0.0, 1.0, 4.0, 16.0):
        viewer.image()
        triangles.append(viewer.stats.triangles)
    assert triangles[0] > 30_000
    assert (np.diff(triangles) < 0).all()


def test_small_pictures_are_small(viewer) -> None:
    assert viewer.image(moving=True, scale=0.5).shape == (75, 100, 3)
    whole, half = viewer.frame(), viewer.frame(scale=0.5)
    assert (half.depth > 0).mean() == pytest.approx((whole.depth > 0).mean(), abs=0.02)
    viewer.resize(90, 60)
    assert viewer.image().shape == (60, 90, 3)


def test_lights_follow_the_camera_and_leave_with_the_viewer(mesh) -> None:
    scene = nrs.Scene()
    scene.add(mesh)
    with nrs.Viewer(scene, **SIZE, backend="cpu") as viewer:
        for azimuth in (0.0, 2.0, 4.0):
            viewer.orbit.azimuth = azimuth
            frame = viewer.frame()
            assert np.median(frame.color[frame.depth > 0]) > 60
        assert scene._core.light_count == 2
    assert scene._core.light_count == 0
    assert tuple(scene.ambient_light) == (0.0, 0.0, 0.0)
    scene.add(nrs.DirectionalLight())
    with nrs.Viewer(scene, **SIZE, backend="cpu"):
        assert scene._core.light_count == 1


def test_saving_writes_the_picture(viewer, tmp_path) -> None:
    viewer.view = "clusters"
    viewer.save(tmp_path / "shot.png")
    with Image.open(tmp_path / "shot.png") as image:
        np.testing.assert_array_equal(np.asarray(image), viewer.image())
        assert image.text["nanite_rs:view"] == "clusters"
    with pytest.raises(nrs.ArgumentError, match=r"^path: "):
        viewer.save(tmp_path / "shot.exr")


# ------------------------------------------------------------------------------------------------- picking


def test_picks_are_what_the_arrays_of_the_frame_say(mesh) -> None:
    scene = scene_of(mesh)
    nodes = {node.instance_id: node for node in scene.instances}
    with nrs.Viewer(scene, **SIZE, backend="cpu", pixel_error=0.7) as viewer:
        frame = viewer.frame()
        rng = np.random.default_rng(1)
        seen = set()
        for x, y in rng.integers(0, [SIZE["width"], SIZE["height"]], (300, 2)).tolist():
            found = viewer.pick(x + 0.3, y + 0.8)
            if frame.depth[y, x] == 0:
                assert found is None
                continue
            seen.add(found.instance_id)
            ids = found.instance_id, found.cluster_id, found.triangle_id
            arrays = frame.instance_id, frame.cluster_id, frame.triangle_id
            assert ids == tuple(int(a[y, x]) for a in arrays)
            assert (found.x, found.y, found.depth) == (x, y, frame.depth[y, x])
            # The rule of the cut, which the renderer holds in f32.
            assert 0.0 <= found.pixels <= viewer.pixel_error * (1 + 1e-4)
            assert (found.error == 0.0) == (found.level == 0)
            # The point lies in the plane of the triangle that is named.
            cut = cut_of(nodes[found.instance_id], viewer._at_full_size(), viewer.pixel_error)
            (row,) = np.flatnonzero(cut.cluster_ids == found.cluster_id)
            assert cut.cluster_levels[row] == found.level
            face = cut.faces[cut._first_face[row] + found.triangle_id]
            pose = nodes[found.instance_id].pose
            a, b, c = cut.vertices[face].astype(float) @ pose[:3, :3].T + pose[:3, 3]
            normal = np.cross(b - a, c - a)
            off = abs((np.array(found.position) - a) @ normal) / np.linalg.norm(normal)
            assert off < 1e-4 * found.depth
        assert len(seen) >= 2


def test_what_is_coarser_would_be_above_the_pixel_error(viewer) -> None:
    """The other half of the rule: a cluster is drawn where what replaces it is off by more."""
    frame = viewer.frame()
    table = nrs._core.cluster_table(viewer.scene.instances[0].mesh._core)
    groups = nrs._core.group_table(viewer.scene.instances[0].mesh._core)
    clusters = np.unique(frame.cluster_id[frame.depth > 0])
    rows = np.searchsorted(table["id"], clusters)
    assert len(rows) > 20
    for row in rows:
        group = table["group"][row]
        args = viewer._at_full_size(), viewer.scene.instances[0], groups["sphere"][group]
        assert projected(*args, groups["error"][group]) > viewer.pixel_error * (1 - 1e-4)


def test_rows_of_the_source_are_picked_where_they_are_kept() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=5_000)
    options = nrs.BuildOptions(face_ids=True)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options)
    with nrs.Viewer(mesh, **SIZE, backend="cpu", pixel_error=0.0) as viewer:
        found = viewer.pick(100, 75)
        triangle = vertices[faces[found.face_id]]
        assert np.linalg.norm(triangle.mean(axis=0) - found.position) < np.ptp(triangle, axis=0).max()


def test_a_selected_cluster_is_tinted(viewer) -> None:
    before = viewer.image(moving=True)
    found = viewer.pick(100, 75, select=True)
    assert viewer.selected == found
    changed = (viewer.image(moving=True) != before).any(axis=-1)
    np.testing.assert_array_equal(changed, viewer.frame().cluster_id == found.cluster_id)
    assert viewer.selected_pixels == changed.sum()
    viewer.orbit.turn(np.pi, 0.0)
    viewer.image(moving=True)
    assert viewer.selected_pixels == 0
    viewer.orbit.turn(np.pi, 0.0)
    assert viewer.pick(0, 0, select=True) is None
    np.testing.assert_array_equal(viewer.image(moving=True), before)


# ------------------------------------------------------------------------------------------------ freezing


@pytest.mark.parametrize("name", ["mesh", "scene"])
def test_a_frozen_cut_shows_the_same_ids_from_its_camera(mesh, name) -> None:
    shown = mesh if name == "mesh" else scene_of(mesh)
    with nrs.Viewer(shown, **SIZE, backend="cpu", view="clusters", pixel_error=0.8) as viewer:
        live, ids = {}, viewer._take(1.0, None, True).ids
        names = ("shaded", "triangles", "clusters", "groups", "levels", "pages", "instances", "sizes")
        for viewer.view in names:
            live[viewer.view] = viewer.image(moving=True)
        viewer.freeze()
        frozen = viewer._take(1.0, None, True).ids
        same = np.ones(ids.instance.shape, bool)
        for array in ("instance", "cluster", "triangle"):
            same &= getattr(frozen, array) == getattr(ids, array)
        # Positions are rounded once more: a tie on an edge may fall to the neighbour.
        assert same.mean() > 0.999
        # What bounds its sight lies at the edges of the picture.
        inner = np.zeros_like(same)
        inner[2:-2, 2:-2] = same[2:-2, 2:-2]
        for viewer.view in names:
            difference = np.abs(viewer.image(moving=True).astype(int) - live[viewer.view]).max(axis=-1)
            assert (difference[inner] <= 2).mean() > 0.995, viewer.view


def test_freezing_holds_the_clusters_while_the_camera_moves(viewer) -> None:
    """Near enough for other clusters, which come back when it is thawed."""
    visible = np.unique(viewer.frame().cluster_id[covered(viewer)])
    viewer.freeze()
    assert viewer.frozen
    clusters = viewer.frozen_clusters
    assert np.isin(visible, clusters[:, 1]).all()
    for turn, zoom in ((0.5, 4.0), (2.0, 0.3)):
        viewer.orbit.turn(turn, 0.2)
        viewer.orbit.zoom(zoom)
        np.testing.assert_array_equal(viewer.frozen_clusters, clusters)
        shown = viewer._take(1.0, None, True).ids
        assert (shown.instance >= 0).any()
        assert np.isin(shown.cluster[shown.instance >= 0], clusters[:, 1]).all()
    viewer.reset()
    viewer.orbit.zoom(4.0)
    held = viewer.pick(100, 75)
    assert held.pixels > viewer.pixel_error
    viewer.orbit.zoom(0.25)
    assert viewer.pixels_now(held) <= viewer.pixel_error * (1 + 1e-4)  # where it was chosen
    viewer.orbit.zoom(4.0)
    assert viewer.pixels_now(held) == pytest.approx(held.pixels)
    viewer.thaw()
    assert not viewer.frozen
    assert len(viewer.frozen_clusters) == 0
    live = viewer.pick(100, 75)
    assert live.level < held.level
    assert live.pixels <= viewer.pixel_error


def test_a_frozen_cut_is_whole_and_what_was_not_seen_is_bluish(viewer) -> None:
    viewer.view = "clusters"
    viewer.freeze()
    seen = viewer._frozen.seen
    assert 0 < seen.sum() < len(seen)
    cut = cut_of(viewer.scene.instances[0], viewer._at_full_size(), viewer.pixel_error)
    assert viewer._frozen.triangles == len(cut)
    assert cut.to_trimesh().is_watertight
    viewer.orbit.turn(np.pi, 0.0)
    viewer.orbit.elevation *= -1
    picture = viewer.image().astype(int)
    rows = viewer._take(1.0, None, True).rows
    behind = (rows >= 0) & ~seen[rows]
    bluish = np.abs(picture[..., 2] - picture[..., 0] - 36) <= 1
    outline = (picture == (214, 69, 38)).all(axis=-1)
    assert behind.sum() > 0.9 * (rows >= 0).sum()
    assert (bluish | outline)[behind].all()
    assert outline.any()


def test_what_was_picked_may_leave_the_scene(mesh) -> None:
    scene = scene_of(mesh)
    with nrs.Viewer(scene, **SIZE, backend="cpu") as viewer:
        found = viewer.pick(*_first(viewer), select=True)
        (node,) = [node for node in scene.instances if node.instance_id == found.instance_id]
        node.remove()
        viewer.redraw()
        assert not (viewer._take(1.0, None, True).ids.instance == found.instance_id).any()
        viewer.image()
        with pytest.raises(nrs.StaleHandleError):
            viewer.pixels_now(found)


def test_of_a_scene_what_is_in_sight_stays(mesh) -> None:
    scene = scene_of(mesh)
    nodes = scene.instances
    nodes[0].visible = False
    with nrs.Viewer(scene, **SIZE, backend="cpu") as viewer:
        in_sight = set(np.unique(viewer.frame().instance_id).tolist()) - {-1}
        assert in_sight <= {1, 2}
        viewer.freeze()
        assert set(viewer.frozen_clusters[:, 0].tolist()) == in_sight
        viewer.orbit.zoom(0.5)
        assert viewer.pick(*_first(viewer)).instance_id in in_sight
    # What was hidden stays hidden, and everything else is as it was.
    assert scene.instances == nodes
    assert [node.visible for node in nodes] == [False, True, True]


def _first(viewer: nrs.Viewer) -> tuple[int, int]:
    y, x = np.argwhere(covered(viewer))[0]
    return int(x), int(y)


def test_another_error_freezes_the_same_camera_anew(viewer) -> None:
    viewer.freeze()
    fine = viewer._frozen
    viewer.orbit.zoom(10.0)
    viewer.pixel_error = 8.0
    assert viewer._frozen.triangles < fine.triangles
    np.testing.assert_array_equal(viewer._frozen.view.pose, fine.view.pose)
    assert len(viewer.scene.instances) == 2
    viewer.frozen = False
    assert len(viewer.scene.instances) == 1


def test_stretched_instances_are_frozen_at_least_as_fine(mesh) -> None:
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh, pose=np.diag([1.0, 0.4, 1.0, 1.0]))
    with nrs.Viewer(scene, **SIZE, backend="cpu") as viewer:
        ids = viewer._take(1.0, None, True).ids
        viewer.freeze()
        frozen = viewer._take(1.0, None, True)
        levels = nrs._core.cluster_table(mesh._core)
        shows = (ids.instance >= 0) & (frozen.rows >= 0)
        drawn = levels["level"][np.searchsorted(levels["id"], ids.cluster[shows])]
        assert (viewer._frozen.level[frozen.rows[shows]] <= drawn).mean() > 0.999


def test_meshes_in_files_are_streamed(mesh, tmp_path) -> None:
    mesh.save(tmp_path / "sphere.nanite", precision="exact")
    opened = nrs.NaniteMesh.open(tmp_path / "sphere.nanite")
    with nrs.Viewer(opened, **SIZE, backend="cpu", view="clusters") as viewer:
        picture = viewer.image()
        assert viewer.stats.stream.settled
        with nrs.Viewer(mesh, **SIZE, backend="cpu", view="clusters") as whole:
            np.testing.assert_array_equal(picture, whole.image())
            assert viewer.pick(100, 75) == whole.pick(100, 75)
            viewer.freeze()
            whole.freeze()
            np.testing.assert_array_equal(viewer.frozen_clusters, whole.frozen_clusters)


def test_a_gpu_shows_the_same(mesh) -> None:
    try:
        gpu = nrs.Viewer(scene_of(mesh), **SIZE, backend="gpu")
    except nrs.BackendError as error:
        pytest.skip(str(error))
    with gpu, nrs.Viewer(scene_of(mesh), **SIZE, backend="cpu") as cpu:
        for frozen in (False, True):
            gpu.frozen = cpu.frozen = frozen
            np.testing.assert_array_equal(gpu.frozen_clusters, cpu.frozen_clusters)
            for viewer in (gpu, cpu):
                viewer.orbit.turn(0.2 if frozen else 0.0, 0.0)
            for name in nrs.viewer.VIEWS:
                gpu.view = cpu.view = name
                difference = np.abs(gpu.image(moving=True).astype(int) - cpu.image(moving=True))
                assert (difference.max(axis=-1) <= 2).mean() > 0.999, (frozen, name)
            shows = np.argwhere(covered(cpu))
            y, x = shows[len(shows) // 2].tolist()
            assert gpu.pick(x, y).cluster_id == cpu.pick(x, y).cluster_id
        assert gpu.frame().metadata["backend"] == "gpu"


def test_pages_of_shadows_are_shown(mesh) -> None:
    for shadows in (True, "cascaded"):
        with nrs.Viewer(mesh, **SIZE, backend="cpu", shadows=shadows) as viewer:
            assert viewer.views == (*nrs.viewer.VIEWS, *nrs.viewer.SHADOW_VIEWS)
            for name in nrs.viewer.SHADOW_VIEWS:
                viewer.view = name
                image, shown = viewer.image(), covered(viewer)
                assert np.array_equal(image[shown], viewer.frame().view(name)[shown]), name
    with nrs.Viewer(mesh, **SIZE, backend="cpu") as viewer:
        assert viewer.views == nrs.viewer.VIEWS
        with pytest.raises(nrs.ArgumentError, match=r"^view: 'shadow_pages' needs Viewer\(shadows=True\)"):
            viewer.view = "shadow_pages"


# ------------------------------------------------------------------------------------------------ arguments


def test_arguments_that_cannot_be_are_refused(mesh, viewer) -> None:
    for options, message in (
        ({"view": "wire"}, r"^view: must be one of shaded, .*, not 'wire'"),
        ({"pixel_error": -1.0}, r"^pixel_error: must be 0 or more, not -1"),
        ({"pixel_error": "1"}, r"^pixel_error: expected a number, not str"),
        ({"width": 0}, r"^width, height: must be between 1 and 8192"),
        ({"up": "x"}, r'^up: must be "y" or "z", not \'x\''),
        ({"backend": "tpu"}, r"^backend: "),
    ):
        with pytest.raises(nrs.ArgumentError, match=message):
            nrs.Viewer(mesh, **options)
    with pytest.raises(nrs.DtypeError, match=r"^shown: expected a mesh, .*, not ndarray"):
        nrs.Viewer(np.zeros((3, 3)))
    with pytest.raises(nrs.ArgumentError, match=r"^shown: the scene has no instance"):
        nrs.Viewer(nrs.Scene())
    with pytest.raises(nrs.ArgumentError, match=r"^material: "):
        nrs.Viewer(scene_of(mesh), material=nrs.Material())
    for place in ((-1, 0), (0, 150), (200, 0), (np.nan, 0)):
        with pytest.raises(nrs.ArgumentError, match=r"^x, y: "):
            viewer.pick(*place)
    with pytest.raises(nrs.ArgumentError, match=r"^scale: "):
        viewer.frame(scale=1.5)
    with pytest.raises(nrs.ArgumentError, match=r"^canvas: must be one of auto, .*, not 'tk'"):
        nrs.view(mesh, canvas="tk")
    with pytest.raises(nrs.ArgumentError, match=r"^width: assign to the viewer"):
        nrs.view(viewer, canvas="offscreen", width=3)


@pytest.mark.parametrize(
    ("canvas", "package"),
    [("offscreen", "rendercanvas"), ("glfw", "glfw"), ("glfw", "wgpu"), ("jupyter", "ipywidgets")],
)
def test_a_missing_package_is_named_with_the_line_that_installs_it(
    mesh, canvas, package, monkeypatch
) -> None:
    for other in {"rendercanvas", "glfw", "ipywidgets"} - {package}:
        pytest.importorskip(other)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(nrs.DependencyError, match=f"pip install {package}$") as error:
        nrs.view(mesh, canvas=canvas)
    assert error.value.name == package


# ------------------------------------------------------------------------------------- canvas off the screen


@pytest.fixture
def shown(mesh):
    """A viewer on a canvas without a loop: it draws when it is told."""
    pytest.importorskip("rendercanvas")
    made = nrs.view(mesh, canvas="offscreen", **SIZE, backend="cpu", view="clusters")
    made.canvas.draw()
    yield made
    made.close()


def draw(shown: nrs.Viewer) -> np.ndarray:
    """The picture after all events; this canvas has no loop that would process them."""
    shown.canvas._process_events()
    return shown.canvas.draw()


def pointer(shown: nrs.Viewer, kind: str, x: float, y: float, button: int = 1, *modifiers: str) -> None:
    event = {"event_type": f"pointer_{kind}", "x": x, "y": y, "button": button, "modifiers": modifiers}
    shown.canvas.submit_event({**event, "buttons": (button,), "ntouches": 0, "touches": {}})


def drag(shown: nrs.Viewer, button: int, *modifiers: str) -> None:
    pointer(shown, "down", 100, 80, button, *modifiers)
    draw(shown)
    pointer(shown, "move", 130, 70, button, *modifiers)
    draw(shown)
    pointer(shown, "up", 130, 70, button, *modifiers)


def press(shown: nrs.Viewer, key: str) -> np.ndarray:
    shown.canvas.submit_event({"event_type": "key_down", "key": key, "modifiers": ()})
    return draw(shown)


def test_a_canvas_shows_the_picture_below_its_text(shown) -> None:
    drawn = draw(shown)
    assert drawn.shape == (150, 200, 4)
    assert (drawn[..., 3] == 255).all()
    written = (drawn[..., :3] != shown.image()).any(axis=-1)
    assert written[:60].any()
    assert not written[80:].any()  # no room for the help
    shown.canvas.set_logical_size(500, 400)
    with_help = draw(shown)
    lower = np.s_[300:, :, :3]
    assert (with_help[lower] != shown.image()[lower]).any()
    np.testing.assert_array_equal(press(shown, "h")[lower], shown.image()[lower])
    np.testing.assert_array_equal(press(shown, "H")[lower], with_help[lower])


def test_dragging_turns_moves_and_zooms(shown) -> None:
    orbit, first = shown.orbit, draw(shown).copy()
    azimuth, elevation, pivot = orbit.azimuth, orbit.elevation, orbit.pivot.copy()
    drag(shown, 1)
    turned = draw(shown).copy()
    assert orbit.azimuth < azimuth
    assert orbit.elevation < elevation
    np.testing.assert_array_equal(orbit.pivot, pivot)
    assert (turned != first).any()
    for button, modifiers in ((2, ()), (1, ("Shift",))):
        pivot = orbit.pivot.copy()
        angles = orbit.azimuth, orbit.elevation
        drag(shown, button, *modifiers)
        draw(shown)
        # The surface follows the pointer, to the right and upwards.
        local = (orbit.pivot - pivot) @ orbit.axes
        per_pixel = 2 * orbit.distance * np.tan(orbit.yfov / 2) / 150
        np.testing.assert_allclose(local, [-30 * per_pixel, -10 * per_pixel, 0.0], atol=1e-12)
        assert angles == (orbit.azimuth, orbit.elevation)
    distance = orbit.distance
    wheel = {
        "event_type": "wheel",
        "dx": 0.0,
        "dy": -200.0,
        "x": 100,
        "y": 75,
        "buttons": (),
        "modifiers": (),
    }
    shown.canvas.submit_event(wheel)
    draw(shown)
    assert 0.5 * distance < orbit.distance < 0.9 * distance


def test_pictures_have_all_samples_unless_a_button_is_held(shown) -> None:
    shown.view = "shaded"
    draw(shown)
    assert shown.stats.samples == 4
    pointer(shown, "down", 100, 80)
    pointer(shown, "move", 130, 80)
    draw(shown)
    assert shown.stats.samples == 1
    pointer(shown, "up", 130, 80)
    draw(shown)
    assert shown.stats.samples == 4
    wheel = {"event_type": "wheel", "dx": 0.0, "dy": 100.0, "x": 100, "y": 75, "buttons": (), "modifiers": ()}
    shown.canvas.submit_event(wheel)
    draw(shown)
    assert shown.stats.samples == 4


def test_a_click_picks_and_a_double_click_centers(shown) -> None:
    pointer(shown, "down", 90, 80)
    pointer(shown, "move", 91, 80)
    pointer(shown, "up", 91, 80)
    draw(shown)
    assert shown.selected is not None
    selected, shown.selected = shown.selected, None
    assert selected == shown.pick(91, 80)
    press(shown, "Escape")
    assert shown.selected is None
    drag(shown, 1)
    draw(shown)
    assert shown.selected is None
    target = shown.pick(80, 90).position
    double = {"event_type": "double_click", "x": 80, "y": 90, "button": 1, "buttons": (), "modifiers": ()}
    shown.canvas.submit_event({**double, "ntouches": 0, "touches": {}})
    draw(shown)
    np.testing.assert_allclose(shown.orbit.pivot, target)


def test_keys(shown, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    press(shown, "f")
    assert shown.frozen
    press(shown, "f")
    assert not shown.frozen
    for expected in ("groups", "levels"):
        press(shown, "v")
        assert shown.view == expected
    press(shown, "V")
    assert shown.view == "groups"
    press(shown, "]")
    assert shown.pixel_error == pytest.approx(2**0.5)
    press(shown, "[")
    assert shown.pixel_error == 1.0
    press(shown, "0")
    assert shown.pixel_error == 0.0
    azimuth, distance = shown.orbit.azimuth, shown.orbit.distance
    press(shown, "ArrowRight")
    press(shown, "+")
    assert shown.orbit.azimuth > azimuth
    assert shown.orbit.distance < distance
    press(shown, "r")
    assert (shown.orbit.azimuth, shown.orbit.distance) == (azimuth, distance)
    press(shown, "s")
    press(shown, "s")
    assert sorted(path.name for path in Path().iterdir()) == ["nanite_001.png", "nanite_002.png"]


def test_the_slider_sets_the_pixel_error(shown) -> None:
    shown.resize(400, 300)
    shown.canvas.set_logical_size(400, 300)
    draw(shown)
    azimuth = shown.orbit.azimuth
    pointer(shown, "down", 300, 42)
    draw(shown)
    first = shown.pixel_error
    assert first != 1.0
    pointer(shown, "move", 340, 60)
    draw(shown)
    pointer(shown, "up", 340, 60)
    draw(shown)
    assert shown.pixel_error == pytest.approx(first * 2 ** (9 * 40 / 260))
    assert shown.orbit.azimuth == azimuth
    assert shown.selected is None


def test_another_size_of_the_canvas_is_another_size_of_the_picture(shown) -> None:
    shown.canvas.set_logical_size(120, 90)
    assert draw(shown).shape == (90, 120, 4)
    assert shown.size == (120, 90)


def test_pictures_shrink_until_they_are_quick_and_grow_again() -> None:
    budget = Budget(0.04)
    for seconds, scale in (
        (0.03, 1.0),
        (0.16, 0.5),  # a quarter of the pixels
        (0.05, 0.375),
        (0.5, 0.25),
        (0.5, 0.25),
        (0.03, 0.25),  # the next size would take too long
        (0.01, 0.375),
        (0.001, 0.5),
        (0.001, 0.75),
        (0.001, 1.0),
    ):
        budget.took(seconds)
        assert budget.scale == scale


def test_steps_of_the_pixel_error_end_at_0_and_64() -> None:
    values = [64.0]
    while values[-1]:
        values.append(stepped(values[-1], -1))
    assert values[-2:] == [0.125, 0.0]
    assert len(values) == 20
    assert stepped(64.0, 1) == 64.0
    assert stepped(0.0, 1) == 0.125
    assert stepped(1.0, 1) == 2.0**0.5


# ------------------------------------------------------------------------- in Jupyter, without a kernel
# test_browser.py has a notebook in a browser.


@pytest.fixture
def cell(mesh):
    for package in ("rendercanvas", "ipywidgets", "jupyter_rfb"):
        pytest.importorskip(package)
    made = nrs.view(mesh, canvas="jupyter", **SIZE, backend="cpu")
    made.canvas.handle_event({"event_type": "resize", "width": 200, "height": 150, "pixel_ratio": 1.0})
    yield made
    made.close()


def sent(cell: nrs.Viewer) -> np.ndarray:
    """The frame that a browser would get."""
    cell.canvas.get_frame()
    return cell.canvas._last_image[..., :3]


def test_widgets_and_the_viewer_steer_each_other(cell) -> None:
    bar, canvas, status, picked = cell.widget.children
    assert canvas is cell.canvas
    menu, slider, freeze, reset, _ = bar.children
    np.testing.assert_array_equal(sent(cell), cell.image())
    menu.value, slider.value = "levels", 4.0
    assert (cell.view, cell.pixel_error) == ("levels", 4.0)
    np.testing.assert_array_equal(sent(cell), cell.image())
    assert "levels" in status.value
    freeze.value = True
    assert cell.frozen
    sent(cell)
    assert "frozen" in status.value
    cell.view, cell.pixel_error, cell.frozen = "pages", 0.0, False
    assert (menu.value, slider.value, freeze.value) == ("pages", 0.125, False)
    assert cell.pixel_error == 0.0
    cell.orbit.turn(1.0, 0.0)
    azimuth = cell.orbit.azimuth
    reset.click()
    assert cell.orbit.azimuth < azimuth
    cell.pick(100, 75, select=True)
    sent(cell)
    for line in str(cell.selected).splitlines():
        assert line in picked.value


def test_a_notebook_shows_the_widget(cell, mesh) -> None:
    shown = cell._repr_mimebundle_()
    data = shown[0] if isinstance(shown, tuple) else shown
    assert data["application/vnd.jupyter.widget-view+json"]["model_id"] == cell.widget.model_id
    with nrs.Viewer(mesh, **SIZE, backend="cpu") as alone:
        assert alone._repr_mimebundle_()["image/png"].startswith(b"\x89PNG")


def test_events_of_a_browser_do_the_same(cell) -> None:
    sent(cell)
    azimuth = cell.orbit.azimuth
    common = {"buttons": (1,), "modifiers": (), "ntouches": 0, "touches": {}, "button": 1}
    for kind, x in (("down", 100), ("move", 130), ("up", 130)):
        cell.canvas.handle_event({"event_type": f"pointer_{kind}", "x": x, "y": 75, **common})
    first = sent(cell)
    assert cell.orbit.azimuth == pytest.approx(azimuth - 0.3)
    assert first.shape[0] <= 150
    for kind in ("down", "up"):
        cell.canvas.handle_event({"event_type": f"pointer_{kind}", "x": 90, "y": 70, **common})
    sent(cell)
    assert cell.selected == cell.pick(90, 70)


# ------------------------------------------------------------------------------------------------ in a window

SHAPE = "displaced_icosphere"
FACES = 40_000


def test_a_window_shows_what_the_viewer_draws(tmp_path) -> None:
    """`nanite-rs view` in a process of its own, before a display; each picture is that of a viewer here."""
    for package in ("rendercanvas", "glfw", "wgpu", "Xlib"):
        pytest.importorskip(package)
    try:
        nrs.Renderer(8, 8, backend="gpu").close()
    except nrs.BackendError as error:
        pytest.skip(f"windows are drawn by wgpu: {error}")
    with nrs.Renderer(8, 8) as renderer:
        if renderer.backend == "gpu":
            pytest.skip("drivers of real GPUs may not draw into Xvfb's windows")
    width, height = 560, 420
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.SHAPES[SHAPE](faces=FACES, seed=0))
    command = [sys.executable, "-m", "nanite_rs", "view", f"shape:{SHAPE}:{FACES}", "--backend", "cpu"]
    command += ["--size", f"{width}x{height}", "--view", "clusters"]
    middle = np.s_[180 : height - 90]  # between the texts

    with (
        screen(width, height) as display,
        nrs.Viewer(mesh, width=width, height=height, backend="cpu") as here,
    ):
        here.view = "clusters"
        environment = {k: v for k, v in os.environ.items() if k != "WAYLAND_DISPLAY"} | {"DISPLAY": display}
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True)
        try:
            desk = Desk(display)
            window = desk.window()

            def shows_the_same() -> bool:
                assert process.poll() is None, process.stderr.read()
                picture = here.image()[middle].astype(int)
                return bool(np.abs(desk.seen(width, height)[middle] - picture).max() <= 1)

            desk.until(shows_the_same, "the first picture is another")
            # A click.
            desk.move(250, 200)
            desk.button(1, down=True)
            desk.button(1, down=False)
            assert here.pick(250, 200, select=True) is not None
            desk.until(shows_the_same, "what was picked is not tinted")
            # Freezing, and a drag, of which the last picture has full resolution.
            desk.key("f")
            here.freeze()
            desk.move(200, 200)
            desk.button(1, down=True)
            for k in range(1, 9):
                desk.move(200 + 12 * k, 200 + 3 * k)
            desk.button(1, down=False)
            here.orbit.turn(-0.96, 0.24)
            desk.until(shows_the_same, "the frozen cut is not shown from the other place")
            # Keys and the wheel.
            desk.key("v")
            here.view = "groups"
            desk.button(4, down=True)
            desk.button(4, down=False)
            here.orbit.zoom(1.0015**100)
            desk.until(shows_the_same, "the groups are not shown from nearer")
            desk.key("s")
            saved = tmp_path / "nanite_001.png"
            desk.until(saved.exists, "nothing is saved")
            with Image.open(saved) as image:
                np.testing.assert_array_equal(np.asarray(image), here.image())
            desk.close(window)
            assert process.wait(20) == 0, process.stderr.read()
        finally:
            process.kill()
            process.communicate()


def test_without_a_display_the_command_says_so_in_a_line() -> None:
    for package in ("rendercanvas", "glfw", "wgpu"):
        pytest.importorskip(package)
    if sys.platform != "linux":
        pytest.skip("windows need no display here")
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-m", "nanite_rs", "view", f"shape:{SHAPE}:2000"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith("nanite-rs: canvas: glfw cannot open a window here")
    assert "Traceback" not in result.stderr


def test_without_a_device_for_its_window_the_command_says_so_in_a_line() -> None:
    """wgpu would take OpenGL, whose surfaces need not show anything, and end the process."""
    for package in ("rendercanvas", "glfw", "wgpu"):
        pytest.importorskip(package)
    if sys.platform != "linux":
        pytest.skip("elsewhere there is Metal or DX12")
    with screen(200, 150) as display:
        environment = {k: v for k, v in os.environ.items() if k != "WAYLAND_DISPLAY"} | {"DISPLAY": display}
        environment |= dict.fromkeys(("VK_DRIVER_FILES", "VK_ICD_FILENAMES"), os.devnull)
        command = [sys.executable, "-m", "nanite_rs", "view", f"shape:{SHAPE}:2000", "--backend", "cpu"]
        result = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=60, check=False
        )
    assert result.returncode == 1, result.stderr
    last = result.stderr.splitlines()[-1]
    assert last.startswith("nanite-rs: canvas: glfw cannot open a window here")
    assert "Traceback" not in result.stderr
    assert "panicked" not in result.stderr
