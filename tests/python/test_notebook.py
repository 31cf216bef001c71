"""What notebooks show of meshes, cuts, frames, reports and stats."""

from __future__ import annotations

import warnings
from dataclasses import replace
from io import BytesIO
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

import nanite_rs as nrs
from nanite_rs import _preview
from oracles import subjects
from oracles.camera import View, at, pixel_centers
from oracles.rays import Rays

BACKGROUND = 12
"""Of 255, less than what any shaded surface here differs from the background."""


def decoded(png: bytes | None) -> np.ndarray:
    assert png is not None
    with Image.open(BytesIO(png)) as image:
        assert (image.format, image.mode) == ("PNG", "RGB")
        return np.asarray(image)


def covered(picture: np.ndarray) -> np.ndarray:
    """Pixels that are not background, which all corners show."""
    difference = np.abs(picture.astype(int) - picture[0, 0]).max(axis=-1)
    assert not difference[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    return difference > BACKGROUND


@pytest.fixture(scope="module")
def frame(backend) -> nrs.Frame:
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    scene.add(subjects.built("sphere"))
    scene.add(nrs.DirectionalLight(intensity=3.0))
    with nrs.Renderer(160, 90, backend=backend) as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), at(0, 0, 4))


# ------------------------------------------------------------------------------------------------- pictures


def test_a_frame_is_its_colours(frame) -> None:
    assert len(np.unique(frame.color.reshape(-1, 3), axis=0)) > 50
    np.testing.assert_array_equal(decoded(frame._repr_png_()), frame.color)


def test_a_frame_without_colours_says_what_it_has() -> None:
    with nrs.Renderer(16, 9, backend="cpu") as renderer:
        scene, lens = nrs.Scene(), nrs.PerspectiveCamera(yfov=0.8)
        with pytest.warns(nrs.UsageWarning, match="no mesh"):
            frame = renderer.render(scene, lens, np.eye(4), depth_only=True)
    assert frame._repr_png_() is None
    assert repr(frame).startswith("<Frame 16×9 of depth alone: ")


def test_a_frame_whose_device_was_lost_shows_its_text() -> None:
    class Lost:
        def color(self):
            raise nrs.BackendError("the device was lost")

    assert nrs.Frame(Lost(), {"depth_only": False})._repr_png_() is None


@pytest.mark.parametrize("name", subjects.GENERATED)
def test_all_of_a_mesh_is_shown_and_fills_the_picture(name) -> None:
    picture = decoded(subjects.built(name)._repr_png_())
    assert picture.shape == (360, 480, 3)
    rows, columns = np.nonzero(covered(picture))
    assert 0 < rows.min() <= rows.max() < 359
    assert 0 < columns.min() <= columns.max() < 479
    # One side of the four is nearly reached.
    least = min(rows.min(), columns.min(), 359 - rows.max(), 479 - columns.max())
    assert least < 40


def test_backs_of_open_surfaces_are_shown() -> None:
    vertices, faces = subjects.grid(8, 8)
    pictures = [
        decoded(nrs.NaniteMesh.from_arrays(vertices, faces[:, order])._repr_png_())
        for order in ([0, 1, 2], [0, 2, 1])
    ]
    above, below = (covered(picture).mean() for picture in pictures)
    assert above == pytest.approx(below, rel=0.01)
    assert above > 0.1


def test_an_opened_mesh_reads_what_its_picture_needs(tmp_path) -> None:
    mesh = subjects.built("fine sphere", error="quadric")
    mesh.save(tmp_path / "sphere.nanite", precision="exact")
    opened = nrs.NaniteMesh.open(tmp_path / "sphere.nanite")
    np.testing.assert_array_equal(decoded(opened._repr_png_()), decoded(mesh._repr_png_()))
    assert opened.nbytes < 0.1 * mesh.nbytes


def test_a_damaged_mesh_shows_its_text(tmp_path) -> None:
    path = tmp_path / "sphere.nanite"
    subjects.built("sphere").save(path)
    data = bytearray(path.read_bytes())
    for damage in (slice(len(data) // 4, None), slice(len(data) // 4, len(data) // 2)):
        damaged = bytearray(data)
        damaged[damage] = bytes(byte ^ 0x55 for byte in damaged[damage])
        (tmp_path / "damaged.nanite").write_bytes(damaged)
        mesh = nrs.NaniteMesh.open(tmp_path / "damaged.nanite")
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert mesh._repr_png_() is None
        assert repr(mesh).startswith("NaniteMesh(")


@pytest.mark.parametrize("name", ["sphere", "part", "soup", "plane"])
def test_a_cut_is_drawn_as_it_is(name) -> None:
    """Every pixel shows what a ray through it hits among the cut's own triangles."""
    cut = subjects.built(name).cut(target_reduction=0.95)
    picture = decoded(cut._repr_png_())
    frame = _preview.cut_frame(cut)
    np.testing.assert_array_equal(picture, frame.color)
    assert frame.metadata["pixel_error"] == 0.0
    view = View(np.array(frame.metadata["pose"]), frame.metadata["yfov"], frame.width, frame.height)
    x, y = pixel_centers(np.ones_like(frame.depth, bool))
    hit, distance = Rays(cut.vertices, cut.faces).first(view.pose[:3, 3], view.directions(x, y))
    shown = frame.depth.ravel() > 0
    assert shown.mean() > 0.01
    # Outlines are snapped to 1/256 of a pixel.
    assert (shown != (hit >= 0)).mean() < 0.002
    both = shown & (hit >= 0)
    off = np.abs(frame.depth.ravel()[both] - distance[both])
    assert (off > 1e-4 * distance[both]).mean() < 0.005


def test_facets_of_a_coarse_cut_are_seen() -> None:
    """A facet has hardly more than one colour, where the mesh itself is shaded smoothly."""
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20))
    shares = []
    for shown in (mesh.cut(error=0.0), mesh):
        picture = decoded(shown._repr_png_())
        _, counts = np.unique(picture[covered(picture)], axis=0, return_counts=True)
        shares.append(np.sort(counts)[-20:].sum() / counts.sum())
    facets, smooth = shares
    assert facets > 0.9
    assert smooth < 0.5


