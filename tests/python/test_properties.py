"""What a cluster DAG promises, on every kind of mesh, from its tables and from the cuts themselves."""

import functools
import os

import numpy as np
import pytest

from oracles import distance, subjects, topology
from oracles.cuts import random_cut
from oracles.dag import Dag

SOAK = bool(os.environ.get("NANITE_SOAK"))
SCANS = ("bunny", "armadillo", "lucy", "dragon", "horse")
NAMES = (*subjects.GENERATED, *SCANS)
CUTS = 1000 * (10 if SOAK else 1)
"""Random thresholds and views in all, spread over the meshes."""


@functools.cache
def dag(name: str) -> Dag:
    return Dag.of(subjects.built(name))


@pytest.mark.parametrize("name", [*NAMES, "turbine", "mountain"])
def test_check_passes(name: str) -> None:
    subjects.built(name).check()


@pytest.mark.parametrize("name", NAMES)
def test_errors_rise_and_spheres_nest(name: str) -> None:
    d = dag(name)
    leaf = d.origin < 0
    np.testing.assert_array_equal(leaf, d.level == 0)
    assert (d.error[leaf] < 0).all()
    assert (d.error[~leaf] > 0).all()
    assert (d.group_error > 0).all()
    assert (d.error < d.group_error[d.group]).all()
    # A cluster inherits error and sphere of the group that it was made from, exactly.
    np.testing.assert_array_equal(d.error[~leaf], d.group_error[d.origin[~leaf]])
    np.testing.assert_array_equal(d.sphere[~leaf], d.group_sphere[d.origin[~leaf]])
    inner, outer = d.sphere.astype(float), d.group_sphere[d.group].astype(float)
    gap = np.linalg.norm(inner[:, :3] - outer[:, :3], axis=1) + inner[:, 3] - outer[:, 3]
    assert (gap <= 0).all(), gap.max()
    assert len(np.unique(d.ids)) == len(d.ids)
    # Something was made from every group but those whose error is infinite.
    made = np.zeros(len(d.group_error), bool)
    made[d.origin[~leaf]] = True
    np.testing.assert_array_equal(made, np.isfinite(d.group_error))


@pytest.mark.parametrize("name", NAMES)
def test_each_group_is_simplified(name: str) -> None:
    """What was made from a group has fewer triangles, about seven tenths of them on smooth meshes."""
    d = dag(name)
    before = np.bincount(d.group, d.triangles, len(d.group_error))
    made = d.origin >= 0
    after = np.bincount(d.origin[made], d.triangles[made], len(d.group_error))
    simplified = np.isfinite(d.group_error)
    assert (after[simplified] < before[simplified]).all()
    assert (d.triangles > 0).all()
    assert (d.triangles <= 128).all()
    if name not in ("soup", "ribbon"):
        assert after[simplified].sum() / before[simplified].sum() < 0.75


def only_topology_preserving_steps(report) -> bool:
    """No group needed a step of the fallback chain that may change the topology."""
    return all(sum(level.steps[1:]) == 0 for level in report.levels)


