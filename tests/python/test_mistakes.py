"""Mistakes that new users make: each gives an error or a warning that says what to do; ordinary use gives none."""

from __future__ import annotations

import errno
import re
import warnings

import numpy as np
import pytest
import trimesh

import nanite_rs as nrs

V, F = nrs.shapes.icosphere(faces=500)
F = F.astype(np.int64)
LENS = nrs.PerspectiveCamera(yfov=0.8)
POSE = np.eye(4)
POSE[2, 3] = 4.0
OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def build(vertices=V, faces=F, **more):
    return nrs.NaniteMesh.from_arrays(vertices, faces, progress=False, **more)


@pytest.fixture(scope="module")
def mesh():
    return build()


def with_nan() -> np.ndarray:
    bad = V.copy()
    bad[7] = np.nan
    return bad


QUADS = np.zeros((10, 4), np.int64)
PYVISTA = np.c_[np.full(len(F), 3), F]
N, M = len(V), len(F)

BUILDING = {
    "threads below 0": (
        lambda: build(options=nrs.BuildOptions(threads=-1)),
        nrs.ArgumentError,
        "threads: must be between 0 and 1024, not -1",
    ),
    "vertices transposed": (lambda: build(V.T), nrs.ArgumentError, "vertices: .*transposed, give vertices.T"),
    "faces transposed": (lambda: build(V, F.T), nrs.ArgumentError, "faces: .*give faces.T"),
    "vertices flat": (lambda: build(V.ravel()), nrs.ArgumentError, "vertices.reshape(-1, 3)"),
    "vertices homogeneous": (lambda: build(np.c_[V, np.ones(N)]), nrs.ArgumentError, "vertices[:, :3]"),
    "vertices and faces swapped": (lambda: build(F, V), nrs.DtypeError, "are vertices and faces swapped?"),
    "vertices as integers": (lambda: build((V * 9).astype(int)), nrs.DtypeError, "astype(np.float32)"),
    "a NaN among vertices": (lambda: build(with_nan()), nrs.MeshError, "vertices[7].*leave out such rows"),
    "a path for vertices": (
        lambda: build("bunny.ply"),
        nrs.ArgumentError,
        "NaniteMesh.from_file reads files",
    ),
    "a trimesh for vertices": (
        lambda: build(trimesh.creation.box()),
        nrs.ArgumentError,
        "NaniteMesh.from_trimesh",
    ),
    "no vertices": (lambda: build([], []), nrs.ArgumentError, "vertices: .*there is nothing in it"),
    "faces from 1": (lambda: build(V, F + 1), nrs.MeshError, "count from 1.*faces - 1"),
    "faces padded by -1": (
        lambda: build(V, np.r_[F, [[0, 1, -1]]]),
        nrs.MeshError,
        "refers to vertex -1.*faces[(faces >= 0).all(axis=1)]",
    ),
    "a row too short": (
        lambda: build([[0.0, 0.0, 0.0], [1.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2]]),
        nrs.ArgumentError,
        "vertices[1] has 2 numbers and not 3",
    ),
    "faces as floats": (lambda: build(V, F.astype(float)), nrs.DtypeError, "faces.astype(np.int64)"),
    "faces flat": (lambda: build(V, F.ravel()), nrs.ArgumentError, "faces.reshape(-1, 3)"),
    "quads": (lambda: build(V, QUADS), nrs.ArgumentError, "split quads"),
    "faces of PyVista": (lambda: build(V, PYVISTA.ravel()), nrs.ArgumentError, "faces.reshape(-1, 4)[:, 1:]"),
    "normals of faces": (
        lambda: build(normals=np.ones((M, 3))),
        nrs.ArgumentError,
        "normals: .*one for each face",
    ),
    "colours of faces": (
        lambda: build(colors=np.zeros((M, 3), np.uint8)),
        nrs.ArgumentError,
        "colors: .*one for each face",
    ),
    "RGBA floats of 0 to 255": (
        lambda: build(colors=np.full((N, 4), 200.0)),
        nrs.ArgumentError,
        "colors / 255",
    ),
    "colours as int64": (lambda: build(colors=np.full((N, 3), 9)), nrs.DtypeError, "colors.astype(np.uint8)"),
    "UVs of faces": (lambda: build(uvs=np.zeros((M, 2))), nrs.ArgumentError, "uvs: .*one for each face"),
    "materials of vertices": (
        lambda: build(face_materials=np.zeros(N, int)),
        nrs.ArgumentError,
        "face_materials[faces[:, 0]]",
    ),
    "options as a dictionary": (lambda: build(options={"threads": 1}), nrs.DtypeError, "give BuildOptions"),
    "an option misspelt": (
        lambda: build(options=nrs.BuildOptions(quality="bestt")),
        nrs.ArgumentError,
        'did you mean "best"?',
    ),
    "a path for from_trimesh": (
        lambda: nrs.NaniteMesh.from_trimesh("bunny.ply"),
        nrs.DtypeError,
        "NaniteMesh.from_file",
    ),
    "an empty trimesh scene": (
        lambda: nrs.NaniteMesh.from_trimesh(trimesh.Scene()),
        nrs.MeshError,
        "mesh: there are no triangles in it",
    ),
    "a mesh for a path": (
        lambda: nrs.NaniteMesh.open(trimesh.creation.box()),
        nrs.DtypeError,
        "expected a path",
    ),
}


