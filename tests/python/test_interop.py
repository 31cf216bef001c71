"""Scenes of pyrender, taken over and drawn, beside pyrender's own pictures of them; their textures kept."""

import warnings

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs
from oracles import compare, picture

WIDTH, HEIGHT = 480, 360


def moved(x: float, y: float, z: float, angle: float = 0.0) -> np.ndarray:
    pose = trimesh.transformations.rotation_matrix(angle, [0.3, 1.0, 0.2])
    pose[:3, 3] = x, y, z
    return pose


@pytest.fixture
def pyrender():
    return picture.import_pyrender()


@pytest.fixture
def scene(pyrender):
    """Smooth and flat meshes, vertex colours, instances, a fan and a strip, below nodes that move; four lights."""
    scene = pyrender.Scene(ambient_light=(0.1, 0.12, 0.15), bg_color=(0.0, 0.0, 0.0, 0.0))
    arm = scene.add_node(pyrender.Node(matrix=moved(-1.2, 0.2, 0.0, 0.4))) or next(iter(scene.nodes))
    ball = trimesh.creation.icosphere(subdivisions=4)
    ball.visual.vertex_colors = np.uint8(127.5 * (1.0 + np.c_[ball.vertices, np.ones(len(ball.vertices))]))
    scene.add(pyrender.Mesh.from_trimesh(ball), pose=moved(0.0, 0.0, -0.5, 0.8), parent_node=arm)
    clay = pyrender.MetallicRoughnessMaterial(
        baseColorFactor=(0.8, 0.4, 0.2, 1.0),
        metallicFactor=0.3,
        roughnessFactor=0.4,
        emissiveFactor=(0.1, 0.3, 0.5),
    )
    knot = trimesh.creation.torus(0.8, 0.3, 64, 32)
    poses = np.array([moved(1.3, 0.8, 0.0, 0.5), moved(1.3, -0.9, -0.3, 2.0)])
    scene.add(pyrender.Mesh.from_trimesh(knot, material=clay, smooth=False, poses=poses))
    sheet = pyrender.MetallicRoughnessMaterial(baseColorFactor=(0.3, 0.7, 0.4, 1.0), doubleSided=True)
    around = np.linspace(0.0, 5.0, 12)
    rim = np.c_[np.cos(around), np.sin(around), np.zeros(12)]
    up = np.tile([0.0, 0.0, 1.0], (13, 1))
    fan = pyrender.Primitive(np.r_[np.zeros((1, 3)), rim], up, material=sheet, mode=6)
    band = np.stack([rim, 1.3 * rim], axis=1).reshape(-1, 3) + np.array([0.0, 0.0, 0.1])
    strip = pyrender.Primitive(band, np.tile([0.0, 0.0, 1.0], (24, 1)), material=sheet, mode=5)
    scene.add(pyrender.Mesh([fan, strip]), pose=moved(0.0, -1.0, -2.0))
    scene.add(
        pyrender.DirectionalLight(color=(1.0, 0.9, 0.8), intensity=2.0), pose=moved(0.0, 0.0, 0.0, -0.5)
    )
    scene.add(pyrender.PointLight(color=(0.5, 0.7, 1.0), intensity=12.0), pose=moved(0.5, 2.0, 2.0))
    scene.add(pyrender.PointLight(intensity=5.0, range=1.0), pose=moved(-2.0, -1.0, 2.0))
    lamp = pyrender.SpotLight(color=(1.0, 0.6, 0.3), intensity=90.0, innerConeAngle=0.1, outerConeAngle=0.25)
    scene.add(lamp, pose=moved(0.3, 0.2, 5.0, -0.1))
    return scene


CAMERAS = {
    "perspective": lambda p: p.PerspectiveCamera(yfov=0.9),
    "wide": lambda p: p.PerspectiveCamera(yfov=0.9, znear=0.1, zfar=50.0),
    "intrinsics": lambda p: p.IntrinsicsCamera(fx=400.0, fy=410.0, cx=230.0, cy=190.0),
    "orthographic": lambda p: p.OrthographicCamera(xmag=1.0, ymag=2.2),
}


