"""What cuts carry, against the source at sampled points: colours, UVs, labels, and the error stated of them.

``-s`` prints the figures.
"""

import igl
import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from conftest import SOAK
from nanite_rs import io
from oracles import data
from oracles.content import Carrier, samples

QUALITIES = ["fast", "best"]


def grid(n):
    """A flat unit square of 2·n² triangles, float32."""
    y, x = np.divmod(np.arange((n + 1) ** 2), n + 1)
    v = np.column_stack([x / n, y / n, np.zeros_like(x)]).astype(np.float32)
    corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + n + 2])
    return v, np.concatenate([lower, np.column_stack([corner, corner + n + 2, corner + n + 1])])


def build(v, f, quality="fast", weights=None, **content):
    options = nrs.BuildOptions(quality=quality, **(weights or {}))
    mesh = nrs.NaniteMesh.from_arrays(v, f, **content, options=options, progress=False)
    mesh.check()
    return mesh


SIZE = 160
DISC = 0.3


def painted(v):
    """A disc on the unit square as colours, labels, a step of a channel, and a distortion of UVs."""
    inside = np.hypot(v[:, 0] - 0.5, v[:, 1] - 0.5) < DISC
    x, y = v[:, 0], v[:, 1]
    return {
        "colors": {"colors": np.where(inside[:, None], [255, 0, 0], [0, 0, 255]).astype(np.uint8)},
        "labels": {"channels": {"c": inside.astype(np.int16) - 7}},
        "channel": {"channels": {"c": np.where(inside, 1e9, -1e9)}},
        "uvs": {"uvs": np.column_stack([x + 0.05 * np.sin(15 * y), y]).astype(np.float32)},
    }


@pytest.mark.parametrize("quality", QUALITIES)
def test_flat_and_plain_collapses(quality) -> None:
    mesh = build(*grid(SIZE), quality)
    cut = mesh.cut(error=0.001)
    assert len(cut.cluster_ids) == 1, "the root, and nothing finer anywhere"
    assert cut.attribute_error == 0.0
    assert all(level.max_attribute_error == 0.0 for level in mesh.report.levels)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("kind", ["colors", "labels", "channel"])
def test_flat_and_painted_keeps_its_pattern(quality, kind) -> None:
    """What is on the wrong side of the line lies no farther from it than stated, but for an edge of the source."""
    v, f = grid(SIZE)
    mesh = build(v, f, quality, **painted(v)[kind])
    points = samples(v, f, 20_000)
    from_line = np.abs(np.hypot(*(points[:, :2] - 0.5).T) - DISC)
    expected = np.hypot(*(points[:, :2] - 0.5).T) < DISC
    for error in (0.25 / SIZE, 1.0 / SIZE, 4.0 / SIZE):
        cut = mesh.cut(error=error)
        carrier = Carrier(cut.vertices, cut.faces)
        if kind == "colors":
            found = carrier.values(points, cut.colors[:, 0]) > 127.5
        elif kind == "labels":
            found = carrier.labels(points, cut.channels["c"]) == -6
        else:
            found = carrier.values(points, cut.channels["c"]) > 0.0
        away = from_line[found != expected].max(initial=0.0)
        print(f"{quality} {kind} at {error:.4f}: {len(cut)} faces, off by {away:.4f}")
        assert max(cut.error, cut.attribute_error) <= error
        assert (len(cut) > 150) or error > 2.0 / SIZE
        assert len(cut) < 0.2 * len(f)
        assert away <= cut.attribute_error + 1.5 / SIZE