def check(call, error, message) -> None:
    """Raises that error; ``message`` is literal but for ``.*``."""
    with pytest.raises(error, match=".*".join(map(re.escape, message.split(".*")))) as caught:
        call()
    assert isinstance(caught.value, nrs.NaniteError)


@pytest.mark.parametrize("mistake", BUILDING)
def test_building(mistake) -> None:
    check(*BUILDING[mistake])


CUTTING = {
    "half a pixel": (
        {"camera": LENS, "pose": POSE, "viewport": (640.5, 480)},
        nrs.ArgumentError,
        "viewport: .*whole pixels",
    ),
    "a negative error": ({"error": -0.1}, nrs.ArgumentError, "error: must be 0 or more"),
    "an error that is no number": ({"error": np.nan}, nrs.ArgumentError, "error: must be 0 or more"),
    "an error and a number of triangles": (
        {"error": 0.1, "target_faces": 9},
        nrs.ArgumentError,
        "exactly one of .*found error and target_faces",
    ),
    "a reduction in percent": ({"target_reduction": 50}, nrs.ArgumentError, "50 % is 0.5"),
    "a fraction of triangles": ({"target_faces": 0.5}, nrs.DtypeError, "target_reduction takes a fraction"),
    "pixels without a camera": (
        {"error": 0.1, "pixel_error": 2.0},
        nrs.ArgumentError,
        "pixel_error: goes with camera=",
    ),
    "a camera without its pose": ({"camera": LENS}, nrs.ArgumentError, "pose= and viewport= are needed"),
}


@pytest.mark.parametrize("mistake", CUTTING)
def test_cutting(mistake, mesh) -> None:
    arguments, error, message = CUTTING[mistake]
    check(lambda: mesh.cut(**arguments), error, message)


def made(mesh) -> nrs.Scene:
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    return scene


def shot(mesh, pose=POSE, camera=LENS, scene=None, size=(64, 48), **options):
    with nrs.Renderer(*size, backend="cpu") as renderer:
        return renderer.render(made(mesh) if scene is None else scene, camera, pose, **options)


def closed(mesh):
    renderer = nrs.Renderer(64, 48, backend="cpu")
    renderer.close()
    return renderer.render(made(mesh), LENS, POSE)


def stale(mesh):
    node = made(mesh).add(mesh)
    node.remove()
    node.pose = POSE


