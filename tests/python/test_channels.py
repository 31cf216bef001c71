"""Named channels: exact where the source is drawn, steering and never blended wrongly where it is simplified."""

import copy
import os
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import subjects

QUALITIES = ["fast", "best"]


def build(v, f, quality="fast", **content):
    mesh = nrs.NaniteMesh.from_arrays(
        v, f, **content, options=nrs.BuildOptions(quality=quality), progress=False
    )
    mesh.check()
    return mesh


def rows(vertices, values):
    """Rows of positions and values as a set, to compare meshes whose vertices come in another order."""
    joined = np.column_stack(
        [(vertices + 0.0).view(np.uint32), np.asarray(values).reshape(len(vertices), -1)]
    )
    return {tuple(row) for row in joined.tolist()}


@pytest.mark.parametrize(
    "dtype",
    ["bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", ">i4"],
)
@pytest.mark.parametrize("quality", QUALITIES)
def test_labels_are_exact_and_never_blended(dtype, quality) -> None:
    v, f = nrs.shapes.icosphere(faces=5_000)
    v = v.astype(np.float32)
    if dtype == "bool":
        values = np.array([False, True])
    else:
        info = np.iinfo(np.int32 if np.dtype(dtype).itemsize == 8 and "i" in dtype[:1] else dtype)
        low, high = max(info.min, -(2**31)), min(info.max, 2**32 - 1)
        values = np.array([low, high, 1, (low + high) // 2 + 1], dtype=dtype)
    labels = values[(v[:, 0] > 0.1).astype(int) + len(values) // 2 * (v[:, 1] > 0.0) * (len(values) > 2)]
    mesh = build(v, f, quality, channels={"label": labels})
    assert mesh.channels["label"] == (np.dtype(dtype).newbyteorder("="), 1)
    full = mesh.cut(error=0.0)
    assert full.channels["label"].dtype == np.dtype(dtype).newbyteorder("=")
    assert full.channels["label"].shape == (len(full.vertices),)
    assert rows(full.vertices, full.channels["label"]) == rows(v, labels)
    for reduction in (0.5, 0.9, 1.0):
        cut = mesh.cut(target_reduction=reduction)
        assert set(cut.channels["label"].tolist()) <= set(labels.tolist())


def test_labels_of_several_channels_stay_together() -> None:
    """A vertex has the labels of one source vertex: no pair that the source has not."""
    v, f = nrs.shapes.icosphere(faces=20_000)
    rng = np.random.default_rng(1)
    pair = rng.integers(0, 2**32, (12, 2), np.uint32)[np.argmax(v @ rng.normal(size=(3, 12)), axis=1)]
    wide = np.repeat(pair, 20, axis=1)
    mesh = build(v, f, channels={"a": pair[:, 0], "b": pair, "wide": wide})
    known = {tuple(row) for row in wide.tolist()}
    for reduction in (0.0, 0.5, 0.9, 0.99):
        cut = mesh.cut(target_reduction=reduction)
        assert {tuple(row) for row in cut.channels["wide"].tolist()} <= known
        assert (cut.channels["wide"][:, [0, 20]] == cut.channels["b"]).all()
        assert (cut.channels["a"] == cut.channels["b"][:, 0]).all()


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("width", [None, 3, 40])
def test_floats_are_exact_at_full_detail_and_follow_the_surface(quality, scale, width) -> None:
    v, f = nrs.shapes.icosphere(faces=20_000)
    v = v.astype(np.float32)
    linear = np.random.default_rng(0).normal(size=(3, width or 1)).astype(np.float32)
    values = (scale * (v @ linear + 100.0)).astype(np.float32)
    if width is None:
        values = values[:, 0]
    mesh = build(v, f, quality, channels={"heat": values})
    full = mesh.cut(error=0.0)
    assert full.channels["heat"].dtype == np.float32
    assert full.channels["heat"].shape[1:] == values.shape[1:]
    assert rows(full.vertices, full.channels["heat"]) == rows(v, values)
    cut = mesh.cut(target_reduction=0.9)
    expected = scale * (cut.vertices.astype(np.float64) @ linear + 100.0)
    spread = np.ptp(values, axis=0).max()
    deviation = np.abs(cut.channels["heat"].reshape(len(cut.vertices), -1) - expected) / spread
    assert deviation.max() < 0.02
    for k in range(width or 1):
        column, source = cut.channels["heat"].reshape(len(cut.vertices), -1)[:, k], values.reshape(len(v), -1)
        assert source[:, k].min() <= column.min() <= column.max() <= source[:, k].max()


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_huge_range_does_not_drown_the_shape(quality) -> None:
    """Noise of any range steers, and costs a bounded part of the geometry."""
    v, f = nrs.shapes.displaced_icosphere(faces=40_000)
    plain = build(v, f, quality)
    rng = np.random.default_rng(3)
    for noise in (rng.normal(size=(len(v), 3)) * 1e30, rng.integers(0, 5, len(v))):
        noisy = build(v, f, quality, channels={"noise": noise})
        for reduction in (0.5, 0.9):
            a, b = plain.cut(target_reduction=reduction), noisy.cut(target_reduction=reduction)
            rms = [
                nrs.measure.surface_distance((cut.vertices, cut.faces), (v, f), samples=20_000).rms
                for cut in (a, b)
            ]
            assert rms[1] < 6.0 * rms[0], rms


def test_channels_survive_files_and_trimesh(tmp_path) -> None:
    v, f = subjects.cube(8)
    rng = np.random.default_rng(0)
    channels = {"label": rng.integers(-5, 5, len(v), np.int16), "heat": rng.random((len(v), 2))}
    mesh = build(v, f, channels=channels)
    mesh.save(tmp_path / "mesh.nanite")
    rounded = nrs.NaniteMesh.open(tmp_path / "mesh.nanite")
    for name in channels:
        a, b = mesh.cut(error=0.0), rounded.cut(error=0.0)
        np.testing.assert_array_equal(a.channels[name], b.channels[name])
    mesh.save(tmp_path / "mesh.nanite", precision="exact")
    again = nrs.NaniteMesh.open(tmp_path / "mesh.nanite")
    assert again == mesh
    assert again.channels == mesh.channels == {"label": (np.dtype("int16"), 1), "heat": (np.dtype("f4"), 2)}
    assert mesh != build(v, f, channels=channels | {"label": channels["label"] + 1})
    for error in (0.0, 0.1):
        a, b = mesh.cut(error=error), again.cut(error=error)
        for name in channels:
            np.testing.assert_array_equal(a.channels[name], b.channels[name])
    exported = mesh.cut(error=0.0).to_trimesh()
    assert set(exported.vertex_attributes) == set(channels)
    back = nrs.NaniteMesh.from_trimesh(exported)
    assert back.channels == mesh.channels
    cut = back.cut(error=0.0)
    assert rows(cut.vertices, cut.channels["heat"]) == rows(
        np.asarray(v, np.float32), channels["heat"].astype(np.float32)
    )


def test_scenes_join_channels_by_name() -> None:
    parts = [trimesh.creation.icosphere(2), trimesh.creation.box()]
    parts[0].vertex_attributes["label"] = np.full(len(parts[0].vertices), 300, np.int32)
    parts[1].vertex_attributes["label"] = np.full(len(parts[1].vertices), 3, np.uint8)
    parts[1].vertex_attributes["heat"] = np.ones((len(parts[1].vertices), 2))
    parts[1].vertex_attributes["tensor"] = np.ones((len(parts[1].vertices), 2, 2))
    mesh = nrs.NaniteMesh.from_trimesh(trimesh.Scene(parts))
    assert mesh.channels == {"label": (np.dtype("int32"), 1), "heat": (np.dtype("f4"), 2)}
    cut = mesh.cut(error=0.0)
    assert set(cut.channels["label"].tolist()) == {3, 300}
    assert (cut.channels["heat"] == (cut.channels["label"] == 3)[:, None]).all()
    parts[0].vertex_attributes["heat"] = np.ones(len(parts[0].vertices))
    with pytest.warns(UserWarning, match=r"another width than elsewhere \(heat\)"):
        nrs.NaniteMesh.from_trimesh(trimesh.Scene(parts))


def test_a_bad_channel_is_named() -> None:
    v, f = nrs.shapes.icosphere(faces=80)
    n = len(v)
    heat = np.ones((n, 2))
    heat[7, 1] = np.nan
    wide = np.zeros(n, np.int64)
    wide[5] = 2**31
    unsigned = np.zeros((n, 2), np.uint64)
    unsigned[4, 1] = 2**32
    for channels, error, message in [
        ({"x": np.zeros(n - 1)}, nrs.ArgumentError, rf"channels\['x'\]: expected shape \({n},\)"),
        ({"x": np.zeros((n, 1, 1))}, nrs.ArgumentError, r"channels\['x'\]: expected shape"),
        ({"x": np.zeros((n, 0))}, nrs.ArgumentError, 'channels: "x" has 0 values'),
        ({"x": heat}, nrs.MeshError, r'channels\["x"\]\[7\] is not finite: \[1.0, NaN\]'),
        ({"x": wide}, nrs.ArgumentError, r"channels\['x'\].*row 5 holds 2147483648"),
        ({"x": unsigned}, nrs.ArgumentError, r"channels\['x'\].*row 4 holds 4294967296"),
        ({"x": np.array(["a"] * n)}, nrs.DtypeError, r"channels\['x'\]: expected a floating-point"),
        ({"": np.zeros(n)}, nrs.ArgumentError, "names no channel"),
        ({3: np.zeros(n)}, nrs.DtypeError, "names are strings"),
        ([np.zeros(n)], nrs.DtypeError, "expected a mapping"),
    ]:
        with pytest.raises(error, match=message):
            nrs.NaniteMesh.from_arrays(v, f, channels=channels)
    with pytest.raises(nrs.ArgumentError, match="channel_weight"):
        nrs.NaniteMesh.from_arrays(v, f, options=nrs.BuildOptions(channel_weight=-1.0))


def test_threads_do_not_change_channels() -> None:
    v, f = nrs.shapes.displaced_icosphere(faces=30_000)
    channels = {"label": (v[:, 0] > 0).astype(np.uint8), "heat": v @ np.ones((3, 35))}
    meshes = [
        nrs.NaniteMesh.from_arrays(v, f, channels=channels, options=nrs.BuildOptions(threads=threads))
        for threads in (1, 2)
    ]
    assert meshes[0] == meshes[1]


@pytest.fixture
def stored(tmp_path):
    """A mesh with two channels and face ids, and its file."""
    v, f = nrs.shapes.displaced_icosphere(faces=20_000)
    channels = {"label": np.arange(len(v), dtype=np.uint32) % 7, "wide": v @ np.ones((3, 40), np.float32)}
    options = nrs.BuildOptions(face_ids=True)
    mesh = nrs.NaniteMesh.from_arrays(v, f, channels=channels, options=options, progress=False)
    mesh.save(tmp_path / "mesh.nanite", precision="exact")
    return mesh, tmp_path / "mesh.nanite"


def test_channels_of_files_are_read_when_they_are_looked_up(stored) -> None:
    mesh, path = stored
    opened = nrs.NaniteMesh.open(path)
    assert opened.channels == mesh.channels
    parts = nrs.NaniteMesh.file_info(path)["parts"]
    assert opened.nbytes < parts["channels"]
    cut, expected = opened.cut(error=0.0), mesh.cut(error=0.0)
    before = opened.nbytes
    # Pages of coarser levels are not read: with levels of seven tenths some two thirds of all.
    coarse = mesh.nbytes - (before + parts["channels"] + parts["face_ids"])
    assert 1.5 < coarse / before < 3.0
    assert list(cut.channels) == ["label", "wide"]
    assert "wide" in cut.channels
    assert "none" not in cut.channels
    assert repr(cut.channels) == "CutChannels(['label', 'wide'])"
    with pytest.raises(KeyError):
        cut.channels["none"]
    assert opened.nbytes == before
    np.testing.assert_array_equal(cut.channels["label"], expected.channels["label"])
    part = opened.nbytes
    assert before < part < before + parts["channels"] / 20
    np.testing.assert_array_equal(cut.channels["wide"], expected.channels["wide"])
    assert opened.nbytes == before + parts["channels"]
    np.testing.assert_array_equal(opened.source_face_ids, mesh.source_face_ids)
    assert opened.nbytes + coarse == mesh.nbytes
    assert opened == mesh
    assert opened.nbytes == mesh.nbytes
    for use in (pickle.dumps, mesh.__eq__):
        opened = nrs.NaniteMesh.open(path)
        use(opened)
        assert opened.nbytes == mesh.nbytes
    for use in (nrs.NaniteMesh.check, lambda opened: opened.save(path, precision="exact")):
        opened = nrs.NaniteMesh.open(path)
        held = opened.nbytes
        use(opened)
        # Pages do not stay.
        assert opened.nbytes == held + parts["channels"] + parts["face_ids"]
    assert nrs.NaniteMesh.open(path) == pickle.loads(pickle.dumps(nrs.NaniteMesh.open(path))) == mesh


def test_looked_up_channels_are_the_callers_own(stored) -> None:
    mesh, path = stored
    opened = nrs.NaniteMesh.open(path)
    cut = opened.cut(target_reduction=0.5)
    expected = {name: values.copy() for name, values in mesh.cut(target_reduction=0.5).channels.items()}
    # Whatever becomes of the other arrays, of the mesh and of the file.
    cut.vertex_ids[:] = 2**32 - 1
    del opened
    path.unlink()
    label = cut.channels["label"]
    assert label is cut.channels["label"]
    np.testing.assert_array_equal(label, expected["label"])
    label[:] = 9
    assert (cut.channels["label"] == 9).all()
    expected["label"][:] = 9
    copied, deep, pickled = copy.copy(cut), copy.deepcopy(cut), pickle.loads(pickle.dumps(cut))
    assert copied.channels is cut.channels
    for other in (deep, pickled):
        assert list(other.channels) == ["label", "wide"]
        for name, values in other.channels.items():
            np.testing.assert_array_equal(values, expected[name])
            assert values.flags.writeable
            assert values is not cut.channels[name]
    assert set(cut.to_trimesh().vertex_attributes) == {"label", "wide"}


def test_threads_look_up_the_same_arrays(stored) -> None:
    mesh, path = stored
    for _ in range(10):
        opened = nrs.NaniteMesh.open(path)
        cuts = [opened.cut(error=0.0), opened.cut(target_reduction=0.5)]
        with ThreadPoolExecutor(8) as pool:
            tasks = [
                pool.submit(cut.channels.__getitem__, name) for name in ["wide", "label"] * 4 for cut in cuts
            ]
            faces = [pool.submit(lambda mesh: mesh.source_face_ids, opened) for _ in range(4)]
            found = {id(task.result()) for task in tasks}
        assert len(found) == 4
        assert all((task.result() == mesh.source_face_ids).all() for task in faces)
        assert opened == mesh


def test_damaged_channels_are_refused_when_they_are_looked_up(stored) -> None:
    mesh, path = stored
    data = path.read_bytes()
    values = mesh.cut(error=0.0).channels["wide"]
    # The last channel lies before the pages.
    at = data.rindex(values[-1].tobytes())
    path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    damaged = nrs.NaniteMesh.open(path)
    cut = damaged.cut(error=0.0)
    np.testing.assert_array_equal(cut.channels["label"], mesh.cut(error=0.0).channels["label"])
    for use in (
        lambda: cut.channels["wide"],
        lambda: dict(cut.channels),
        lambda: pickle.dumps(cut),
        cut.to_trimesh,
        damaged.check,
        lambda: damaged == mesh,
        lambda: pickle.dumps(damaged),
        lambda: damaged.save(path),
    ):
        with pytest.raises(nrs.FormatError, match=r'at byte \d+: section Channels, "wide": the checksum'):
            use()
    assert len(damaged.source_face_ids) == len(mesh)


def test_files_cut_short_after_opening(stored) -> None:
    mesh, path = stored
    data = path.read_bytes()
    opened = nrs.NaniteMesh.open(path)
    cut = opened.cut(error=0.0)
    os.truncate(path, 4096)
    for use in (lambda: cut.channels["wide"], lambda: opened.source_face_ids, lambda: opened == mesh):
        with pytest.raises(nrs.FileError, match=r"mesh\.nanite"):
            use()
    assert "wide" in cut.channels
    path.write_bytes(data)
    np.testing.assert_array_equal(cut.channels["wide"], mesh.cut(error=0.0).channels["wide"])
    assert opened == mesh