@pytest.mark.parametrize("quality", QUALITIES)
def test_flat_and_textured_keeps_its_uvs(quality) -> None:
    v, f = grid(SIZE)
    uvs = painted(v)["uvs"]["uvs"]
    mesh = build(v, f, quality, uvs=uvs)
    points = samples(v, f, 20_000)
    expected = np.column_stack([points[:, 0] + 0.05 * np.sin(15 * points[:, 1]), points[:, 1]])
    sizes, worst = [], []
    for error in (0.0003, 0.001, 0.003, 0.01):
        cut = mesh.cut(error=error)
        off = np.linalg.norm(Carrier(cut.vertices, cut.faces).values(points, cut.uvs[0]) - expected, axis=1)
        sizes.append(len(cut))
        worst.append(off.max())
        assert max(cut.error, cut.attribute_error) <= error
        # A deviation counts as a length through the edges of the mesh that it was found on, the finest of which
        # are those of the source.
        assert off.max() <= cut.attribute_error * SIZE + 2e-3
        print(f"{quality} at {error}: {len(cut)} faces, UVs off by {off.max():.4f}, mean {off.mean():.5f}")
    assert sizes == sorted(sizes, reverse=True)
    assert 16 < sizes[-1] < sizes[0] < 0.5 * len(f)


def test_errors_rise_with_the_level_and_follow_the_weights() -> None:
    v, f = nrs.shapes.displaced_icosphere(faces=40_000)
    colors = np.random.default_rng(0).random((len(v), 3))
    mesh = build(v, f, colors=colors)
    cuts = [mesh.cut(target_reduction=r) for r in (0.0, 0.3, 0.6, 0.9, 0.97)]
    stated = [cut.attribute_error for cut in cuts]
    assert stated == sorted(stated)
    assert stated[0] == 0.0 < stated[1]
    for cut in cuts[1:]:
        assert cut.attribute_error > cut.error
        worst = nrs.measure.surface_distance((cut.vertices, cut.faces), (v, f), samples=20_000)
        assert worst.max <= cut.error
    indifferent = build(v, f, colors=colors, weights={"color_weight": 0.0})
    assert indifferent.cut(target_reduction=0.9).attribute_error == 0.0
    half = build(v, f, colors=colors, weights={"color_weight": 0.5})
    finest = [m.report.levels[0].max_attribute_error for m in (half, mesh)]
    assert 0.0 < finest[0] < finest[1]


@pytest.mark.parametrize("scale", [2.0**-40, 1.0, 2.0**40])
def test_the_unit_is_that_of_the_mesh(scale) -> None:
    v, f = grid(60)
    reference = build(v, f, **painted(v)["colors"]).cut(target_reduction=0.95)
    cut = build(v * np.float32(scale), f, **painted(v)["colors"]).cut(target_reduction=0.95)
    assert len(cut) == len(reference)
    assert cut.attribute_error == reference.attribute_error * scale > 0.0


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_seam_is_no_deviation(quality) -> None:
    """Across a seam UVs jump by one; what is stated is how far it moved, not the jump."""
    n = 120
    v, f = grid(n)
    uvs = v[:, :2].copy()
    angle = 2.0 * np.pi * v[:, 0].astype(np.float64)
    tube = np.column_stack([np.cos(angle), np.sin(angle), 6.0 * v[:, 1]]).astype(np.float32)
    tube[v[:, 0] == 1.0, :2] = [1.0, 0.0]
    mesh = build(tube, f, quality, uvs=uvs)
    cut = mesh.cut(target_reduction=0.9)
    edge = 2.0 * np.pi / n
    print(f"{quality}: attribute error {cut.attribute_error / edge:.4f} edges, error {cut.error / edge:.4f}")
    assert cut.attribute_error < 0.2 * edge
    # No face spans the seam.
    assert np.ptp(cut.uvs[0][cut.faces][:, :, 0], axis=1).max() < 0.5


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("name", ["sphere", "armadillo"])
def test_labels_are_the_sources_away_from_their_borders(quality, name) -> None:
    if name == "sphere":
        v, f = nrs.shapes.displaced_icosphere(faces=100_000)
    else:
        v, f = data.scan(name).vertices, data.scan(name).faces
    extent = np.ptp(v, axis=0).max()
    seeds = v[np.random.default_rng(4).choice(len(v), 24, replace=False)].astype(np.float64)
    labels = np.linalg.norm(v[:, None].astype(np.float64) - seeds, axis=2).argmin(axis=1)
    palette = np.random.default_rng(5).integers(0, 256, (24, 3), np.uint8)
    mesh = build(v, f, quality, channels={"part": labels}, colors=palette[labels])
    points = samples(v, f, 40_000)
    # Away: the nearest label is nearer than the next one by more than an edge of the cut.
    expected = Carrier(v, f).labels(points, labels)
    for reduction in (0.5, 0.9, 0.99):
        cut = mesh.cut(target_reduction=reduction)
        edge = np.sqrt(igl.doublearea(cut.vertices.astype(np.float64), cut.faces.astype(np.int64)).mean())
        off = np.linalg.norm(points[:, None] - seeds, axis=2)
        off.sort(axis=1)
        away = off[:, 1] - off[:, 0] > 2.0 * edge
        carrier = Carrier(cut.vertices, cut.faces)
        right = carrier.labels(points, cut.channels["part"]) == expected
        colors = carrier.values(points, cut.colors)[:, :3]
        alike = np.linalg.norm(colors[:, None] - palette, axis=2).argmin(axis=1) == expected
        print(
            f"{name} {quality} {reduction}: {right[away].mean():.3%} of {away.mean():.0%} away from borders,"
            f" {right.mean():.2%} of all; colours {alike[away].mean():.3%}, {alike.mean():.2%} of all;"
            f" stated {cut.attribute_error / extent:.4f} of the extent, shape {cut.error / extent:.4f}"
        )
        assert right[away].mean() >= 0.99
        assert alike[away].mean() >= 0.99
        assert away.mean() > 0.1