def textured(mesh):
    look = nrs.Material(base_color_texture=nrs.Texture(np.zeros((2, 2, 3), np.uint8)))
    nrs.Scene().add(mesh, material=look)


DRAWING = {
    "degrees for radians": (lambda _: nrs.PerspectiveCamera(yfov=60), nrs.ArgumentError, "np.radians(60)"),
    "degrees for a cone": (lambda _: nrs.SpotLight(outerConeAngle=45), nrs.ArgumentError, "np.radians(45)"),
    "light that takes light away": (
        lambda _: nrs.PointLight(intensity=-1),
        nrs.ArgumentError,
        "intensity: must be finite and not negative, not -1",
    ),
    "a light's colour by its name": (lambda _: nrs.DirectionalLight("white"), nrs.DtypeError, "color: "),
    "a light's reach of zero": (lambda _: nrs.PointLight(range=0), nrs.ArgumentError, "range: "),
    "intensity as words": (lambda _: nrs.SpotLight(intensity="bright"), nrs.DtypeError, "intensity: "),
    "near beyond far": (
        lambda _: nrs.PerspectiveCamera(0.8, znear=9, zfar=1),
        nrs.ArgumentError,
        "zfar: must be greater than znear (9)",
    ),
    "a pose of 3x4": (lambda m: shot(m, POSE[:3]), nrs.ArgumentError, "np.vstack([pose, [0, 0, 0, 1]])"),
    "a transposed pose": (lambda m: shot(m, POSE.T), nrs.ArgumentError, "transposed, give pose.T"),
    "a translation for a pose": (
        lambda m: shot(m, [0, 0, 4]),
        nrs.ArgumentError,
        "pose[:3, 3] = translation",
    ),
    "rotation and translation for a pose": (
        lambda m: shot(m, (np.eye(3), [0, 0, 4])),
        nrs.ArgumentError,
        "give one matrix",
    ),
    "scale in a camera's pose": (
        lambda m: shot(m, POSE @ np.diag([2, 2, 2, 1.0])),
        nrs.ArgumentError,
        "2, 2, 2 long: divide",
    ),
    "an instance's pose transposed": (lambda m: nrs.Scene().add(m, pose=POSE.T), nrs.ArgumentError, "pose.T"),
    "an image without pixels": (
        lambda _: nrs.Renderer(0, 48),
        nrs.ArgumentError,
        "width: .*1 and 8192, not 0",
    ),
    "an image size of floats": (
        lambda _: nrs.Renderer(64.0, 48),
        nrs.DtypeError,
        "width: expected an integer",
    ),
    "a backend misspelt": (
        lambda _: nrs.Renderer(64, 48, backend="CPUs"),
        nrs.ArgumentError,
        'backend: .*did you mean "cpu"?',
    ),
    "no backend": (lambda _: nrs.Renderer(64, 48, backend=None), nrs.DtypeError, "backend: expected"),
    "a shading misspelt": (
        lambda m: shot(m, shading="pyrendr"),
        nrs.ArgumentError,
        'shading: .*did you mean "pyrender"?',
    ),
    "an output misspelt": (lambda m: shot(m, outputs=["colour"]), nrs.ArgumentError, 'did you mean "color"?'),
    "pixels as text": (lambda m: shot(m, pixel_error="1"), nrs.DtypeError, "pixel_error: expected a number"),
    "a mesh for a scene": (lambda m: shot(m, scene=m), nrs.DtypeError, "scene.add(mesh)"),
    "a trimesh scene": (
        lambda m: shot(m, scene=trimesh.Scene()),
        nrs.DtypeError,
        "not trimesh.Scene; load_scene takes it over",
    ),
    "arguments in another order": (lambda m: shot(m, camera=POSE, pose=LENS), nrs.DtypeError, "camera, pose"),
    "a closed renderer": (closed, nrs.NaniteError, "closed; make another: Renderer(width, height)"),
    "a stale handle": (stale, nrs.StaleHandleError, "was removed from the scene"),
    "an instance of another scene": (
        lambda m: nrs.Scene().remove(made(m).add(m)),
        nrs.ArgumentError,
        "another scene; node.remove()",
    ),
    "a camera added to a scene": (
        lambda _: nrs.Scene().add(LENS),
        nrs.DtypeError,
        "renderer.render(scene, camera",
    ),
    "a trimesh.Scene added to a scene": (
        lambda _: nrs.Scene().add(trimesh.Scene()),
        nrs.DtypeError,
        "not trimesh.Scene; load_scene",
    ),
    "a path added to a scene": (lambda _: nrs.Scene().add("a.ply"), nrs.DtypeError, "from_file reads files"),
    "a colour for a material": (
        lambda m: nrs.Scene().add(m, material=(1, 0, 0)),
        nrs.DtypeError,
        "Material(base_color=...)",
    ),
    "a texture for a material": (
        lambda m: nrs.Scene().add(m, material=nrs.Texture(np.zeros((2, 2, 3)))),
        nrs.DtypeError,
        "Material(base_color_texture=texture)",
    ),
    "a colour of 0 to 255": (
        lambda m: nrs.Scene().add(m, material=nrs.Material(base_color=(255, 0, 0))),
        nrs.ArgumentError,
        "base_color: .*by 255",
    ),
    "a texture without UVs": (textured, nrs.ArgumentError, "give the mesh uvs="),
    "what was loaded for a scene": (
        lambda m: shot(m, scene=(made(m), LENS, POSE)),
        nrs.DtypeError,
        "scene: .*renderer.render(*loaded)",
    ),
    "a path for pixels": (lambda _: nrs.Image("wood.png"), nrs.DtypeError, "Image.open reads files"),
    "a path for a texture": (
        lambda _: nrs.Material(base_color_texture="wood.png"),
        nrs.DtypeError,
        "base_color_texture: .*give nanite_rs.Texture('wood.png')",
    ),
    "an image for a texture": (
        lambda _: nrs.Material(base_color_texture=nrs.Image(np.ones((2, 2)))),
        nrs.DtypeError,
        "base_color_texture: .*give nanite_rs.Texture(image)",
    ),
}


