"""Vertex colours of every dtype: kept in builds, cuts, files and pictures as precise as they were given."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal

import nanite_rs as nrs
from nanite_rs import _colors

DTYPES = [np.uint8, np.uint16, np.float32]
VERTICES, FACES = nrs.shapes.torus_knot(faces=3_000)
SIZE = np.abs(VERTICES).max()


def painted(dtype, vertices=VERTICES):
    """Smooth colours, dark enough that 8 bits are too few."""
    rgb = 0.02 * (1 + np.sin(3 * vertices / SIZE))
    rgba = np.column_stack([rgb, np.full(len(rgb), 0.75)])
    white = _colors.white(dtype)
    return rgba.astype(np.float32) if white == 1 else np.rint(rgba * white).astype(dtype)


def by_place(cut) -> dict[bytes, bytes]:
    return {
        p.tobytes(): c.tobytes()
        for p, c in zip(cut.vertices.astype(np.float32), cut.fine_colors, strict=True)
    }


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("quality", ["fast", "best"])
def test_full_detail_has_the_bits_that_were_given(dtype, quality, tmp_path) -> None:
    colors = painted(dtype)
    mesh = nrs.NaniteMesh.from_arrays(
        VERTICES, FACES, colors=colors, options=nrs.BuildOptions(quality=quality)
    )
    assert mesh.info["colors"] == np.dtype(dtype).name
    mesh.save(tmp_path / "a.nanite", precision="exact")
    stored = nrs.NaniteMesh.open(tmp_path / "a.nanite")
    assert stored.info["colors"] == mesh.info["colors"]
    assert stored == mesh
    given = {p.tobytes(): c.tobytes() for p, c in zip(VERTICES, colors, strict=True)}
    for one in (mesh, stored, pickle.loads(pickle.dumps(mesh))):
        cut = one.cut(error=0)
        assert cut.fine_colors.dtype == dtype
        assert cut.fine_colors.flags.c_contiguous
        assert cut.colors.dtype == np.uint8
        assert_array_equal(cut.colors, np.rint(255 * _colors.unit(cut.fine_colors)))
        assert by_place(cut) == given


@pytest.mark.parametrize("dtype", DTYPES)
def test_coarse_cuts_and_decimation_blend_what_is_fine(dtype) -> None:
    """What simplification makes of colours does not depend on their dtype, but for its steps."""
    step = 1 / _colors.white(dtype) if dtype != np.float32 else 1e-6
    mesh = nrs.NaniteMesh.from_arrays(VERTICES, FACES, colors=painted(dtype))
    for cut in (
        mesh.cut(target_faces=700),
        mesh.cut(target_faces=701),
        nrs.decimate((VERTICES, FACES), target_faces=700, colors=painted(dtype)),
    ):
        assert cut.fine_colors.dtype == dtype
        near = trimesh.proximity.closest_point(trimesh.Trimesh(VERTICES, FACES), cut.vertices)[0]
        wanted = _colors.unit(painted(np.float32, near))
        # Colours are smooth: a vertex has about those of where it lies.
        assert np.abs(_colors.unit(cut.fine_colors) - wanted).max() < 0.004 + step
    steps = np.unique(mesh.cut(target_faces=700).fine_colors[:, 0])
    assert (len(steps) < 15) == (dtype == np.uint8)


def test_pictures_have_no_steps_in_the_dark() -> None:
    """A ramp from black to 1/500: 8 bits are one step, 16 bits 131, floats as many as there are pixels."""
    vertices = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = [[0, 1, 2], [0, 2, 3]]
    ramp = np.array([0, 0.002, 0.002, 0])[:, None] * np.ones(3)
    camera, pose = nrs.OrthographicCamera(1, 1), nrs.look_at((0, 0, 3), (0, 0, 0))
    x = (np.arange(256) + 0.5) / 256
    for dtype, most in [(np.uint8, 1 / 255), (np.uint16, 0.5 / 65535), (np.float32, 1e-9)]:
        white = _colors.white(dtype)
        colors = ramp.astype(dtype) if white == 1 else np.rint(ramp * white + 1e-9).astype(dtype)
        scene = nrs.Scene()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", nrs.UsageWarning)  # it is that dark
            mesh = nrs.NaniteMesh.from_arrays(vertices, faces, colors=colors)
        scene.add(mesh, material=nrs.Material(base_color=(1, 1, 1)))
        frame = nrs.Renderer(256, 8).render(scene, camera, pose, outputs=["base_color"], shading="gltf")
        assert np.abs(frame.base_color - (0.002 * x)[None, :, None]).max() <= most, dtype
        exact = np.interp(x, [0, 1], [0, _colors.unit(colors)[1, 0]])
        assert np.abs(frame.base_color - exact[None, :, None]).max() < 1e-9, dtype


@pytest.mark.parametrize("dtype", DTYPES)
def test_files_keep_them(dtype, tmp_path) -> None:
    cut = nrs.NaniteMesh.from_arrays(VERTICES, FACES, colors=painted(dtype)).cut(error=0)
    for ending in ("glb", "gltf", "ply"):
        cut.export(tmp_path / f"a.{ending}")
        back = nrs.NaniteMesh.from_file(tmp_path / f"a.{ending}").cut(error=0)
        assert back.fine_colors.dtype == dtype, ending
        assert by_place(back) == by_place(cut), ending
    with pytest.warns(UserWarning, match="alpha of vertex colours"):
        cut.export(tmp_path / "a.obj")
    back = nrs.NaniteMesh.from_file(tmp_path / "a.obj").cut(error=0)
    assert back.fine_colors.dtype == dtype
    # Nine digits are read as float64, which is kept about an origin of float64.
    order = [np.lexsort(np.round(one.vertices, 4).T) for one in (back, cut)]
    assert_array_equal(back.fine_colors[order[0], :3], cut.fine_colors[order[1], :3])


def test_parts_of_a_file_meet_in_what_holds_all_of_them() -> None:
    kinds = [np.uint8([[51, 0, 255, 255]]), np.uint16([[1, 2, 3, 65535]]), np.float32([[1e-5, 0, 1, 1]])]
    bytes_, shorts, _ = kinds
    assert [part.dtype for part in _colors.alike([bytes_, bytes_])] == [np.uint8] * 2
    both = _colors.alike([bytes_, None, shorts])
    assert both[1] is None
    assert both[2] is shorts
    assert both[0].dtype == np.uint16
    assert_array_equal(_colors.unit(both[0]), _colors.unit(bytes_))
    assert all(part.dtype == np.float32 for part in _colors.alike(kinds))


def test_the_narrowest_dtype_loses_nothing() -> None:
    for dtype in (np.uint8, np.uint16):
        levels = np.arange(np.iinfo(dtype).max + 1, dtype=dtype)
        rows = np.stack([levels, levels[::-1], levels, levels], axis=1)
        for kind in (np.float32, np.float64):
            found = _colors.rgba(_colors.unit(rows).astype(kind))
            assert found.dtype == dtype
            assert_array_equal(found, rows)
    dark = np.float32([[1e-6, 0, 1, 1]])
    for digits in ({}, {"digits": _colors.ANY_DIGITS}):
        assert _colors.narrowed(dark, **digits).dtype == np.float32
    assert_array_equal(_colors.rgba(np.int64([[300, -1, 7]])), np.uint8([[255, 0, 7, 255]]))
    assert_array_equal(_colors.rgba(np.float64([[np.nan, 2, -1]])), np.uint8([[255, 255, 0, 255]]))


@pytest.mark.parametrize(
    ("colors", "error", "message"),
    [
        (np.full((len(VERTICES), 3), 1.5), nrs.ArgumentError, "between 0 and 1"),
        (np.full((len(VERTICES), 3), np.nan), nrs.ArgumentError, "between 0 and 1"),
        (np.zeros((len(VERTICES), 3), np.int64), nrs.DtypeError, "uint8, uint16 or a floating-point"),
        (np.zeros((len(VERTICES), 2), np.uint16), nrs.ArgumentError, r"\(N, 3\) or \(N, 4\)"),
        (np.zeros((7, 3), np.uint16), nrs.ArgumentError, "colors: expected one row for each"),
    ],
)
def test_what_is_no_colour_is_refused(colors, error, message) -> None:
    with pytest.raises(error, match=message):
        nrs.NaniteMesh.from_arrays(VERTICES, FACES, colors=colors)


def test_bytes_as_shorts_are_warned_of() -> None:
    with pytest.warns(nrs.UsageWarning, match="uint16 of 0 to 255"):
        nrs.NaniteMesh.from_arrays(VERTICES, FACES, colors=np.full((len(VERTICES), 3), 200, np.uint16))