GLTF = {
    "FlightHelmet": ("FlightHelmet", "FlightHelmet.gltf"),
    "ToyCar": ("ToyCar", "glTF", "ToyCar.gltf"),
    "SheenChair": ("SheenChair", "glTF", "SheenChair.gltf"),
    "shaderball": ("usd_shaderball", "usd-shaderball-ball.glb"),
    "chess": ("chess_board", "chess-board.glb"),
}


@pytest.mark.parametrize("quality", QUALITIES if SOAK else QUALITIES[-1:])
@pytest.mark.parametrize("name", GLTF)
def test_textures_stay_in_place(quality, name) -> None:
    """At a tenth of the triangles: UVs at points of the source against those at the nearest point of the cut.

    Not where the source has other UVs within the distance that points moved: layers back to back, and seams, where
    the nearest point does not tell which one is meant.
    """
    scene = trimesh.load(data.require("gltf", *GLTF[name]), process=False)
    for geometry in scene.geometry.values():
        geometry.face_attributes["face_materials"] = np.zeros(len(geometry.faces), np.int64)
    source = io.from_trimesh(scene)
    options = nrs.BuildOptions(quality=quality)
    mesh = nrs.NaniteMesh.from_trimesh(scene, options=options, progress=False)
    mesh.check()
    cut = mesh.cut(target_reduction=0.9)
    off, clear = [], []
    # Part by part: layers lie closer to each other than they are simplified.
    for part in np.unique(source.face_materials):
        given = source.faces[source.face_materials == part]
        made = cut.faces[cut.face_materials == part]
        share = igl.doublearea(source.vertices.astype(np.float64), given).sum()
        total = igl.doublearea(source.vertices.astype(np.float64), source.faces.astype(np.int64)).sum()
        points = samples(source.vertices, given, max(int(20_000 * share / total), 50), seed=part)
        carrier = Carrier(source.vertices, given)
        expected = carrier.values(points, source.uvs[0])
        found = Carrier(cut.vertices, made)
        off.append(np.linalg.norm(found.values(points, cut.uvs[0]) - expected, axis=1))
        face, at = found.find(points)
        place = np.einsum("nk,nkd->nd", at, cut.vertices[made[face]])
        reach = np.linalg.norm(points - place, axis=1).max()
        around = np.random.default_rng(1).normal(size=(12, 3))
        around *= reach / np.linalg.norm(around, axis=1, keepdims=True)
        others = [carrier.values(points + step, source.uvs[0]) - expected for step in around]
        clear.append(np.linalg.norm(others, axis=2).max(axis=0) < 0.1)
    off, clear = np.concatenate(off), np.concatenate(clear)
    spread = np.ptp(source.uvs[0], axis=0).max()
    extent = np.ptp(source.vertices, axis=0).max()
    print(
        f"{name} {quality}: {len(cut)} of {len(mesh)} faces; UVs off by {off.mean():.5f} in the mean,"
        f" {off.max():.3f} at most; {off[clear].mean():.5f}, {off[clear].max():.3f} where clear"
        f" ({clear.mean():.0%}), {np.quantile(off[clear], 0.99):.4f} at 99 % (UVs span {spread:.2f});"
        f" stated {cut.attribute_error / extent:.4f}, shape {cut.error / extent:.4f}"
    )
    assert off[clear].mean() < 0.005
    assert clear.mean() > 0.3