@pytest.mark.parametrize("mistake", DRAWING)
def test_drawing(mistake, mesh) -> None:
    call, error, message = DRAWING[mistake]
    check(lambda: call(mesh), error, message)


def test_files(mesh, tmp_path) -> None:
    check(lambda: nrs.NaniteMesh.open(tmp_path / "none.nanite"), nrs.MissingFileError, "none.nanite")
    text = tmp_path / "text.nanite"
    text.write_text("this is a text, and no mesh")
    check(lambda: nrs.NaniteMesh.open(text), nrs.FormatError, "it is text, which begins 'this is")
    text.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\n")
    check(lambda: nrs.NaniteMesh.open(text), nrs.FormatError, "git lfs pull")
    trimesh.creation.box().export(tmp_path / "box.glb")
    check(lambda: nrs.NaniteMesh.open(tmp_path / "box.glb"), nrs.FormatError, "NaniteMesh.from_file")
    check(
        lambda: mesh.save(tmp_path / "box.ply"), nrs.FormatError, "mesh.cut(error=0).export(path) writes .ply"
    )
    check(lambda: shot(mesh).save(tmp_path / "a.jpg"), nrs.FormatError, ".jpg is unknown; .*.png or .exr")
    with pytest.raises(nrs.MissingFileError) as missing:
        mesh.save(tmp_path / "none" / "m.nanite")
    assert missing.value.errno == errno.ENOENT
    assert "none" in str(missing.value.filename)
    mesh.save(tmp_path / "m.nanite")
    scene = made(nrs.NaniteMesh.open(tmp_path / "m.nanite"))
    with nrs.Renderer(64, 48, backend="cpu", streaming=True, pool_bytes=10) as renderer:
        check(
            lambda: renderer.render(scene, LENS, POSE),
            nrs.ArgumentError,
            "pool_bytes: .*512 << 20 is 512 MiB",
        )


