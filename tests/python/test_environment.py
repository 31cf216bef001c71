"""Light from maps against sums over all directions of glTF's own formulas, in f64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nanite_rs as nrs

SIZE = 128


@pytest.fixture(scope="module")
def ball() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=80_000), progress=False)


def shoot(scene, outputs=("linear", "shading_normal"), shading="gltf", camera=None, pose=None):
    if pose is None:
        pose = np.eye(4)
        pose[2, 3] = 3.0
    camera = camera or nrs.OrthographicCamera(1.1, 1.1)
    with nrs.Renderer(SIZE, SIZE, backend="cpu") as renderer:
        return renderer.render(scene, camera, pose, pixel_error=0.0, outputs=list(outputs), shading=shading)


def lit(ball, environment, **look):
    scene = nrs.Scene(environment=environment)
    scene.add(ball, material=nrs.Material(**{"base_color": (1, 1, 1), **look}))
    return scene


def reflected(normal, view, light, base, metallic, roughness):
    """glTF 2.0, appendix B: the BRDF times the cosine, of (N, 3) directions to lights."""
    alpha2 = max(roughness, 0.04) ** 4
    half = light + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    nl, nv, nh, vh = light @ normal, view @ normal, half @ normal, half @ view
    d = alpha2 / (np.pi * (nh * nh * (alpha2 - 1.0) + 1.0) ** 2)
    heights = nl * np.sqrt(nv * nv * (1 - alpha2) + alpha2) + nv * np.sqrt(nl * nl * (1 - alpha2) + alpha2)
    f0 = 0.04 * (1.0 - metallic) + base * metallic
    fresnel = f0 + (1.0 - f0) * (1.0 - vh) ** 5
    both = (1.0 - fresnel) * base * (1.0 - metallic) / np.pi + fresnel * 0.5 * d / heights
    return np.where(nl > 0.0, both * nl, 0.0)


def directions(rows):
    """Of the texels of a map, with what each covers; as `nrs.Environment` says they lie."""
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    fall = np.pi * (np.arange(rows) + 0.5) / rows
    turn = 2.0 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    fall, turn = np.meshgrid(fall, turn, indexing="ij")
    toward = np.stack([np.sin(fall) * np.cos(turn), np.cos(fall), np.sin(fall) * np.sin(turn)], axis=-1)
    covers = np.repeat((edges[:-1] - edges[1:])[:, None] * np.pi / rows, 2 * rows, axis=1)
    return toward.reshape(-1, 3), covers.ravel()


VIEW = np.array([0.0, 0.0, 1.0])


def pixels(frame, cosines):
    """Covered pixels whose normals have about these cosines to the eye."""
    facing = np.where(np.linalg.norm(frame.shading_normal, axis=-1) > 0.5, frame.shading_normal[..., 2], 9.0)
    return [np.unravel_index(np.abs(facing - c).argmin(), facing.shape) for c in cosines]


@pytest.mark.parametrize("metallic", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("roughness", [0.2, 0.45, 0.8, 1.0])
def test_white_all_around_gives_what_the_formulas_give(ball, metallic, roughness) -> None:
    white = nrs.Environment(np.full((4, 8, 3), 2.0, np.float32), intensity=0.5)
    frame = shoot(lit(ball, white, metallic=metallic, roughness=roughness))
    n = 900
    middles = (np.arange(n) + 0.5) / n
    fall, turn = np.meshgrid(0.5 * np.pi * middles, np.pi * middles, indexing="ij")
    side, z = np.sin(fall), np.cos(fall)
    light = np.stack([side * np.cos(turn), side * np.sin(turn), z], axis=-1).reshape(-1, 3)
    for at in pixels(frame, [1.0, 0.8, 0.5, 0.25, 0.1]):
        facing = float(frame.shading_normal[at][2])
        view = np.array([np.sqrt(1.0 - facing**2), 0.0, facing])
        every = reflected(np.array([0.0, 0.0, 1.0]), view, light, 1.0, metallic, roughness)
        expected = np.pi**2 * (every * side.ravel()).mean()
        assert frame.linear[at] == pytest.approx(expected, abs=2e-3)


def suns() -> np.ndarray:
    """A dark blue sky with a sun of a texel, and one ten times as dim elsewhere."""
    image = np.full((64, 128, 3), [0.02, 0.03, 0.05], np.float32)
    image[20, 90] = [900.0, 800.0, 600.0]
    image[40, 70] = [90.0, 80.0, 60.0]
    return image


def summed(image, frame, at, metallic, roughness, parts=8):
    """The light that a pixel of white gives by the formulas: each texel by itself, in so many parts both ways."""
    fine = np.kron(image, np.ones((parts, parts, 1)))
    toward, covers = directions(len(fine))
    normal = frame.shading_normal[at].astype(np.float64)
    weight = reflected(normal / np.linalg.norm(normal), VIEW, toward, 1.0, metallic, roughness) * covers
    return weight @ fine.reshape(-1, 3)


def split(image, normal, roughness, parts):
    """The light that white metal shows by the split sum: light about the main direction, times what white gives."""
    toward, covers = directions(parts * len(image))
    normal = normal / np.linalg.norm(normal)
    white = reflected(normal, VIEW, toward, 1.0, 1.0, roughness) @ covers
    # The main direction: from the mirrored one to the normal by roughness.
    smooth = 1.0 - roughness**2
    main = normal + (2.0 * (normal @ VIEW) * normal - VIEW - normal) * smooth * (smooth**0.5 + roughness**2)
    cosine = (toward @ main / np.linalg.norm(main)).clip(0.0)
    weight = covers * cosine / (0.5 * (1.0 + cosine) * (roughness**4 - 1.0) + 1.0) ** 2
    light = weight @ np.kron(image, np.ones((parts, parts, 1))).reshape(-1, 3) / weight.sum()
    return white * light


def test_a_sun_on_matt_surfaces(ball) -> None:
    """Of dielectrics at roughness 1 nearly all light is diffuse, which is looked up where it was summed up."""
    frame = shoot(lit(ball, nrs.Environment(suns()), metallic=0.0, roughness=1.0))
    found = []
    for x, y in np.random.default_rng(3).integers(24, 104, (30, 2)):
        expected = summed(suns(), frame, (y, x), 0.0, 1.0)
        if frame.shading_normal[y, x][2] > 0.3:
            found.append(np.abs(frame.linear[y, x] - expected).max())
    assert len(found) > 20
    most = frame.linear.max(axis=(0, 1)).max()
    print(f"matt: off by {np.mean(found) / most:.4f}, at most {np.max(found) / most:.4f} of the brightest")
    assert np.max(found) < 0.0017 * most


@pytest.mark.parametrize(
    ("roughness", "most"), [(0.25, 0.03), (0.375, 0.05), (0.5, 0.058), (0.75, 0.015), (1.0, 0.0012)]
)
def test_a_sun_in_metal_seen_straight_on(ball, roughness, most) -> None:
    """The two sums of the split by themselves: light weighted by GGX and the cosine, and what white gives.

    The sum over light takes cells of the map as wholes, which are large beside the lobe where it falls on a sun of
    a few texels: 5 % at 0.5. At roughness 1 it is exact to a thousandth.
    """
    image = np.full((64, 128, 3), 0.02, np.float32)
    # Towards the eye, +Z, and a little beside it.
    image[29:31, 97:99] = 300.0
    frame = shoot(lit(ball, nrs.Environment(image), metallic=1.0, roughness=roughness))
    at = pixels(frame, [1.0])[0]
    expected = split(image, frame.shading_normal[at].astype(np.float64), roughness, parts=8)
    print(f"roughness {roughness}: off by {np.max(np.abs(frame.linear[at] / expected - 1.0)):.4f}")
    assert frame.linear[at] == pytest.approx(expected, rel=most)


@pytest.mark.parametrize(
    ("roughness", "most", "most_of_tables"),
    [(0.35, 0.23, 0.06), (0.5, 0.2, 0.04), (0.75, 0.165, 0.0065), (1.0, 0.105, 0.0034)],
)
def test_metal_is_near_the_sum_over_all_directions(ball, roughness, most, most_of_tables) -> None:
    """What splitting the sum costs, and what tables add: rms of the light over the ball, beside its mean.

    The split itself costs 0.18, 0.16, 0.15 and 0.1 by sums in f64: no tables are much nearer. They are interpolated
    between eighths of roughness, which costs most at 0.35.
    """
    rows = 64
    toward, _ = directions(rows)
    image = np.where(toward[:, 1:2] > 0.0, [0.25, 0.35, 0.5], [0.16, 0.12, 0.08])
    image[toward @ [0.45, 0.6, 0.66] > 0.98] += 10.0
    image = image.reshape(rows, 2 * rows, 3)
    frame = shoot(lit(ball, nrs.Environment(image), metallic=1.0, roughness=roughness))
    covered = np.argwhere(frame.shading_normal[..., 2] > 0.15)
    chosen = covered[np.random.default_rng(1).choice(len(covered), 150, replace=False)]
    shown = np.array([frame.linear[tuple(at)] for at in chosen])
    expected = np.array([summed(image, frame, tuple(at), 1.0, roughness, parts=2) for at in chosen])
    normals = [frame.shading_normal[tuple(at)].astype(np.float64) for at in chosen]
    by_parts = np.array([split(image, normal, roughness, parts=2) for normal in normals])
    off, of_split, of_tables = (
        np.sqrt((difference**2).mean()) / expected.mean()
        for difference in (shown - expected, by_parts - expected, shown - by_parts)
    )
    print(f"roughness {roughness}: {off:.4f}, of the split {of_split:.4f}, of tables {of_tables:.4f}")
    assert off < most
    assert of_tables < most_of_tables


def test_a_mirror_shows_the_map(ball) -> None:
    rows = 256
    toward, _ = directions(rows)
    image = (0.5 + 0.5 * np.sin(toward * [3.0, 4.0, 5.0] + [0.0, 1.0, 2.0])).reshape(rows, 2 * rows, 3)
    frame = shoot(lit(ball, nrs.Environment(image), metallic=1.0, roughness=0.0))
    normal = frame.shading_normal.astype(np.float64)
    seen = 2.0 * normal[..., 2:] * normal - VIEW
    expected = 0.5 + 0.5 * np.sin(seen * [3.0, 4.0, 5.0] + [0.0, 1.0, 2.0])
    # Not where Fresnel's steep end is, nor where neighbouring pixels see quite other things.
    inside = normal[..., 2] > 0.4
    assert inside.sum() > 5_000
    np.testing.assert_allclose(frame.linear[inside], expected[inside], atol=6e-3)


def test_turning_the_map_is_turning_its_picture(ball) -> None:
    image = suns()
    turned = shoot(lit(ball, nrs.Environment(image, rotation=np.pi / 2), metallic=0.5, roughness=0.4))
    rolled = shoot(lit(ball, nrs.Environment(np.roll(image, -32, axis=1)), metallic=0.5, roughness=0.4))
    still = shoot(lit(ball, nrs.Environment(image), metallic=0.5, roughness=0.4))
    np.testing.assert_allclose(turned.linear, rolled.linear, rtol=2e-2, atol=2e-3)
    assert np.abs(turned.linear - still.linear).max() > 0.5


@pytest.mark.parametrize("backend", ["cpu", "auto"])
def test_the_map_behind(ball, backend) -> None:
    rows = 512
    toward, _ = directions(rows)
    image = (0.6 + 0.4 * np.sin(toward * [2.0, 3.0, 2.0])).reshape(rows, 2 * rows, 3)
    environment = nrs.Environment(image, intensity=0.5, rotation=0.7, background=True)
    scene = lit(ball, environment)
    pose = np.eye(4)
    pose[:3, 3] = [0.0, 0.0, 3.0]
    turn = 0.4
    pose[:3, :3] = [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
    with nrs.Renderer(96, 64, backend=backend) as renderer:
        outputs = ["linear", "color", "depth"]
        frame = renderer.render(
            scene, nrs.PerspectiveCamera(1.2), pose, outputs=outputs, shading="gltf", transfer="linear"
        )
        plain = renderer.render(scene, nrs.PerspectiveCamera(1.2), pose, shading="pyrender")
    y, x = np.mgrid[0:64, 0:96] + 0.5
    focal = 32.0 / np.tan(0.6)
    ray = np.stack([(x - 48) / focal, -(y - 32) / focal, -np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    back = -0.7
    ray = ray @ np.array([[np.cos(back), 0, np.sin(back)], [0, 1, 0], [-np.sin(back), 0, np.cos(back)]]).T
    expected = 0.5 * (0.6 + 0.4 * np.sin(ray * [2.0, 3.0, 2.0]))
    free = frame.depth == 0
    assert 0 < free.sum() < free.size
    np.testing.assert_allclose(frame.linear[free], expected[free], atol=2e-3)
    np.testing.assert_array_equal(frame.color[free], np.floor(255 * frame.linear[free] + 0.5))
    # pyrender's shading knows no map.
    assert (plain.color[free] == 255).all()


def test_occlusion_dims_it_and_a_light_adds_to_it(ball) -> None:
    v, f = nrs.shapes.icosphere(faces=5_000)
    mesh = nrs.NaniteMesh.from_arrays(v, f, uvs=v[:, :2], progress=False)
    open_ = nrs.Texture(np.full((1, 1), 51, np.uint8))
    whole = lit(mesh, nrs.Environment(suns()), metallic=0.3)
    dimmed = lit(mesh, nrs.Environment(suns()), metallic=0.3, occlusion_texture=open_)
    a, b = shoot(whole).linear, shoot(dimmed).linear
    covered = a.sum(axis=-1) < 2.99
    np.testing.assert_allclose(b[covered], 0.2 * a[covered], rtol=1e-5, atol=1e-6)
    whole.add(nrs.DirectionalLight(intensity=2.0))
    both = shoot(whole).linear
    whole.environment = None
    np.testing.assert_allclose(both[covered], (shoot(whole).linear + a)[covered], rtol=1e-4, atol=1e-5)


def test_numbers_and_files(ball, tmp_path) -> None:
    oiio = pytest.importorskip("OpenImageIO")
    image = suns()
    path = tmp_path / "suns.exr"
    buffer = oiio.ImageBuf(oiio.ImageSpec(128, 64, 3, oiio.FLOAT))
    buffer.set_pixels(oiio.ROI(), image)
    assert buffer.write(str(path))
    given = shoot(lit(ball, nrs.Environment(image))).linear
    for source in (path, str(path), nrs.Image.open(path)):
        np.testing.assert_array_equal(shoot(lit(ball, nrs.Environment(source))).linear, given)
    grey = shoot(lit(ball, nrs.Environment(np.full((2, 4), 188, np.uint8)))).linear
    light = ((188 / 255 + 0.055) / 1.055) ** 2.4
    same = shoot(lit(ball, nrs.Environment(np.full((2, 4, 3), light, np.float32)))).linear
    np.testing.assert_allclose(grey, same, rtol=1e-5)
    # The same image is worked out once.
    first = nrs.Environment(image)
    assert replace(first, rotation=1.0)._raw()[0] is first._raw()[0]


def test_bad_maps_are_named(ball) -> None:
    scene = nrs.Scene()
    good = np.ones((2, 4, 3), np.float32)
    for image, error, message in [
        (np.ones((4, 4, 3)), nrs.ArgumentError, "image: must be twice as wide as high"),
        (np.ones((2, 4, 3)) * -1.0, nrs.ArgumentError, "image: light must be 0 to"),
        (np.full((2, 4, 3), 1e30), nrs.ArgumentError, "image: light must be 0 to"),
        (np.full((2, 4, 3), np.nan), nrs.ArgumentError, "pixels: nan at row 0"),
        (np.full((2, 4, 3), np.inf), nrs.ArgumentError, "pixels: inf at row 0"),
        (np.ones((0, 0, 3)), nrs.ArgumentError, "pixels: the image is empty"),
        (np.ones((2, 4, 3, 1)), nrs.ArgumentError, "pixels: expected"),
        (np.array(["a"]), nrs.DtypeError, "pixels: must be"),
        ("nowhere.hdr", nrs.MissingFileError, "nowhere"),
    ]:
        with pytest.raises(error, match=message):
            scene.environment = nrs.Environment(image)
        assert scene.environment is None
    for values, error, message in [
        ({"intensity": -1.0}, nrs.ArgumentError, "intensity: must be 0 to"),
        ({"intensity": np.nan}, nrs.ArgumentError, "intensity"),
        ({"rotation": np.inf}, nrs.ArgumentError, "rotation: must be finite"),
        ({"rotation": "east"}, nrs.DtypeError, "rotation: expected a number"),
    ]:
        with pytest.raises(error, match=message):
            scene.environment = nrs.Environment(good, **values)
    with pytest.raises(nrs.DtypeError, match="environment: expected an Environment"):
        scene.environment = good
    scene.environment = nrs.Environment(good)
    assert scene.environment.intensity == 1.0