def nearest_places(points, corners):
    """For each point and triangle the barycentric coordinates of the nearest place, (N, T, 3)."""
    away, found = np.full((len(points), len(corners)), np.inf), np.zeros((len(points), len(corners), 3))
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        t = ((points[:, None] - a) * (b - a)).sum(-1) / np.maximum(((b - a) ** 2).sum(-1), 1e-300)
        t = np.clip(t, 0.0, 1.0)
        at = np.zeros((*t.shape, 3))
        at[..., k], at[..., (k + 1) % 3] = 1.0 - t, t
        distance = np.linalg.norm(points[:, None] - a - t[..., None] * (b - a), axis=-1)
        found = np.where((distance < away)[..., None], at, found)
        away = np.minimum(away, distance)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    d = points[:, None] - corners[:, 0]
    du, dv = (d * u).sum(-1), (d * v).sum(-1)
    area = np.maximum(uu * vv - uv * uv, 1e-300)
    s, t = (vv * du - uv * dv) / area, (uu * dv - uv * du) / area
    over = (s > 0) & (t > 0) & (s + t < 1)
    return np.where(over[..., None], np.stack([1 - s - t, s, t], axis=-1), found)


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("name", GLTF)
def test_stated_deviations_hold_at_points_of_real_meshes(quality, name) -> None:
    """One step of simplification on patches of textured meshes, by the definition in docs/numerics.md.

    A patch of one group has one step between its finest and its next level, whose mean edge is that of the patch.
    """
    # In the order in which trimesh has its parts, by which patches are drawn.
    source = io.from_trimesh(trimesh.load(data.require("gltf", *GLTF[name]), process=False))
    centers = source.vertices[source.faces].mean(axis=1)
    ratios = []
    for seed in range(3):
        middle = centers[np.random.default_rng(seed).integers(len(centers))]
        faces = source.faces[np.linalg.norm(centers - middle, axis=1).argsort()[:900]]
        used, faces = np.unique(faces, return_inverse=True)
        v, f = source.vertices[used].astype(np.float64), faces.reshape(-1, 3)
        mesh = build(v, f, quality, uvs=source.uvs[0][used], normals=source.normals[used])
        cuts = [mesh.cut(target_reduction=r) for r in (0.2, 0.3, 0.4, 0.5, 0.6)]
        cuts = [cut for cut in cuts if len(cut) and (cut.cluster_levels == 1).all()]
        assert cuts, "a level of its own"
        cut, fine = cuts[0], mesh.cut(error=0)
        surfaces = [(c.vertices.astype(np.float64), c.faces, c.uvs[0], c.normals) for c in (fine, cut)]
        edges = [np.sqrt(igl.doublearea(p, t.astype(np.int64)) * 2 / np.sqrt(3)) for p, t, *_ in surfaces]
        mean = np.sqrt((edges[0] ** 2).mean())
        stated, most = cut.attribute_error, 0.0
        for (p, t, uv, n), (q, u, other_uv, other_n), e in [
            (*surfaces, edges[1]),
            (*surfaces[::-1], edges[0]),
        ]:
            chosen = np.random.default_rng(seed).integers(len(t), size=400)
            at = np.random.default_rng(seed + 1).dirichlet([0.7] * 3, 400)
            points, here_uv, here_n = (
                np.einsum("nk,nkd->nd", at, a[t[chosen]].astype(float)) for a in (p, uv, n)
            )
            places = nearest_places(points, q[u])
            there = (np.einsum("ntk,tkd->ntd", places, a[u].astype(float)) for a in (q, other_uv, other_n))
            there, there_uv, there_n = there
            away = np.linalg.norm(there - points[:, None], axis=-1)
            off = np.linalg.norm(there_uv - here_uv[:, None], axis=-1)
            turned = np.linalg.norm(unit(there_n) - unit(here_n)[:, None], axis=-1)
            deviation = np.minimum(np.maximum(off, turned), 1.0) * np.maximum(mean, e)
            most = max(most, np.maximum(away - cut.error, deviation).min(axis=1).max())
        # Normals are stored with 2 x 16 bits.
        assert most <= stated * (1 + 1e-6) + 2e-4 * mean, f"patch {seed}"
        ratios.append(stated / most)
    print(f"{name} {quality}: stated / largest of samples {np.round(ratios, 2)}")
    assert np.median(ratios) < 4.0


