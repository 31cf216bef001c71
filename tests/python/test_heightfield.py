"""Terrain: vertical errors at all posts by matplotlib, holes, pieces, and pydelatin beside it."""

import matplotlib.tri
import numpy as np
import pydelatin
import pytest
import trimesh

import nanite_rs as nrs
from nanite_rs.terrain import Ground
from oracles import data


def hills(rows, columns, seed=0):
    """Smooth ground with a ridge and some roughness."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:rows, :columns] / max(rows, columns)
    out = np.zeros((rows, columns))
    for k in range(1, 12):
        a, b, c = rng.normal(size=3)
        out += np.sin(k * (3 * a * x + 3 * b * y) + 6 * c) / k
    return 100 * (out + np.abs(x - y) + 0.01 * rng.random((rows, columns)))


def at_posts(made, shape):
    """Heights of the mesh at all posts, by matplotlib; NaN outside."""
    row, column = made.posts.T
    found = matplotlib.tri.Triangulation(column, row, made.faces)
    values = matplotlib.tri.LinearTriInterpolator(found, made.vertices[:, 2])
    y, x = np.mgrid[: shape[0], : shape[1]]
    return values(x, y).filled(np.nan)


@pytest.mark.parametrize("fit", [True, False])
@pytest.mark.parametrize("tolerance", [20.0, 2.0])
def test_no_post_is_farther_than_the_tolerance(tolerance, fit):
    heights = hills(140, 200)
    made = nrs.heightfield(heights, tolerance=tolerance, fit=fit)
    off = at_posts(made, heights.shape) - heights
    assert np.isfinite(off).all()
    assert np.abs(off).max() <= made.error + 1e-9
    assert made.error <= tolerance
    assert np.isclose(np.abs(off).max(), made.error)
    assert np.isclose(np.sqrt(np.mean(off**2)), made.rms)
    assert made.measured_posts == heights.size
    mesh = trimesh.Trimesh(made.vertices, made.faces, process=False)
    assert (mesh.face_normals[:, 2] > 0).all()
    flat = trimesh.Trimesh(made.vertices * [1, 1, 0], made.faces, process=False)
    assert np.isclose(flat.area, 139 * 199)
    # One border, of posts that go round.
    edges, counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    assert counts.max() == 2
    assert len(trimesh.graph.connected_components(edges[counts == 1])) == 1


def pydelatin_of(heights, tolerance):
    """Its triangles, the largest error and the root mean square, at posts."""
    found = pydelatin.Delatin(
        np.ascontiguousarray(heights, np.float32),
        width=heights.shape[1],
        height=heights.shape[0],
        max_error=tolerance,
    )
    places, faces = np.asarray(found.vertices), np.asarray(found.triangles)
    y, x = np.mgrid[: heights.shape[0], : heights.shape[1]]
    errors = []
    for row in (places[:, 1], heights.shape[0] - 1 - places[:, 1]):
        triangles = matplotlib.tri.Triangulation(places[:, 0], row, faces)
        off = matplotlib.tri.LinearTriInterpolator(triangles, places[:, 2])(x, y).filled(0.0) - heights
        errors.append((np.abs(off).max(), np.sqrt(np.mean(off**2))))
    return len(faces), *min(errors)


@pytest.mark.parametrize("tolerance", [20.0, 5.0])
def test_the_mean_error_is_below_that_of_pydelatin_with_as_many_triangles(tolerance):
    heights = hills(256, 256, seed=1)
    count, largest, rms = pydelatin_of(heights, tolerance)
    assert largest <= tolerance * 1.001
    made = nrs.heightfield(heights, tolerance=tolerance)
    assert made.error <= tolerance
    if len(made) > count:
        with pytest.warns(nrs.UsageWarning):
            made = nrs.heightfield(heights, tolerance=tolerance, max_triangles=count)
    assert len(made) <= 1.01 * count
    assert made.rms < 0.95 * rms


def srtm():
    path = data.require("huge", "srtm_N43E006", "N43E006.hgt")
    return np.memmap(path, ">i2", "r", shape=(1201, 1201))


def test_srtm_is_met_at_all_posts():
    heights = srtm()
    made = nrs.heightfield(heights, spacing=(66.0, 92.0), tolerance=40.0)
    off = at_posts(made, heights.shape) - heights
    assert np.abs(off).max() <= made.error <= 40.0
    count, _, rms = pydelatin_of(np.array(heights, np.float64), 40.0)
    assert len(made) <= 1.01 * count
    assert made.rms < rms
    assert np.isclose(np.ptp(made.vertices[:, 0]), 1200 * 66.0)


def kept_area(there):
    """Area of the cells with four posts, and of halves of those with three."""
    count = there[:-1, :-1].astype(int) + there[1:, :-1] + there[:-1, 1:] + there[1:, 1:]
    return (count == 4).sum() + 0.5 * (count == 3).sum()


@pytest.mark.parametrize("piece", [33, 4096])
def test_outlines_of_holes_are_kept(piece):
    heights = hills(90, 120)
    y, x = np.mgrid[:90, :120]
    rng = np.random.default_rng(3)
    holes = (np.hypot(x - 40, y - 50) < 17) | (x + y < 12) | (rng.random(x.shape) < 0.01) | (x > 116)
    heights[holes] = np.nan
    made = nrs.heightfield(heights, tolerance=3.0, piece=piece)
    flat = trimesh.Trimesh(made.vertices * [1, 1, 0], made.faces, process=False)
    assert np.isclose(flat.area, kept_area(~holes))
    assert not holes[tuple(made.posts.T)].any()
    # At posts on outlines the search may find nothing, by rounding: their vertices are there.
    off = np.abs(at_posts(made, heights.shape) - heights)
    assert np.nanmax(off) <= made.error + 1e-9 <= 3.0 + 1e-9
    _, counts = np.unique(np.sort(flat.edges, axis=1), axis=0, return_counts=True)
    assert counts.max() <= 2
    # Every edge of the border is a side or a diagonal of a cell, or lies along the border of the array.
    edges, counts = np.unique(np.sort(flat.edges, axis=1), axis=0, return_counts=True)
    ends = made.posts[edges[counts == 1]]
    short = np.abs(ends[:, 0] - ends[:, 1]).max(axis=1) == 1
    last = np.array(heights.shape) - 1
    outer = ((ends == 0).all(axis=1) | (ends == last).all(axis=1)).any(axis=1)
    assert (short | outer).all()


def test_pieces_meet(tmp_path):
    heights = hills(150, 170).astype(np.float32)
    heights.tofile(tmp_path / "heights")
    stored = np.memmap(tmp_path / "heights", np.float32, "r", shape=heights.shape)
    made = nrs.heightfield(stored, tolerance=3.0, piece=40)
    off = at_posts(made, heights.shape) - heights
    assert np.abs(off).max() <= made.error <= 3.0
    mesh = trimesh.Trimesh(made.vertices, made.faces, process=False)
    edges, counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    assert counts.max() == 2
    border = made.posts[np.unique(edges[counts == 1])]
    last = np.array(heights.shape) - 1
    assert ((border == 0) | (border == last)).any(axis=1).all()
    whole = nrs.heightfield(heights, tolerance=3.0)
    assert 0.8 * len(whole) < len(made) < 1.5 * len(whole)


def borders(vertices, faces):
    """Edges of one face, as rows of vertices at different positions, which all have their own rows then."""
    places, numbers = np.unique(vertices, axis=0, return_inverse=True)
    edges = np.sort(numbers.reshape(-1)[faces][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 2
    return places, edges[counts == 1]


def test_pieces_have_the_same_vertices_at_their_borders():
    """Bit for bit, as what joins them in files needs it."""
    heights = hills(100, 130)
    ground = Ground(
        heights, spacing=(0.3, 0.7), tolerance=1.0, nodata=None, max_triangles=None, fit=True, piece=34
    )
    parts = [(posts, ground.placed(posts, values)) for posts, values, _ in ground.parts()]
    assert len(parts) == 12
    known, shared = {}, 0
    for posts, (vertices, uvs) in parts:
        for post, vertex, uv in zip(posts.tolist(), vertices, uvs, strict=True):
            rows = vertex.tobytes() + uv.tobytes()
            shared += tuple(post) in known
            assert known.setdefault(tuple(post), rows) == rows
    assert shared > 100
    # On each border they are the same posts, too.
    for line in (33, 66, 99):
        sides = [{tuple(p) for p in posts.tolist() if p[1] == line} for posts, _ in parts]
        each = [side for side in sides if side]
        assert len(each) == 6
        assert all(each[k] == each[k + 1] for k in (0, 2, 4))


def within(how):
    """What a file leaves of the tolerance to the posts: its positions are rounded to a thirty-second of it."""
    return how | {"tolerance": how["tolerance"] * (1.0 - 0.5 * 3.0**0.5 / 32)}


# A third of what building takes in memory, and all of it.
@pytest.mark.parametrize("memory", ["400 kB", "4 GiB"])
def test_files_of_terrain_are_one_surface_within_their_errors(memory, tmp_path):
    heights = hills(260, 230).astype(np.float32)
    heights.tofile(tmp_path / "heights")
    stored = np.memmap(tmp_path / "heights", np.float32, "r", shape=heights.shape)
    how = {"spacing": 10.0, "tolerance": 1.0, "piece": 70}
    mesh = nrs.build_heightfield(stored, tmp_path / "hills.nanite", memory=memory, **how)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["heights", "hills.nanite"]
    mesh.check()
    made = nrs.heightfield(heights, **within(how))
    assert len(mesh) == len(made)
    y, x = np.mgrid[:260, :230]
    points = np.column_stack([10.0 * x.ravel(), 10.0 * (259 - y.ravel()), heights.ravel()])[::31]
    low, high = points.min(axis=0), points.max(axis=0)
    for error in (0.0, 8.0, 30.0):
        cut = mesh.cut(error=error)
        assert cut.error >= made.error
        _, distance, _ = trimesh.proximity.closest_point(cut.to_trimesh(), points)
        assert distance.max() <= cut.error
        # No crack: the border is that of the array.
        places, edges = borders(cut.vertices, cut.faces)
        ends = places[edges][:, :, :2]
        near = np.minimum(np.abs(ends - low[:2]), np.abs(ends - high[:2])) <= cut.error + 10.0
        assert near.any(axis=2).all()
    # What is stated is the rounding of files and the largest distance of a post.
    assert made.error <= mesh.cut(error=0.0).error == mesh.info["rounding"] <= how["tolerance"]


def test_files_of_terrain_keep_holes_materials_and_texture_coordinates(tmp_path):
    heights = hills(120, 150)
    y, x = np.mgrid[:120, :150]
    heights[np.hypot(x - 71, y - 60) < 20] = -1.0e4
    look = nrs.Material(base_color=(0.3, 0.5, 0.2), roughness=0.7)
    how = {"tolerance": 1.0, "piece": 50, "nodata": -1.0e4}
    mesh = nrs.build_heightfield(heights, tmp_path / "a.nanite", materials=look, **how)
    made = nrs.heightfield(heights, **within(how))
    assert mesh.materials == (look,)
    cut = mesh.cut(error=0.0)
    assert len(borders(cut.vertices, cut.faces)[1]) == len(borders(made.vertices, made.faces)[1])
    expected = np.column_stack([(cut.vertices[:, 0] + 0.5) / 150, (cut.vertices[:, 1] + 0.5) / 120])
    assert np.abs(cut.uvs[0] - expected).max() <= 2 * mesh.info["precision"] / 120


@pytest.mark.parametrize("memory", ["300 kB", "4 GiB"])
def test_files_of_terrain_are_as_fine_as_asked(memory, tmp_path):
    """A grid that single precision is as coarse as is left out, and nothing is rounded to another one."""
    heights = np.random.default_rng(0).normal(size=(100, 120))
    for tolerance in (1e-3, 2e-4, 1e-4, 2e-5):
        mesh = nrs.build_heightfield(heights, tmp_path / "a.nanite", tolerance=tolerance, memory=memory)
        assert 0.0 < mesh.cut(error=0.0).error <= tolerance


def test_files_of_terrain_are_made_whole_or_not_at_all(tmp_path):
    file = tmp_path / "a.nanite"
    with pytest.raises(nrs.MissingFileError, match="nowhere"):
        nrs.build_heightfield(hills(9, 9), tmp_path / "nowhere" / "a.nanite", tolerance=1.0)
    with pytest.raises(nrs.FormatError, match=r"must end in \.nanite"):
        nrs.build_heightfield(hills(9, 9), tmp_path / "a.ply", tolerance=1.0)
    with pytest.raises(nrs.ArgumentError, match="tolerance: must be above 0"):
        nrs.build_heightfield(hills(9, 9), file, tolerance=0.0)
    with pytest.raises(nrs.MeshError, match="no three posts"):
        nrs.build_heightfield(np.full((9, 9), np.nan), file, tolerance=1.0)
    holed = hills(90, 90)
    holed[70, 70] = np.inf
    with pytest.raises(nrs.ArgumentError, match="inf at row 70, column 70"):
        nrs.build_heightfield(holed, file, tolerance=1.0, piece=40)
    assert not list(tmp_path.iterdir())


def test_no_data_may_be_a_value_or_masked():
    heights = hills(50, 60)
    holes = np.zeros(heights.shape, bool)
    holes[20:30, 15:40] = True
    expected = nrs.heightfield(np.where(holes, np.nan, heights), tolerance=5.0)
    by_value = nrs.heightfield(np.where(holes, -32768.0, heights), tolerance=5.0, nodata=-32768)
    masked = nrs.heightfield(np.ma.masked_array(heights, holes), tolerance=5.0)
    for other in (by_value, masked):
        assert np.array_equal(expected.faces, other.faces)
        assert np.array_equal(expected.vertices, other.vertices)


def test_posts_without_a_cell_are_counted():
    heights = np.full((6, 7), np.nan)
    heights[:3, :3] = 1.0
    heights[5, 5] = heights[5, 6] = 2.0
    made = nrs.heightfield(heights, tolerance=0.1)
    assert made.lost_posts == 2
    assert made.measured_posts == 9
    assert np.allclose(made.vertices[:, 2], 1.0)


def test_planes_are_two_triangles():
    y, x = np.mgrid[:300, :400]
    made = nrs.heightfield(3 * x - y, spacing=(2.0, 0.5), tolerance=1e-6)
    assert len(made) == 2
    assert made.vertices[made.posts.sum(axis=1) == 0].tolist() == [[0.0, 149.5, 0.0]]
    assert nrs.heightfield([[0.0, 1.0], [2.0, 5.0]], tolerance=0.1).measured_posts == 4


def test_cuts_of_terrain_are_within_their_errors(tmp_path):
    heights = hills(200, 200)
    mesh = nrs.NaniteMesh.from_heightfield(heights, spacing=10.0, tolerance=1.0)
    mesh.check()
    mesh.save(tmp_path / "hills.nanite", precision="exact")
    y, x = np.mgrid[:200, :200]
    points = np.column_stack([10.0 * x.ravel(), 10.0 * (199 - y.ravel()), heights.ravel()])
    for one in (mesh, nrs.NaniteMesh.open(tmp_path / "hills.nanite")):
        for error in (0.0, 5.0):
            cut = one.cut(error=error)
            _, distance, _ = trimesh.proximity.closest_point(cut.to_trimesh(), points[::37])
            assert distance.max() <= cut.error
            assert cut.error <= max(error, 1.5)


def test_threads_do_not_matter():
    heights = hills(100, 100)
    threads = nrs.get_num_threads()
    try:
        nrs.set_num_threads(1)
        one = nrs.heightfield(heights, tolerance=1.0, piece=50)
        nrs.set_num_threads(3)
        three = nrs.heightfield(heights, tolerance=1.0, piece=50)
    finally:
        nrs.set_num_threads(threads)
    assert np.array_equal(one.vertices, three.vertices)
    assert np.array_equal(one.faces, three.faces)


def test_so_many_triangles_and_no_more():
    with pytest.warns(nrs.UsageWarning, match="above the tolerance"):
        made = nrs.heightfield(hills(100, 100), tolerance=30.0 * 1e-2, max_triangles=3000)
    assert len(made) <= 3002


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"heights": np.zeros((0, 3))}, nrs.ArgumentError, "heights: expected"),
        ({"heights": np.zeros((1, 9))}, nrs.ArgumentError, "heights: expected"),
        ({"heights": np.zeros((3, 3, 1))}, nrs.ArgumentError, "heights: expected"),
        ({"heights": np.array([["a", "b"], ["c", "d"]])}, nrs.DtypeError, "heights: expected"),
        ({"heights": np.zeros((3, 3), complex)}, nrs.DtypeError, "heights: expected"),
        ({"heights": [[0.0, 1.0], [np.inf, 2.0]]}, nrs.ArgumentError, "heights: inf at row 1, column 0"),
        ({"heights": np.full((4, 4), np.nan)}, nrs.MeshError, "heights: no three posts"),
        ({"spacing": 0.0}, nrs.ArgumentError, "spacing: expected"),
        ({"spacing": (1.0, np.nan)}, nrs.ArgumentError, "spacing: expected"),
        ({"spacing": (1.0, 2.0, 3.0)}, nrs.ArgumentError, "spacing: expected"),
        ({"tolerance": 0.0}, nrs.ArgumentError, "tolerance: must be above 0"),
        ({"tolerance": "much"}, nrs.DtypeError, "tolerance: expected a number"),
        ({"nodata": "none"}, nrs.DtypeError, "nodata: expected a number"),
        ({"piece": 1}, nrs.ArgumentError, "piece: must be between"),
        ({"max_triangles": 1}, nrs.ArgumentError, "max_triangles: must be 2 or more"),
        ({"fit": 1}, nrs.DtypeError, "fit: expected True or False"),
    ],
)
def test_what_is_wrong_is_named(change, error, message):
    given = {"heights": hills(5, 5), "tolerance": 1.0} | change
    with pytest.raises(error, match=message):
        nrs.heightfield(given.pop("heights"), **given)
