"""`BuildOptions(preserve_area=True)`: what foliage covers stays the same down to a hundredth of its triangles."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import camera, data, distance

ERRORS = ("quadric", "bound")


def coverage(vertices: np.ndarray, faces: np.ndarray, center: np.ndarray, diagonal: float) -> np.ndarray:
    """Pixels that a surface covers, seen from both sides, in parallel projections from several directions."""
    both = np.concatenate([faces, faces[:, ::-1]])
    scene = nrs.Scene()
    options = nrs.BuildOptions(error="quadric")
    scene.add(nrs.NaniteMesh.from_arrays(vertices, both, options=options, progress=False))
    renderer = nrs.Renderer(256, 256)
    lens = nrs.OrthographicCamera(xmag=0.6 * diagonal, ymag=0.6 * diagonal, znear=0.01 * diagonal)
    poses = [camera.look_at(center + 2 * diagonal * d, center, (0.1, 1.0, 0.2)) for d in camera.spread(12)]
    depths = [renderer.render(scene, lens, pose=pose, pixel_error=0.0).depth for pose in poses]
    return np.array([(depth > 0).sum() for depth in depths], float)


def ratios(arrays: dict, reductions: tuple[float, ...], **options) -> list[tuple[int, float, float]]:
    """For each part of the triangles: their number, and how much is covered against the source (mean, spread)."""
    mesh = nrs.NaniteMesh.from_arrays(**arrays, options=nrs.BuildOptions(**options), progress=False)
    return ratios_of(mesh, arrays, reductions)


def ratios_of(
    mesh: nrs.NaniteMesh, arrays: dict, reductions: tuple[float, ...]
) -> list[tuple[int, float, float]]:
    mesh.check()
    used = np.asarray(arrays["vertices"], float)[np.unique(arrays["faces"])]
    center, diagonal = (used.min(0) + used.max(0)) / 2, float(np.linalg.norm(np.ptp(used, axis=0)))
    full = mesh.cut(error=0.0)
    before = coverage(full.vertices, full.faces, center, diagonal)
    found = []
    for reduction in reductions:
        cut = mesh.cut(target_faces=int(np.ceil(len(full.faces) * reduction)))
        each = coverage(cut.vertices, cut.faces, center, diagonal) / before
        found.append((len(cut.faces), float(each.mean()), float(each.std())))
    return found


@functools.cache
def tree() -> dict:
    vertices, faces = nrs.shapes.foliage(faces=20_000, seed=1)
    return {"vertices": vertices, "faces": faces}


@pytest.mark.parametrize("quality", ["fast", "best"])
def test_a_generated_tree_covers_what_it_did(quality: str) -> None:
    kept = ratios(tree(), (0.5, 0.1, 0.03, 0.01), quality=quality, error="quadric", preserve_area=True)
    without = ratios(tree(), (0.01,), quality=quality, error="quadric")
    print(quality, kept, "without:", without)
    assert without[0][1] < 0.8
    for faces, mean, spread in kept:
        assert abs(mean - 1) < 0.05, (faces, mean)
        assert spread < 0.15, (faces, spread)


def test_blocks_cover_what_they_did(tmp_path) -> None:
    """Leaves at the borders of blocks stay until later stages."""
    options = nrs.BuildOptions(error="quadric", preserve_area=True)
    source = tree()["vertices"], tree()["faces"]
    mesh = nrs.build_file(source, tmp_path / "tree.nanite", memory="1 MiB", options=options)
    kept = ratios_of(mesh, tree(), (0.5, 0.1, 0.03, 0.01))
    for faces, mean, _ in kept:
        assert abs(mean - 1) < 0.05, (faces, mean)


MODELS = [p for p in data.folder_models("foliage") if p.suffix != ".gz"]


@pytest.mark.parametrize("quality", ["fast", "best"])
@pytest.mark.parametrize("path", [pytest.param(p, id=p.relative_to(data.shared()).parts[1]) for p in MODELS])
def test_real_foliage_covers_what_it_did(path, quality: str) -> None:
    """Within 5 % where there are enough triangles to speak of a mean."""
    # In trimesh's order, and without materials, by which clusters and what may be left out would be kept apart.
    read = nrs.io.from_trimesh(trimesh.load(path, process=False))
    source = replace(read, face_materials=None, materials=(), face_channels={})
    arrays = source.arrays()
    kept = ratios(arrays, (0.5, 0.1, 0.03, 0.01), quality=quality, error="quadric", preserve_area=True)
    without = ratios(arrays, (0.1, 0.03, 0.01), quality=quality, error="quadric")
    print(path.stem, quality, *(f"{n}: {m - 1:+.1%} ± {s:.0%}" for n, m, s in kept))
    print("  without the option:", *(f"{n}: {m - 1:+.1%}" for n, m, _ in without))
    for faces, mean, _ in kept:
        assert abs(mean - 1) < (0.05 if faces >= 30 else 0.1), (faces, mean)


def test_real_foliage_is_there() -> None:
    assert MODELS or data.require("foliage")


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("quality", ["fast", "best"])
def test_errors_include_how_leaves_grow(quality: str, error: str) -> None:
    options = nrs.BuildOptions(quality=quality, error=error, preserve_area=True)
    vertices, faces = tree()["vertices"].astype(float), tree()["faces"].astype(int)
    mesh = nrs.NaniteMesh.from_arrays(**tree(), options=options, progress=False)
    mesh.check()
    ratio = []
    for reduction in (0.7, 0.5, 0.25, 0.1, 0.03, 0.01):
        cut = mesh.cut(target_faces=int(len(faces) * reduction))
        given = (np.asarray(cut.vertices, float), cut.faces)
        out = distance.one_sided(given, (vertices, faces), 20_000).max()
        back = distance.one_sided((vertices, faces), given, 20_000).max()
        ratio.append(max(out, back) / cut.error)
    print(quality, error, "measured ÷ stated", np.round(ratio, 2))
    assert max(ratio) <= 1.0


def test_surfaces_without_islands_stay_nearly_the_same() -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
    for quality in ("fast", "best"):
        options = nrs.BuildOptions(quality=quality, preserve_area=True)
        mesh = nrs.NaniteMesh.from_arrays(vertices, faces, options=options, progress=False)
        mesh.check()
        for reduction in (0.5, 0.9):
            cut = mesh.cut(target_reduction=reduction)
            far = nrs.measure.surface_distance((cut.vertices, cut.faces), (vertices, faces))
            assert far.max < 0.05, (quality, reduction, far.max)


def test_the_result_does_not_depend_on_threads() -> None:
    def build(threads: int) -> nrs.NaniteMesh:
        options = nrs.BuildOptions(preserve_area=True, threads=threads)
        return nrs.NaniteMesh.from_arrays(**tree(), options=options, progress=False)

    assert build(1) == build(3)