@pytest.mark.parametrize("quality", QUALITIES)
def test_vertices_have_the_label_of_the_source_beside_them(quality) -> None:
    """At every level, since labels do not come from the level before, where they may be off by half a triangle."""
    v, f = nrs.shapes.displaced_icosphere(faces=40_000)
    labels = np.floor(4 * v) @ np.array([1, 10, 100])
    mesh = build(v, f, quality, channels={"part": labels.astype(np.int32)})
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        _, face, near = igl.point_mesh_squared_distance(cut.vertices.astype(float), v.astype(float), f)
        at = trimesh.triangles.points_to_barycentric(v[f[face]].astype(float), near)
        of_corners = labels[f[face]]
        shares = ((of_corners[:, :, None] == of_corners[:, None]) * at[:, None]).sum(axis=2)
        expected = of_corners[np.arange(len(at)), shares.argmax(axis=1)]
        wrong = (cut.channels["part"] != expected).mean()
        print(f"{quality} {reduction}: {wrong:.2%} have another label than the source beside them")
        assert wrong < 0.06


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_sides_of_a_thin_wall_keep_their_labels(quality) -> None:
    """A shell a hundredth thick, with a label on each side, also where the error is larger than that."""
    v, f = nrs.shapes.displaced_icosphere(faces=20_000)
    inner = v - 0.01 * v / np.linalg.norm(v, axis=1, keepdims=True)
    shell = np.concatenate([v, inner]).astype(np.float32), np.concatenate([f, f[:, ::-1] + len(v)])
    side = np.repeat(np.int32([5, -5]), len(v))
    mesh = build(*shell, quality, channels={"side": side})
    for reduction in (0.5, 0.9, 0.97):
        cut = mesh.cut(target_reduction=reduction)
        corners = cut.vertices[cut.faces].astype(float)
        outwards = (
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * corners.mean(axis=1)
        ).sum(1)
        wrong = (cut.channels["side"][cut.faces] != 5 * np.sign(outwards)[:, None]).mean()
        print(
            f"{quality} {reduction}: error {cut.error:.4f}, {wrong:.2%} of corners have the other side's label"
        )
        assert wrong < 0.05
