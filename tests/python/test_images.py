"""Pictures of both backends against pyrender on OSMesa, 1280×720, one sample per pixel on both sides.

What *rounding* means here. Both rasterizers snap projected vertices to 1/256 pixel: a vertex moves by at most
√2/512 pixel on the screen, and with it every point of its triangles, so an unprojected pixel lies within
√2/512 of a pixel's footprint of the surface that was drawn. Depth is float32: reversed and infinite, it is
near / z rounded once after interpolation, some 2⁻²² of z in all; unprojection multiplies that by the length
of the ray per unit depth.
"""

from dataclasses import replace

import numpy as np
import pytest

import nanite_rs as nrs
from conftest import SOAK
from oracles import compare, distance, picture
from oracles.setup import Setup, setup

SCANS = ("bunny", "lucy", "dragon", *(("armadillo", "horse", "turbine") if SOAK else ()))
SHAPES = ("fine knot", "gyroid", *(("fine sphere", "fine part") if SOAK else ()))
STORED = "stored "
"""Before the name of a mesh: saved with the default precision, and opened again."""
NAMES = (*SCANS, *SHAPES, STORED + "bunny", *((STORED + "turbine",) if SOAK else ()))


class Shots:
    """What the tests of one mesh share: pyrender's pictures, and those of a backend."""

    def __init__(self, name: str, folder) -> None:
        self.label = name
        self.setup: Setup = setup(name.removeprefix(STORED))
        self.is_stored = name.startswith(STORED)
        if self.is_stored:
            self.setup.built.save(folder / "mesh.nanite")
            self.setup = replace(self.setup, _built=nrs.NaniteMesh.open(folder / "mesh.nanite"))
        self.rounding: float = self.setup.built.info["rounding"]
        oracle = self.setup.oracle()
        view = self.setup.view
        self.color, self.depth = oracle.render(view)
        fine, _ = oracle.render(view.with_size(4 * view.width, 4 * view.height))
        self.reference = compare.average_linear(fine, 4)

    def take(self, backend: str) -> None:
        self.name = f"{self.label}-{backend}"
        self.full = self.setup.render(0.0, backend)
        self.cut = self.setup.render(1.0, backend)


@pytest.fixture(scope="module", params=NAMES)
def oracle(request, tmp_path_factory) -> Shots:
    """Scoped to the module, so that all tests of one mesh run together and share its pictures."""
    picture.import_pyrender()
    return Shots(request.param, tmp_path_factory.mktemp("stored"))


@pytest.fixture(scope="module", params=("cpu", "gpu"))
def shots(request, oracle: Shots) -> Shots:
    try:
        oracle.take(request.param)
    except nrs.BackendError as error:
        pytest.skip(str(error))
    return oracle


def test_silhouettes_are_within_a_pixel(shots: Shots, tmp_path) -> None:
    s, name = shots, shots.name
    theirs = s.depth > 0
    for label, frame in (("full", s.full), ("cut", s.cut)):
        ours = frame.depth > 0
        assert not frame.color[~ours].any(), "colour outside the mask"
        with compare.evidence(tmp_path / f"{name}-{label}.png", ours, theirs):
            assert compare.outside_by_more_than_a_pixel(ours, theirs) == 0, label
            assert compare.holes(ours, theirs) == 0, label


def test_full_detail_coverage_and_depth_agree(shots: Shots, tmp_path) -> None:
    s, name = shots, shots.name
    ours, theirs = s.full.depth > 0, s.depth > 0
    # Where the two snap a vertex to different sides, single pixels of the outline differ. Where a file moved
    # vertices by a part of a pixel more do, by up to a pixel: see above.
    with compare.evidence(tmp_path / f"{name}.png", ours, theirs):
        assert s.is_stored or np.count_nonzero(ours ^ theirs) <= 1e-4 * theirs.sum() + 2
    inside = compare.away_from_silhouettes(s.depth, 1 / s.setup.view.focal) & ours
    relative = np.abs(s.full.depth - s.depth)[inside] / s.depth[inside]
    moved = s.rounding / s.depth[inside].min()
    # Where a surface is seen at a slant, depth moves farther than the surface; how far that does is tested below.
    assert s.is_stored or np.quantile(relative, 0.999) < 2e-4
    assert np.median(relative) < 1e-5 + moved


def test_full_detail_color_is_pyrenders(shots: Shots, tmp_path) -> None:
    s, name = shots, shots.name
    where = compare.away_from_silhouettes(s.depth, 1 / s.setup.view.focal)
    assert where.sum() > 0.5 * (s.depth > 0).sum()
    print(f"{name}: {compare.psnr(s.full.color, s.color, where):.2f} dB over {where.sum():,} pixels")
    with compare.evidence(tmp_path / f"{name}.png", s.full.color, s.color):
        assert compare.psnr(s.full.color, s.color, where) >= 40


def test_cut_is_no_further_from_the_truth_than_a_single_sample(shots: Shots, tmp_path) -> None:
    """Truth: pyrender at full detail, 4×4 samples averaged in linear light (γ = 2.2), compared as encoded."""
    s, name = shots, shots.name
    covered = (s.depth > 0) | (s.cut.depth > 0) | (s.reference.max(axis=-1) > 0)
    ours = compare.psnr(s.cut.color, s.reference, covered)
    theirs = compare.psnr(s.color, s.reference, covered)
    print(f"{name}: ours at 1 px {ours:.2f} dB, pyrender at full detail {theirs:.2f} dB")
    with compare.evidence(tmp_path / f"{name}.png", s.cut.color, s.reference):
        assert ours >= theirs - 0.5


def test_covered_pixels_lie_on_the_source(shots: Shots) -> None:
    s, name = shots, shots.name
    view, mesh = s.setup.view, s.setup.mesh
    for tau, frame in ((0.0, s.full), (1.0, s.cut)):
        cut = s.setup.built.cut(
            camera=lens(view), pose=view.pose, viewport=(view.width, view.height), pixel_error=tau
        )
        rows, columns = np.nonzero(frame.depth > 0)
        depth = frame.depth[rows, columns].astype(np.float64)
        points = view.unproject(columns + 0.5, rows + 0.5, depth)
        away = distance.to_surface(points, mesh.vertices, mesh.faces)
        slant = np.linalg.norm(points - view.pose[:3, 3], axis=1) / depth
        rounding = depth / view.focal * np.sqrt(2) / 512 + slant * depth * 2.0**-22
        over = away - cut.error - rounding
        print(
            f"{name}, τ = {tau}: farthest {away.max():.3g},"
            f" cut.error {cut.error:.3g}, rounding {rounding.max():.2g}"
        )
        assert over.max() <= 0, (tau, np.count_nonzero(over > 0), over.max())
        # The rule bounds every error by τ pixels where it is seen: so is the distance of each pixel.
        # At an angle θ off the axis a unit is f·sec²θ ÷ distance pixels long at most.
        allowed = tau * slant * depth / (view.focal * slant**2)
        assert (away - allowed - rounding - s.rounding).max() <= 0, tau


def lens(view):
    return nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear)