def moved(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


BLANK = {
    "an empty scene": ({"scene": nrs.Scene()}, "add one with scene.add(mesh)"),
    "a world-to-camera pose": ({"pose": np.linalg.inv(POSE)}, "np.linalg.inv(pose)"),
    "a camera that looks away": ({"pose": POSE @ OPENCV}, "pose @ np.diag([1, -1, -1, 1])"),
    "a world-to-camera pose of OpenCV": (
        {"pose": np.linalg.inv(moved(3, 0, 4) @ OPENCV), "camera": nrs.PerspectiveCamera(yfov=1.6)},
        "to an OpenCV camera",
    ),
    "all nearer than the near plane": (
        {"camera": nrs.PerspectiveCamera(0.8, znear=50.0)},
        "nearer than znear=50; give a smaller one",
    ),
    "all beyond the far plane": ({"camera": nrs.PerspectiveCamera(0.8, zfar=0.1)}, "farther than zfar=0.1"),
    "a camera inside a mesh": ({"pose": np.eye(4)}, "double_sided=True"),
    "a picture of a few pixels": ({"pose": moved(2.5, 0, 4), "size": (2, 2)}, "2 × 2 pixels is too small"),
}


@pytest.mark.parametrize("mistake", BLANK)
def test_pictures_that_show_nothing(mistake, mesh) -> None:
    arguments, message = BLANK[mistake]
    with pytest.warns(nrs.UsageWarning, match=re.escape(message)) as told:
        frame = shot(mesh, **arguments)
    assert not frame.depth.any()
    assert len(told) == 1
    where = "the camera is at (" in str(told[0].message)
    assert where == (mistake != "an empty scene")
    assert told[0].filename == __file__


SKY = np.ones((2, 4, 3), np.float32)

DOUBTFUL = {
    "a background of 0 to 255": (lambda: nrs.Scene(bg_color=(255, 255, 255)), "divide by 255"),
    "ambient light of 0 to 255": (lambda: nrs.Scene(ambient_light=[64, 64, 64]), "divide by 255"),
    "emission of 0 to 255": (lambda: nrs.Material(emissive=(200, 180, 20)), "divide by 255"),
    "an environment turned by degrees": (lambda: nrs.Environment(SKY, rotation=90), "np.radians(90)"),
    "colours of 0 and 1 as bytes": (lambda: build(colors=np.ones((N, 3), np.uint8)), "colors * 255"),
    "an image of floats of 0 to 255": (
        lambda: nrs.Image(np.full((2, 2, 3), 200.0)),
        "give pixels.astype(np.uint8)",
    ),
    "a near plane in a mesh": (
        lambda: shot(build(), camera=nrs.PerspectiveCamera(yfov=0.8, znear=3.2)),
        "meshes are cut off at znear=3.2",
    ),
    "single precision far away": (
        lambda: build((V + 1e7).astype(np.float32)),
        "give float64, or subtract an offset",
    ),
    "a pool without streaming": (
        lambda: nrs.Renderer(8, 8, backend="cpu", pool_bytes=1 << 20),
        "streaming=True",
    ),
    "a camera that mirrors": (
        lambda: shot(build(), pose=POSE @ np.diag([-1.0, 1.0, 1.0, 1.0])),
        "its determinant is below 0",
    ),
}


@pytest.mark.parametrize("mistake", DOUBTFUL)
def test_values_that_are_seldom_meant(mistake) -> None:
    call, message = DOUBTFUL[mistake]
    with pytest.warns(nrs.UsageWarning, match=re.escape(message)) as told:
        call()
    assert len(told) == 1
    assert told[0].filename == __file__


def test_each_view_is_looked_at_for_mirrors_until_one_is_found(mesh) -> None:
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    mirrored = POSE @ np.diag([-1.0, 1.0, 1.0, 1.0])
    with nrs.Renderer(64, 48, backend="cpu") as renderer, warnings.catch_warnings():
        warnings.simplefilter("error")
        renderer.render_views(scene, [(LENS, POSE), (LENS, POSE)])
        with pytest.warns(nrs.UsageWarning, match=re.escape("views[1]: pose: it mirrors")) as told:
            renderer.render_views(scene, [(LENS, POSE), (LENS, mirrored), (LENS, mirrored)])
        assert [one.filename for one in told] == [__file__]
        renderer.render(scene, LENS, mirrored)


def test_a_scene_without_light_says_so_when_it_is_looked_at(mesh) -> None:
    scene = nrs.Scene()
    scene.add(mesh)
    with nrs.Renderer(64, 48, backend="cpu") as renderer, warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = renderer.render(scene, LENS, POSE)
        assert frame.depth.any()
        assert renderer.render(scene, LENS, POSE, shading="flat").color.any()
        with pytest.warns(nrs.UsageWarning, match="the scene has no light"):
            assert not frame.color[frame.depth > 0].any()
        # What glows lights nothing else.
        glowing = np.eye(4)
        glowing[:3, :3] *= 0.1
        glowing[0, 3] = 1.2
        lamp = scene.add(mesh, pose=glowing, material=nrs.Material(emissive=(1.0, 1.0, 1.0)))
        with pytest.warns(nrs.UsageWarning, match="the scene has no light"):
            assert renderer.render(scene, LENS, POSE).color.any()
        lamp.remove()
        scene.environment = nrs.Environment(SKY)
        with pytest.warns(nrs.UsageWarning, match="the environment counts with"):
            assert not renderer.render(scene, LENS, POSE).color[frame.depth > 0].any()
        assert renderer.render(scene, LENS, POSE, shading="gltf").color[frame.depth > 0].any()
        scene.environment = None
        scene.ambient_light = (2.0, 2.0, 2.0)
        assert renderer.render(scene, LENS, POSE).color.any()


# Names that other packages have, and what the message has to say.
NAMES = {
    "mesh.vertices": "cut = mesh.cut(error=0) gives cut.vertices",
    "mesh.to_trimesh": "gives cut.to_trimesh()",
    "mesh.simplify": "mesh.cut(target_reduction=0.9)",
    "mesh.show": "nanite_rs.view(mesh)",
    "mesh.extents": "mesh.bounds",
    "cut.save": "cut.export(path)",
    "cut.points": "cut.vertices",
    "cut.triangles": "cut.faces",
    "cut.vertex_normals": "cut.normals",
    "frame.show": "PIL.Image.fromarray(frame.color).show()",
    "frame.image": "frame.color",
    "frame.mask": "frame.depth > 0",
    "scene.add_node": "scene.add(mesh, pose=pose)",
    "scene.show": "nanite_rs.view(scene)",
    "renderer.delete": "renderer.close()",
    "nrs.load": "NaniteMesh.from_file(path)",
    "nrs.Mesh": "NaniteMesh.from_arrays(vertices, faces)",
    "nrs.OffscreenRenderer": "Renderer(width, height)",
}


@pytest.fixture(scope="module")
def things(mesh):
    with nrs.Renderer(64, 48, backend="cpu") as renderer:
        scene = made(mesh)
        frame = renderer.render(scene, LENS, POSE)
        yield {
            "mesh": mesh,
            "cut": mesh.cut(error=0),
            "frame": frame,
            "scene": scene,
            "renderer": renderer,
            "nrs": nrs,
        }


@pytest.mark.parametrize("name", NAMES)
def test_names_of_other_packages(name, things) -> None:
    owner, attribute = name.split(".")
    with pytest.raises(AttributeError, match=re.escape(NAMES[name])):
        getattr(things[owner], attribute)
    # What nobody guesses is said as Python says it.
    with pytest.raises(AttributeError, match=r"has no attribute 'frobnicate'$"):
        things[owner].frobnicate  # noqa: B018


CALLS = {
    "a cut of a number": (lambda of: of["mesh"].cut(0.1), "cut(error=0.1), target_faces=5000"),
    "a cut of a ratio": (lambda of: of["mesh"].cut(ratio=0.1), "target_reduction=0.9 removes 90 %"),
    "a cut of faces": (lambda of: of["mesh"].cut(faces=100), "target_faces=5000"),
    "a mesh of a path": (lambda _: nrs.NaniteMesh("bunny.ply"), "from_file"),
    "arrays of a trimesh": (
        lambda _: nrs.NaniteMesh.from_arrays(trimesh.creation.box()),
        "from_trimesh(mesh)",
    ),
    "colours of vertices": (lambda _: build(vertex_colors=V), "give colors="),
    "options one by one": (lambda _: build(quality="fast"), "options=BuildOptions(...)"),
    "a size in one": (lambda _: nrs.Renderer((64, 48)), "Renderer(width, height)"),
    "a render of a scene alone": (
        lambda of: of["renderer"].render(of["scene"]),
        "orbit and look_at make poses",
    ),
    "flags of pyrender": (
        lambda of: of["renderer"].render(of["scene"], LENS, POSE, flags=1),
        "shading=, outputs= or depth_only=",
    ),
    "a pose without its name": (lambda of: of["scene"].add(of["mesh"], POSE), "scene.add(item, pose=pose)"),
    "a transform": (lambda of: of["scene"].add(of["mesh"], transform=POSE), "give pose="),
    "a field of view": (lambda _: nrs.PerspectiveCamera(fov=0.8), "did you mean yfov=?"),
    "a factor of glTF": (lambda _: nrs.Material(baseColorFactor=(1, 0, 0)), "did you mean base_color=?"),
    "a colour of a material": (lambda _: nrs.Material(color=(1, 0, 0)), "did you mean base_color=?"),
    "a size of clusters": (lambda _: nrs.BuildOptions(cluster_size=64), "cluster_triangles="),
    "a frame as a tuple": (lambda of: tuple(of["frame"]), "frame.color and frame.depth"),
    "a trimesh to simplify": (lambda _: nrs.simplify(trimesh.creation.box(), 0.9), "give vertices and faces"),
}


@pytest.mark.parametrize("mistake", CALLS)
def test_arguments_that_do_not_fit(mistake, things) -> None:
    call, message = CALLS[mistake]
    with pytest.raises(TypeError, match=re.escape(message)):
        call(things)


def test_a_frame_is_its_picture(things) -> None:
    frame = things["frame"]
    assert np.array_equal(np.asarray(frame), frame.color)
    assert np.asarray(frame).dtype == np.uint8
    assert np.asarray(frame, np.float32).max() == frame.color.max()
    np.array(frame)[:] = 0
    assert frame.color.any()


def test_simplify_takes_lists_and_says_what_it_does_not() -> None:
    points, triangles = nrs.simplify(V.tolist(), F.tolist(), 0.5)
    assert len(triangles) <= M // 2
    assert triangles.max() < len(points)
    check(lambda: nrs.simplify(V, F, target_count=0.5), nrs.DtypeError, "target_reduction takes a fraction")


def test_ordinary_use_is_silent(mesh, tmp_path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(mesh.cut(error=0)) == M
        assert shot(mesh, pixel_error=0).depth.any()
        scene = made(mesh)
        with nrs.Renderer(64, 48, backend="cpu") as renderer:
            assert renderer.render(scene, LENS, POSE).depth.any()
            # It has shown something: what shows nothing from now on is meant.
            assert not renderer.render(scene, LENS, POSE @ OPENCV).depth.any()
        mesh.save(tmp_path / "any ending")
        assert nrs.NaniteMesh.open(tmp_path / "any ending") is not None