@pytest.mark.parametrize("kind", CAMERAS)
def test_pictures_are_pyrenders(pyrender, scene, kind, tmp_path) -> None:
    scene.add(CAMERAS[kind](pyrender), pose=moved(0.1, 0.1, 5.0))
    color, depth = picture._offscreen(WIDTH, HEIGHT).render(scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        view = nrs.from_pyrender(scene, viewport=(WIDTH, HEIGHT))
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        frame = renderer.render(*view, pixel_error=0.0)
    with compare.evidence(tmp_path / "pair.png", frame.color, color[..., :3]):
        assert len(view.scene) == 5
        other = (frame.depth > 0) ^ (depth > 0)
        assert other.sum() <= 30
        inside = compare.away_from_silhouettes(depth, 0.01) & ~other
        assert inside.sum() > 0.25 * depth.size
        # pyrender takes the depth of parallel views for that of a pinhole.
        assert kind == "orthographic" or np.abs(frame.depth - depth)[inside].max() < 0.01
        assert compare.psnr(frame.color, color[..., :3], inside) >= 40


def test_points_and_lines_among_meshes_are_pyrenders(pyrender, scene, tmp_path) -> None:
    """Without light, which pyrender casts on points and lines as if they were surfaces."""
    rng = np.random.default_rng(2)
    places = rng.uniform(-1.8, 1.8, (400, 3)).astype(np.float32)
    colors = rng.random((400, 3)).astype(np.float32)
    scene.add(pyrender.Mesh.from_points(places, colors=colors))
    for mode in (1, 2, 3):
        own = slice(30 * mode, 30 * mode + 24)
        scene.add(pyrender.Mesh([pyrender.Primitive(places[own], color_0=colors[own], mode=mode)]))
    scene.add(pyrender.PerspectiveCamera(yfov=0.9), pose=moved(0.1, 0.1, 5.0))
    color, depth = picture._offscreen(WIDTH, HEIGHT).render(scene, flags=pyrender.RenderFlags.FLAT)
    view = nrs.from_pyrender(scene, viewport=(WIDTH, HEIGHT))
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        # pyrender writes base colours as they are.
        frame = renderer.render(*view, pixel_error=0.0, shading="flat", transfer="linear")
    with compare.evidence(tmp_path / "pair.png", frame.color, color[..., :3]):
        # A line may go through the pixel beside.
        same = np.abs(frame.depth - depth) < 0.01 * np.maximum(depth, 1e-9)
        nodes = [node for own in view.instances.values() for node in own]
        drawn = [node.instance_id for node in nodes if isinstance(node.mesh, nrs.Points | nrs.Lines)]
        strokes = np.isin(frame.instance_id, drawn)
        assert (strokes & same).sum() > 1200
        assert (strokes & same).sum() > 0.75 * strokes.sum()
        assert (~same).mean() < 0.02
        assert compare.psnr(frame.color, color[..., :3], same) >= 38


def test_glass_is_pyrenders_but_for_linear_light(pyrender, tmp_path) -> None:
    """Glass before a ball: pyrender's pictures of either alone, laid over each other in linear light."""
    alpha = 0.4
    ball = trimesh.creation.icosphere(subdivisions=4)
    pane = trimesh.creation.box((1.6, 1.6, 0.02))
    clay = {"baseColorFactor": (0.8, 0.4, 0.2, 1.0), "roughnessFactor": 0.6}
    sheet = {"baseColorFactor": (0.2, 0.6, 0.9, 1.0), "roughnessFactor": 0.9, "metallicFactor": 0.0}

    def script(shown):
        out = pyrender.Scene(ambient_light=(0.2, 0.2, 0.2), bg_color=(0.0, 0.0, 0.0, 0.0))
        for mesh, look, pose in shown:
            material = pyrender.MetallicRoughnessMaterial(**look)
            out.add(pyrender.Mesh.from_trimesh(mesh, material=material, smooth=mesh is ball), pose=pose)
        out.add(pyrender.DirectionalLight(intensity=2.0), pose=moved(0.0, 0.0, 0.0, -0.5))
        out.add(pyrender.PerspectiveCamera(yfov=0.9), pose=moved(0.0, 0.0, 4.0))
        return out

    behind, front = (ball, clay, np.eye(4)), (pane, sheet, moved(0.4, 0.2, 1.5, 0.2))
    alone = [picture._offscreen(WIDTH, HEIGHT).render(script([one])) for one in (behind, front)]
    glass = {**sheet, "baseColorFactor": (0.2, 0.6, 0.9, alpha), "alphaMode": "BLEND"}
    view = nrs.from_pyrender(script([(pane, glass, front[2]), behind]), viewport=(WIDTH, HEIGHT))
    with nrs.Renderer(WIDTH, HEIGHT, backend="cpu") as renderer:
        frame = renderer.render(*view, pixel_error=0.0)
    (under, near), (over, far) = [(color[..., :3] / 255.0, depth) for color, depth in alone]
    covered = far > 0
    # A pane has a front and no back: its sides are seen from outside alone.
    wanted = np.where(covered[..., None], alpha * over**2.2 + (1.0 - alpha) * under**2.2, under**2.2)
    wanted = np.rint(255.0 * wanted ** (1.0 / 2.2)).astype(np.uint8)
    inside = compare.away_from_silhouettes(near, 0.01) & compare.away_from_silhouettes(far, 0.01)
    with compare.evidence(tmp_path / "pair.png", frame.color, wanted):
        assert (covered & (near > 0)).sum() > 3000
        assert inside.sum() > 5000
        assert compare.psnr(frame.color, wanted, inside & covered) >= 38
        assert compare.psnr(frame.color, wanted, inside & (near > 0)) >= 38


@pytest.mark.parametrize("backend", ["cpu", "gpu"])
@pytest.mark.parametrize("textured", [False, True])
def test_emission_counts_twice_in_pyrender(pyrender, backend, textured) -> None:
    glow = pyrender.MetallicRoughnessMaterial(
        emissiveFactor=(0.25, 0.5, 0.75),
        emissiveTexture=np.full((4, 4, 3), 255, np.uint8) if textured else None,
    )
    ball = trimesh.creation.icosphere(subdivisions=3)
    uv = np.zeros((len(ball.vertices), 2), np.float32)
    ball = pyrender.Primitive(
        ball.vertices, ball.vertices, texcoord_0=uv, indices=ball.faces, material=glow, mode=4
    )
    dark = pyrender.Scene(ambient_light=(0.0, 0.0, 0.0))
    dark.add(pyrender.Mesh([ball]))
    dark.add(pyrender.PerspectiveCamera(yfov=0.9), pose=moved(0.0, 0.0, 5.0))
    color, depth = picture._offscreen(WIDTH, HEIGHT).render(dark)
    try:
        renderer = nrs.Renderer(WIDTH, HEIGHT, backend=backend)
    except nrs.BackendError as error:
        pytest.skip(str(error))
    with renderer:
        view = nrs.from_pyrender(dark, viewport=(WIDTH, HEIGHT))
        frames = [renderer.render(*view, shading=shading) for shading in ("pyrender", "gltf")]
    seen = (depth > 0) & (frames[0].depth > 0)
    np.testing.assert_allclose(frames[0].linear[seen], [[0.0625, 0.25, 0.5625]] * seen.sum(), rtol=1e-6)
    np.testing.assert_allclose(frames[1].linear[seen], [[0.25, 0.5, 0.75]] * seen.sum(), rtol=1e-6)
    assert np.abs(frames[0].color[seen].astype(int) - color[seen]).max() <= 1


def meshes_of(view: nrs.PyrenderView) -> set[int]:
    return {id(instance.mesh) for own in view.instances.values() for instance in own}


def test_meshes_are_built_once(pyrender, scene) -> None:
    camera = scene.add(pyrender.PerspectiveCamera(yfov=0.9), pose=moved(0.0, 0.0, 5.0))
    meshes = [meshes_of(nrs.from_pyrender(scene)) for _ in range(2)]
    assert meshes[0] == meshes[1]
    assert len(meshes[0]) == 4
    # Poses are read anew.
    scene.set_pose(camera, moved(0.0, 0.5, 5.0))
    assert nrs.from_pyrender(scene).pose[1, 3] == 0.5
    # Arrays that were replaced are built again.
    primitive = next(m for m in scene.meshes if len(m.primitives) == 2).primitives[0]
    primitive.positions = primitive.positions * 2.0
    again = meshes_of(nrs.from_pyrender(scene))
    assert len(again & meshes[0]) == 3


PIXELS = np.random.default_rng(4).integers(0, 256, (4, 8, 4), dtype=np.uint8)


def painted(pyrender, **fields):
    """A material with a texture in every slot, and a ball with UVs that wears it."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    sampler = pyrender.Sampler(magFilter=9728, minFilter=9985, wrapS=33071, wrapT=33648)
    texture = pyrender.Texture(sampler=sampler, source=PIXELS, source_channels="RGBA")
    material = pyrender.MetallicRoughnessMaterial(
        **{
            "baseColorTexture": texture,
            "normalTexture": PIXELS[..., :3],
            "metallicRoughnessTexture": PIXELS[..., :3],
            "occlusionTexture": PIXELS[..., :3],
            "emissiveTexture": texture,
            "emissiveFactor": (0.1, 0.2, 0.3),
            **fields,
        }
    )
    uv = ball.vertices[:, :2].astype(np.float32)
    primitive = pyrender.Primitive(
        ball.vertices,
        ball.vertices,
        texcoord_0=uv,
        texcoord_1=uv,
        indices=ball.faces,
        material=material,
        mode=4,
    )
    scene = pyrender.Scene()
    scene.add(pyrender.Mesh([primitive]))
    scene.add(pyrender.PerspectiveCamera(yfov=0.9), pose=moved(0.0, 0.0, 5.0))
    return scene, primitive


def node_of(view: nrs.PyrenderView) -> nrs.MeshNode:
    return next(node for own in view.instances.values() for node in own)


def test_textures_are_kept(pyrender) -> None:
    scene, primitive = painted(pyrender, alphaMode="MASK", alphaCutoff=0.25)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        node = node_of(nrs.from_pyrender(scene))
    material = node.material
    base = material.base_color_texture
    assert np.array_equal(base.image.pixels, PIXELS)
    assert (base.wrap, base.filter, base.mipmaps, base.anisotropy) == (
        ("clamp", "mirror"),
        "nearest",
        "nearest",
        1,
    )
    assert material.emissive_texture.image is base.image
    assert np.array_equal(material.normal_texture.image.pixels, PIXELS[..., :3])
    # Roughness in green and metalness in blue, whatever pyrender keeps of them.
    assert np.array_equal(material.metallic_roughness_texture.image.pixels[..., 1:], PIXELS[..., 1:3])
    assert np.array_equal(material.occlusion_texture.image.pixels[..., 0], PIXELS[..., 0])
    assert (material.alpha_mode, material.alpha_cutoff) == ("mask", 0.25)
    # What pyrender takes for them of a texture that is there already are the first two channels.
    texture = pyrender.Texture(source=PIXELS[..., :3], source_channels="RGB")
    primitive.material.metallicRoughnessTexture = texture
    swapped = node_of(nrs.from_pyrender(scene)).material.metallic_roughness_texture
    assert np.array_equal(swapped.image.pixels[..., 1:], PIXELS[..., :2])
    assert len(node.mesh.cut(error=0.0).uvs) == 2
    # Images and meshes are made once, and again for other pixels.
    again = node_of(nrs.from_pyrender(scene))
    assert again.mesh is node.mesh
    assert again.material.base_color_texture.image is base.image
    primitive.material.baseColorTexture.source = PIXELS[::-1]
    other = node_of(nrs.from_pyrender(scene)).material.base_color_texture.image
    assert np.array_equal(other.pixels, PIXELS[::-1])


@pytest.mark.parametrize(("alpha", "mode"), [(255, "opaque"), (200, "blend")])
def test_blending_counts_where_there_is_something_to_blend(pyrender, alpha, mode) -> None:
    pixels = PIXELS.copy()
    pixels[..., 3] = alpha
    scene, _ = painted(pyrender, baseColorTexture=pixels, alphaMode="BLEND")
    texture = pyrender.Texture(source=pixels, source_channels="RGBA")
    next(iter(scene.meshes)).primitives[0].material.baseColorTexture = texture
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        node = node_of(nrs.from_pyrender(scene))
    assert node.material.alpha_mode == mode
    assert not [one for one in caught if issubclass(one.category, UserWarning)]


def test_what_is_left_out_is_said(pyrender) -> None:
    scene = pyrender.Scene()
    ball = trimesh.creation.icosphere(subdivisions=2)
    glass = pyrender.MetallicRoughnessMaterial(alphaMode="BLEND", baseColorFactor=(1.0, 1.0, 1.0, 0.5))
    image = np.zeros((4, 4, 3), np.uint8)
    painted = pyrender.MetallicRoughnessMaterial(baseColorTexture=image)
    scene.add(pyrender.Mesh.from_trimesh(ball, material=glass))
    scene.add(pyrender.Mesh.from_trimesh(ball, material=painted))
    scene.add(pyrender.Mesh.from_trimesh(ball, wireframe=True), pose=moved(3.0, 0.0, 0.0))
    scene.add(pyrender.Mesh.from_points(ball.vertices))
    with pytest.raises(nrs.ArgumentError, match="no camera"):
        nrs.from_pyrender(scene)
    scene.add(pyrender.PerspectiveCamera(yfov=0.9))
    with pytest.warns(UserWarning, match="left out") as caught:
        view = nrs.from_pyrender(scene)
    for what in ("textures of primitives without UVs", "wireframes"):
        assert what in str(caught[0].message)
    assert len(view.scene) == 4
    node = next(node for node, own in view.instances.items() if own)
    assert view.instances[node][0].visible
    node.mesh.is_visible = False
    with pytest.warns(UserWarning, match="left out"):
        assert not nrs.from_pyrender(scene).instances[node][0].visible


@pytest.mark.parametrize("other", [None, 3, trimesh.Scene(), nrs.Scene()])
def test_other_scenes_are_refused(other) -> None:
    with pytest.raises(nrs.DtypeError, match="scene"):
        nrs.from_pyrender(other)