@pytest.mark.parametrize("name", NAMES)
def test_exactly_one_cluster_over_every_piece(name: str) -> None:
    source, mesh, d = subjects.subject(name), subjects.built(name), dag(name)
    count = -(-CUTS // len(NAMES))
    rng = np.random.default_rng(sum(map(ord, name)))
    row = {int(i): r for r, i in enumerate(d.ids)}
    given = topology.without_duplicates(topology.by_position(source.vertices, source.faces))
    closed = topology.unbalanced_edges(given) == 0
    euler = topology.euler_characteristic(given)
    keeps_euler = topology.is_closed(given) and only_topology_preserving_steps(mesh.report)
    seen = set()
    bad: list[str] = []
    for i in range(count):
        cut = random_cut(mesh, source, d, rng)
        drawn = np.zeros(len(d.ids), bool)
        drawn[[row[int(c)] for c in cut.cluster_ids]] = True
        least, most = d.clusters_per_path(drawn)
        assert (least, most) == (1, 1), f"cut {i}: between {least} and {most} clusters on a path"
        assert len(cut.faces) == d.triangles[drawn].sum()
        origins = d.origin[drawn & (d.origin >= 0)]
        assert cut.error >= d.group_shape_error[origins].max(initial=0.0)
        if not closed or drawn.tobytes() in seen:
            seen.add(drawn.tobytes())
            continue
        seen.add(drawn.tobytes())
        faces = topology.by_position(cut.vertices, cut.faces)
        if topology.unbalanced_edges(faces):
            bad.append(f"cut {i}: {topology.unbalanced_edges(faces)} unbalanced edges of {len(faces)} faces")
        if keeps_euler:
            if not topology.is_closed(faces):
                bad.append(f"cut {i}: edges with 1, 2, more faces: {topology.edge_valence(faces)}")
            if topology.euler_characteristic(faces) != euler:
                bad.append(
                    f"cut {i}: Euler characteristic {topology.euler_characteristic(faces)}, not {euler}"
                )
    print(f"{name}: {count} cuts, {len(seen)} different, closed {closed}, Euler {keeps_euler}")
    assert not bad, "\n".join(bad[:20])
    # All levels of what is flat have next to no error: few thresholds lie between them.
    flat = name in ("plane", "cube soup")
    assert len(seen) >= min(3 if flat else count / 10, len(d.group_error))


@pytest.mark.parametrize("name", ["terrain", "plane", "mountain", "bunny"])
def test_borders_of_open_meshes_stay_single(name: str) -> None:
    """A mesh's own border may be simplified, but no cut opens another."""
    source, mesh = subjects.subject(name), subjects.built(name)
    loops = border_loops(topology.by_position(source.vertices, source.faces))
    for error in np.geomspace(1e-5, 0.02, 12) * source.diagonal:
        cut = mesh.cut(error=float(error))
        got = border_loops(topology.by_position(cut.vertices, cut.faces))
        assert got <= loops, f"error {error:.3g}: {got} border loops, the source has {loops}"


def border_loops(faces: np.ndarray) -> int:
    """Components of the graph of border edges."""
    from scipy import sparse

    keys = topology.border_half_edges(faces)
    if not len(keys):
        return 0
    ends, index = np.unique(np.stack([keys >> 32, keys & 0xFFFFFFFF]), return_inverse=True)
    a, b = index.reshape(2, -1)
    graph = sparse.coo_matrix((np.ones(len(a)), (a, b)), (len(ends), len(ends)))
    return int(sparse.csgraph.connected_components(graph, directed=False)[0])


@pytest.mark.parametrize("name", subjects.CLOSED)
def test_volume_is_kept(name: str) -> None:
    source, mesh = subjects.subject(name), subjects.built(name)
    volume = topology.signed_volume(source.vertices, source.faces)
    area = topology.area(source.vertices, source.faces)
    for reduction in (0.5, 0.9, 0.98):
        cut = mesh.cut(target_reduction=reduction)
        assert abs(topology.signed_volume(cut.vertices, cut.faces) - volume) <= area * cut.error


def test_flat_regions_cost_next_to_nothing() -> None:
    mesh, total = subjects.built("plane"), len(subjects.subject("plane").faces)
    cut = mesh.cut(error=subjects.subject("plane").diagonal * 1e-4)
    assert len(cut.faces) < 0.05 * total
    assert distance.one_sided((cut.vertices, cut.faces), arrays("plane"), 5000).max() <= cut.error + 1e-6
    assert distance.one_sided(arrays("plane"), (cut.vertices, cut.faces), 5000).max() <= cut.error + 1e-6


def arrays(name: str) -> tuple[np.ndarray, np.ndarray]:
    source = subjects.subject(name)
    return source.vertices, source.faces


@pytest.mark.parametrize("name", [n for n in NAMES if n != "soup"])
def test_stated_error_against_the_measured_one(name: str) -> None:
    """Errors are stated with a margin for what lies between samples: no sample of ours may exceed them."""
    mesh = subjects.built(name)
    lines = []
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        if cut.error == 0 or not len(cut.faces):
            continue
        out = distance.one_sided((cut.vertices, cut.faces), arrays(name), 20_000).max()
        back = distance.one_sided(arrays(name), (cut.vertices, cut.faces), 20_000).max()
        lines.append((reduction, len(cut.faces), cut.error, out / cut.error, back / cut.error))
        assert cut.error < subjects.subject(name).diagonal
    for reduction, faces, error, out, back in lines:
        print(
            f"{name} −{reduction:.0%}: {faces} faces, stated {error:.3g};"
            f" measured ÷ stated: {out:.2f} out, {back:.2f} back"
        )
    assert all(max(out, back) < 1 for *_, out, back in lines), lines


@pytest.mark.parametrize("name", ["knot", "bunny", "armadillo"])
def test_best_has_less_error_than_fast(name: str) -> None:
    """Of cuts with about as many triangles; topology is kept in every group without help."""
    mesh = subjects.subject(name)
    rms = {}
    for quality in ("fast", "best"):
        built = subjects.built(name, quality=quality)
        built.check()
        cut = built.cut(target_reduction=0.8)
        vertices = np.asarray(cut.vertices, float)
        there = distance.to_surface(distance.samples(vertices, cut.faces, 100_000), mesh.vertices, mesh.faces)
        back = distance.to_surface(distance.samples(mesh.vertices, mesh.faces, 100_000), vertices, cut.faces)
        rms[quality] = np.sqrt(np.mean(there**2) + np.mean(back**2)) * len(cut.faces) / len(mesh.faces)
    assert rms["best"] < 0.95 * rms["fast"], rms
