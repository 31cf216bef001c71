"""Plots show the numbers that meshes and frames have."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import nanite_rs as nrs
from nanite_rs import _core
from oracles import subjects
from oracles.camera import at

pytest.importorskip("matplotlib")
plt = pytest.importorskip("matplotlib.pyplot")

PLOTS = ("levels", "error_against_triangles", "funnel", "pages")


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return subjects.built("sphere")


@pytest.fixture(scope="module")
def frame(mesh) -> nrs.Frame:
    """Rows of instances behind each other, so that stages run twice."""
    scene = nrs.Scene(ambient_light=(0.1, 0.1, 0.1))
    for k in range(40):
        scene.add(mesh, pose=at((k % 5 - 2) * 2.5, 0, -(k // 5) * 2.5))
    with nrs.Renderer(320, 180, backend="cpu") as renderer:
        return renderer.render(scene, nrs.PerspectiveCamera(yfov=0.8), at(0, 0, 5))


@pytest.fixture(scope="module")
def path(mesh, tmp_path_factory):
    path = tmp_path_factory.mktemp("plot") / "sphere.nanite"
    mesh.save(path, precision="exact")
    return path


@pytest.fixture
def subject(mesh, frame, path):
    """What each function draws."""
    return {"levels": mesh, "error_against_triangles": mesh, "funnel": frame, "pages": path}


# ---------------------------------------------------------------------------------------------- contents


@pytest.mark.parametrize("what", ["triangles", "clusters"])
def test_levels_are_those_of_the_report_and_of_the_clusters(mesh, what) -> None:
    ax = nrs.plot.levels(mesh, what=what)
    heights = [bar.get_height() for bar in ax.patches]
    assert heights == [getattr(level, what) for level in mesh.report.levels]
    assert not any(level.retried for level in mesh.report.levels)
    table = _core.cluster_table(mesh._core)
    weights = table["triangles"] if what == "triangles" else None
    assert heights == np.bincount(table["level"], weights).tolist()
    assert ax.get_yscale() == "log"
    assert (ax.get_ylabel(), ax.get_xlabel()) == (what, "level (0: the source)")


def test_levels_of_an_opened_mesh_read_no_page(path, mesh) -> None:
    opened = nrs.NaniteMesh.open(path)
    before = opened.nbytes
    assert len(nrs.plot.levels(opened).patches) == mesh.info["levels"]
    assert opened.nbytes == before


def test_bars_say_how_high_they_are() -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=20_000))
    texts = [text.get_text() for text in nrs.plot.levels(mesh).texts]
    assert texts[:3] == ["20.5k", "14.3k", "10k"]
    assert texts[-1] == "30"


def test_errors_are_those_of_cuts(mesh) -> None:
    ax = nrs.plot.error_against_triangles(mesh)
    (line,) = ax.lines
    triangles, errors = line.get_data()
    assert len(triangles) >= 12
    assert triangles[-1] == len(mesh.cut(target_faces=1))
    for count, error in zip(triangles, errors, strict=True):
        cut = mesh.cut(target_faces=int(count))
        assert (len(cut), cut.error) == (count, error)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_ylabel().endswith("units of the mesh")
    assert ax.get_legend() is None
    few = nrs.plot.error_against_triangles(mesh, cuts=5)
    assert 3 <= len(few.lines[0].get_xdata()) <= 5


def test_errors_of_attributes_are_a_line_of_their_own() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=10_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices, faces, colors=np.abs(vertices) / 2)
    ax = nrs.plot.error_against_triangles(mesh, cuts=8)
    shape, attributes = ax.lines
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["shape", "attributes"]
    for line, name in ((shape, "error"), (attributes, "attribute_error")):
        for count, error in zip(*line.get_data(), strict=True):
            assert error == getattr(mesh.cut(target_faces=int(count)), name) > 0.0


def test_a_funnel_has_the_counts_of_every_stage_and_pass(frame) -> None:
    stages = frame.stats.stages
    assert max(stage.pass_number for stage in stages) == 2
    ax = nrs.plot.funnel(frame)
    received, passed = ax.containers
    assert [bar.get_width() for bar in received] == [stage.received for stage in stages]
    assert [bar.get_width() for bar in passed] == [stage.passed for stage in stages]
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names[0] == "instance_cull"
    assert "cluster_cull (2)" in names
    assert len(names) == len(stages)
    # Stages follow each other downwards, and the numbers stand at their bars.
    assert ax.yaxis_inverted()
    texts = [text.get_text() for text in ax.texts]
    assert texts[: len(stages)] == [f"{stage.received:,} {stage.received_unit}" for stage in stages]
    assert texts[len(stages) :] == [f"{stage.passed:,} {stage.passed_unit}" for stage in stages]


def test_pages_are_those_of_the_file(mesh, path) -> None:
    ax = nrs.plot.pages(path)
    (bars,) = ax.collections
    info = nrs.NaniteMesh.file_info(path)
    tops = np.array([outline.vertices[:, 1].max() for outline in bars.get_paths()])
    assert len(tops) == info["pages"] > 3
    assert tops.sum() * 1024 == pytest.approx(info["page_bytes"], rel=1e-12)
    assert (tops > 0).all()
    assert tops.max() <= 128
    # The level of a page is that of the group that its first cluster is in.
    clusters, groups = _core.cluster_table(mesh._core), _core.group_table(mesh._core)
    _, first = np.unique(clusters["id"] >> 8, return_index=True)
    np.testing.assert_array_equal(bars.get_array(), groups["level"][clusters["group"][first]])
    coded = ax.patches[-1].get_data().values
    names = ("records", "topology", "identities", "positions", "normals", "colors", "uvs")
    assert coded.sum() * 1024 == pytest.approx(sum(info["parts"][name] for name in names), rel=0.01)
    assert ax.get_title().startswith(f"{info['pages']} pages, {info['page_bytes'] / 2**20:.1f} MiB")


def test_pages_of_a_mesh_are_those_of_its_exact_file(mesh, path) -> None:
    stored, memory = (nrs.plot.pages(source).collections[0] for source in (path, mesh))
    for a, b in zip(stored.get_paths(), memory.get_paths(), strict=True):
        np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(stored.get_array(), memory.get_array())


# --------------------------------------------------------------------------------------------------- looks


@pytest.mark.parametrize("style", ["default", "dark_background"])
@pytest.mark.parametrize("name", PLOTS)
def test_texts_stay_inside_and_apart(name, style, subject) -> None:
    with plt.style.context(style):
        ax = getattr(nrs.plot, name)(subject[name])
        ax.figure.canvas.draw()
    inside = ax.get_window_extent()
    boxes = [text.get_window_extent() for text in ax.texts]
    for box in boxes:
        assert inside.x0 <= box.x0 < box.x1 <= inside.x1
        assert inside.y0 <= box.y0 < box.y1 <= inside.y1
    labels = [
        [t.get_window_extent() for t in axis.get_ticklabels() if t.get_text()]
        for axis in (ax.xaxis, ax.yaxis)
    ]
    for group in (boxes, *labels):
        for k, box in enumerate(group):
            assert not any(box.overlaps(other) for other in group[:k])


@pytest.mark.parametrize("name", PLOTS)
def test_it_draws_where_it_is_told_and_returns_that(name, subject) -> None:
    draw = getattr(nrs.plot, name)
    _, (left, right) = plt.subplots(1, 2)
    assert draw(subject[name], ax=right) is right
    assert not left.has_data()
    assert right.has_data()
    new = draw(subject[name])
    assert new.figure is not right.figure
    assert len(plt.get_fignums()) == 2


@pytest.mark.filterwarnings("error")
def test_the_smallest_mesh_and_an_empty_frame(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays([[0, 0, 0], [1.0, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    mesh.save(tmp_path / "one.nanite")
    with nrs.Renderer(8, 8, backend="cpu") as renderer, pytest.warns(nrs.UsageWarning, match="no mesh"):
        empty = renderer.render(nrs.Scene(), nrs.PerspectiveCamera(yfov=0.8), np.eye(4))
    for ax in (
        nrs.plot.levels(mesh),
        nrs.plot.error_against_triangles(mesh),
        nrs.plot.funnel(empty),
        nrs.plot.pages(tmp_path / "one.nanite"),
        nrs.plot.pages(mesh),
    ):
        ax.figure.canvas.draw()
    assert "no cut has an error" in nrs.plot.error_against_triangles(mesh).texts[0].get_text()


# -------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize("name", PLOTS)
def test_without_matplotlib_the_error_says_what_to_install(name, subject, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(nrs.DependencyError, match=rf"plot\.{name}: .*pip install matplotlib") as error:
        getattr(nrs.plot, name)(subject[name])
    assert error.value.name == "matplotlib"
    assert isinstance(error.value, ImportError)


@pytest.mark.parametrize("name", PLOTS)
def test_arguments_of_other_types_are_refused(name, subject) -> None:
    with pytest.raises(nrs.DtypeError, match=r"^(mesh|frame|source): expected .*, not ndarray"):
        getattr(nrs.plot, name)(np.zeros(3))
    with pytest.raises(nrs.DtypeError, match=r"^ax: expected Axes, not Figure"):
        getattr(nrs.plot, name)(subject[name], ax=plt.figure())


def test_values_out_of_range_are_refused(mesh, path, tmp_path) -> None:
    with pytest.raises(nrs.ArgumentError, match=r"^what: "):
        nrs.plot.levels(mesh, what="pages")
    with pytest.raises(nrs.ArgumentError, match=r"^cuts: must be 2 or more, not 1"):
        nrs.plot.error_against_triangles(mesh, cuts=1)
    with pytest.raises(nrs.DtypeError, match=r"^cuts: expected an integer, not float"):
        nrs.plot.error_against_triangles(mesh, cuts=4.0)
    with pytest.raises(nrs.MissingFileError, match=r"absent\.nanite"):
        nrs.plot.pages(tmp_path / "absent.nanite")
    damaged = bytearray(path.read_bytes())
    damaged[30] ^= 1
    (tmp_path / "damaged.nanite").write_bytes(damaged)
    with pytest.raises(nrs.FormatError, match=r"damaged\.nanite"):
        nrs.plot.pages(tmp_path / "damaged.nanite")