def test_colours_of_a_cut_are_shown() -> None:
    vertices, faces = nrs.shapes.icosphere(faces=5_000)
    red = np.tile(np.array([255, 0, 0], np.uint8), (len(vertices), 1))
    picture = decoded(nrs.NaniteMesh.from_arrays(vertices, faces, colors=red).cut(error=0.0)._repr_png_())
    shown = picture[covered(picture)].mean(axis=0)
    assert shown[0] > 3 * max(shown[1], shown[2])


def test_a_cut_that_is_large_or_spoilt_shows_its_text(monkeypatch) -> None:
    cut = subjects.built("small sphere").cut(error=0.0)
    monkeypatch.setattr(_preview, "CUT_FACES", len(cut))
    assert decoded(cut._repr_png_()).shape == (360, 480, 3)
    monkeypatch.setattr(_preview, "CUT_FACES", len(cut) - 1)
    assert cut._repr_png_() is None
    spoilt = subjects.built("small sphere").cut(error=0.0)
    spoilt.vertices[3] = np.nan
    assert spoilt._repr_png_() is None
    spoilt.faces = spoilt.faces[:0]
    assert spoilt._repr_png_() is None
    assert repr(spoilt).startswith("Cut(0 faces")


def test_places_far_from_the_origin() -> None:
    near = subjects.generated("small sphere")
    far = near.vertices.astype(np.float64) + np.array([4e6, -7e6, 1e5])
    pictures = [
        decoded(nrs.NaniteMesh.from_arrays(vertices, near.faces)._repr_png_())
        for vertices in (near.vertices.astype(np.float64), far)
    ]
    assert (np.abs(np.subtract(*(p.astype(int) for p in pictures))) > 8).mean() < 0.01


# --------------------------------------------------------------------------------------------------- tables


def tables(html: str) -> list[list[list[str]]]:
    """Cells of each row of each table; that this parses says that all is closed and escaped."""
    root = ElementTree.fromstring(f"<body>{html}</body>")
    return [
        [["".join(cell.itertext()) for cell in row] for row in table.iter("tr")]
        for table in root.iter("table")
    ]


def test_stats_show_every_stage(frame) -> None:
    stats = frame.stats
    totals, stages = tables(stats._repr_html_())
    assert stages[0] == ["stage", "received", "of", "passed on", "of", "ms"]
    assert len(stages) == len(stats.stages) + 2
    for row, stage in zip(stages[1:], stats.stages, strict=False):
        assert row[0].removesuffix(" (2)") == stage.stage
        assert row[0].endswith(" (2)") == (stage.pass_number == 2)
        assert row[1:3] == [f"{stage.received:,}", stage.received_unit]
        assert row[3:5] == [f"{stage.passed:,}", stage.passed_unit]
        assert row[5] == ("–" if np.isnan(stage.ms) else f"{stage.ms:.2f}")
    assert stages[-1] == ["frame", "", "", "", "", f"{stats.total_ms:.2f}"]
    found = dict(totals)
    assert found["in the source"] == f"{stats.source_triangles:,} triangles"
    assert found["in the cut"] == f"{stats.triangles:,} triangles in {stats.clusters:,} clusters"
    assert found["covered"] == f"{stats.covered_pixels:,} pixels"
    assert {"samples", "streamed"}.isdisjoint(found)


def test_stats_of_several_samples_a_stream_and_no_clock(tmp_path) -> None:
    subjects.built("sphere").save(tmp_path / "sphere.nanite")
    scene = nrs.Scene()
    scene.add(nrs.NaniteMesh.open(tmp_path / "sphere.nanite"))
    with nrs.Renderer(64, 36, backend="cpu", streaming=True) as renderer:
        stats = renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), at(0, 0, 4), samples=4).stats
    silent = replace(stats, stages=tuple(replace(stage, ms=float("nan")) for stage in stats.stages))
    totals, stages = tables(silent._repr_html_())
    assert dict(totals)["samples"].startswith("4 of each pixel")
    assert dict(totals)["streamed"] == str(stats.stream)
    assert {row[5] for row in stages[1:-1]} == {"–"}


def test_reports_show_every_round_and_escape_what_they_say() -> None:
    report = subjects.built("soup").report
    stuck = nrs.StuckGroup(level=1, clusters=2, triangles=3, reason="<script>&")
    summary, rounds = tables(replace(report, stuck=(stuck, stuck))._repr_html_())
    assert dict(summary)["given"] == f"{report.input_faces:,} faces, {report.input_vertices:,} vertices"
    assert dict(summary)["stuck groups"] == "2 × <script>&"
    assert [row[:4] for row in rounds[1:]] == [
        [str(k), f"{level.clusters:,}", f"{level.triangles:,}", f"{level.groups:,}"]
        for k, level in enumerate(report.levels)
    ]
    assert len(rounds[0]) == len(rounds[1])


def test_checks_show_what_was_counted() -> None:
    checked = subjects.built("small sphere").check()
    (rows,) = tables(checked._repr_html_())
    assert dict(rows) == {name: f"{count:,}" for name, count in vars(checked).items()}


def test_tables_leave_colours_to_the_theme(frame) -> None:
    html = frame.stats._repr_html_() + subjects.built("small sphere").report._repr_html_()
    assert "color" not in html
    assert "background" not in html
