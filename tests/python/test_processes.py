"""Whatever the parent has called before, everything works in forked children, or says why not; nothing ever hangs.

Each test runs a script in a process of its own, which forks.
"""

import os
import subprocess
import sys
import textwrap

import pytest

import nanite_rs as nrs

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")

HEAD = """
import hashlib, multiprocessing, os, pathlib, pickle, signal, sys, threading, time, warnings
import numpy as np
import nanite_rs as nrs

warnings.simplefilter("ignore")
LIMIT = 30

def forked(work):
    # What `work` returns in a forked child, or how that ended.
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        try:
            said = work()
        except BaseException as error:
            said = f"{type(error).__name__}: {error}"
        with os.fdopen(writer, "wb") as file:
            file.write(pickle.dumps(said))
        os._exit(0)
    os.close(writer)
    late = threading.Timer(LIMIT, os.kill, (child, signal.SIGKILL))
    late.start()
    with os.fdopen(reader, "rb") as file:
        said = file.read()
    os.waitpid(child, 0)
    late.cancel()
    return pickle.loads(said) if said else "hangs"

def same_on_both_sides(calls):
    # Says what differs between this process and children that are forked before and after each call.
    for name, call in calls.items():
        before = forked(call)
        want = call()
        after = forked(call)
        print("ok" if before == want == after else f"{name}: {want!r}, before {before!r}, after {after!r}")

def digest(*arrays):
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()

vertices, faces = nrs.shapes.displaced_icosphere(faces=20_000)
camera, pose = nrs.PerspectiveCamera(yfov=0.8), np.eye(4)
pose[2, 3] = 4.0
mesh = nrs.NaniteMesh.from_arrays(vertices, faces, channels={"x": vertices[:, 0]})
file = pathlib.Path("sphere.nanite")
mesh.save(file)

def scene_of(mesh):
    scene = nrs.Scene(ambient_light=(1, 1, 1))
    scene.add(mesh)
    return scene

def picture(renderer, scene):
    frame = renderer.render(scene, camera, pose)
    return digest(frame.color, frame.depth)
"""


def run(body: str, folder: os.PathLike[str], **environment: str) -> str:
    script = HEAD + textwrap.dedent(body)
    done = subprocess.run(
        [sys.executable, "-c", script],
        check=False,
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_call_works_in_a_forked_child(tmp_path) -> None:
    out = run(
        """
        scene, old = scene_of(mesh), nrs.Renderer(160, 120, backend="cpu")
        opened = nrs.NaniteMesh.open(file)
        streaming = nrs.Renderer(160, 120, backend="cpu", streaming=True, pool_bytes=1 << 20)
        streamed = scene_of(opened)
        viewer = nrs.Viewer(mesh, width=160, height=120, backend="cpu")
        frame = old.render(scene, camera, pose)
        sunny, shady = scene_of(mesh), nrs.Renderer(160, 120, backend="cpu")
        sunny.add(nrs.DirectionalLight(), pose=nrs.look_at((3, 1, 1), (0, 0, 0)))
        lit = shady.render(sunny, camera, pose, shadows=True)
        leaf = np.full((16, 16, 4), 255, np.uint8)
        leaf[:, :5, 3] = 0
        look = nrs.Material(alpha_mode="mask", base_color_texture=nrs.Texture(leaf))
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
        waves = np.sin(np.linspace(0, 20, 64))[:, None] * np.cos(np.linspace(0, 30, 64)) * 0.1
        corners, sides = np.pad(square, [(0, 0), (0, 1)]), [[0, 1, 2], [0, 2, 3]]
        card = nrs.TriangleMesh(corners, sides, uvs=square, materials=look)
        sway = [nrs.Wave((0.1, 0, 0), weight="x"), nrs.Wave((0, 0.1, 0), 0.3, (0.2, 0, 0))]
        swaying = nrs.SwayingMesh(mesh, sway)
        places = np.tile(np.eye(4), (3, 1, 1))
        places[:, 0, 3] = -3, 0, 3

        def pictured_grove():
            grove = nrs.Assembly([(mesh, places)], far_triangles=9_000)
            with nrs.Renderer(160, 120, backend="cpu") as renderer:
                return picture(renderer, scene_of(grove))

        calls = {
            "leaves": lambda: digest(nrs.foliage.to_geometry(card, wind=True).build().cut(error=0).vertices),
            "swaying": lambda: (swaying.move(0.4), digest(swaying.cut(error=0.02).vertices))[1],
            "new swaying": lambda: digest(nrs.SwayingMesh(mesh, sway).cut(error=0.02).vertices),
            "displace": lambda: digest(
                nrs.displace(corners, sides, uvs=square, height=waves, tolerance=0.001).vertices
            ),
            "assembly": pictured_grove,
            "terrain": lambda: digest(nrs.heightfield(waves, tolerance=0.01).vertices),
            "build": lambda: digest(nrs.NaniteMesh.from_arrays(vertices, faces).cut(error=0).vertices),
            "fast": lambda: len(nrs.NaniteMesh.from_arrays(vertices, faces, options=nrs.BuildOptions(threads=3))),
            "decimate": lambda: digest(nrs.decimate(mesh.cut(error=0).to_trimesh(), 2_000).vertices),
            "simplify": lambda: digest(*nrs.simplify(vertices, faces, 0.9)),
            "cut": lambda: digest(mesh.cut(target_faces=2_000).vertices),
            "channel": lambda: digest(mesh.cut(target_faces=2_000).channels["x"]),
            "opened": lambda: digest(nrs.NaniteMesh.open(file).cut(target_faces=2_000).channels["x"]),
            "opened before": lambda: digest(opened.cut(error=0).vertices),
            "measure": lambda: nrs.measure.surface_distance(mesh, mesh.cut(target_faces=2_000)).max,
            "check": lambda: mesh.check().clusters,
            "pickle": lambda: pickle.loads(pickle.dumps(mesh)) == mesh,
            "save": lambda: (mesh.save(f"{os.getpid()}.nanite"), os.path.getsize(f"{os.getpid()}.nanite"))[1],
            "old renderer": lambda: picture(old, scene),
            "new renderer": lambda: picture(nrs.Renderer(160, 120, backend="cpu"), scene_of(mesh)),
            "auto": lambda: picture(nrs.Renderer(160, 120, threads=2), scene_of(mesh)),
            "old streaming": lambda: picture(streaming, streamed),
            "new streaming": lambda: picture(
                nrs.Renderer(160, 120, backend="cpu", streaming=True, pool_bytes=1 << 20),
                scene_of(nrs.NaniteMesh.open(file)),
            ),
            "old viewer": lambda: digest(viewer.image()),
            "kept shadows": lambda: digest(shady.render(sunny, camera, pose, shadows=True).shadow),
            "new shadows": lambda: digest(
                nrs.Renderer(160, 120, backend="cpu").render(sunny, camera, pose, shadows=True).color
            ),
            "old shadows": lambda: digest(lit.shadow, lit.linear),
            "old frame": lambda: digest(frame.normal, frame.linear),
            "image": lambda: digest(nrs.Image(np.zeros((8, 8, 3), np.uint8)).pixels),
            "environment": lambda: repr(nrs.Environment(np.ones((4, 8, 3)))),
            "exr": lambda: frame.save("f.exr"),
            "image of a file": lambda: digest(nrs.Image.open("f.exr").pixels),
            "compare": lambda: nrs.compare(np.zeros((64, 64, 3), np.uint8), np.full((64, 64, 3), 5, np.uint8)).psnr,
        }
        same_on_both_sides(calls)
        """,
        tmp_path,
        # As many as a larger machine has.
        OPENIMAGEIO_THREADS="16",
    )
    assert set(out.split("\n")) == {"ok", ""}, out


def test_builds_in_blocks_and_files_of_any_kind_work_in_a_forked_child(tmp_path) -> None:
    pytest.importorskip("fsspec")
    out = run(
        """
        import concurrent.futures, io
        url = f"file://{file.absolute()}"
        opened, data = nrs.NaniteMesh.open(url, cache_dir="cache"), file.read_bytes()
        mesh.cut(target_faces=5_000).export("a.ply")

        def built(**how):
            path = pathlib.Path(f"{os.getpid()}-{threading.get_ident()}.nanite")
            nrs.build_file((vertices, faces), path, memory=1 << 20, **how)
            assert not path.with_name(f"{path.name}.work").exists()
            return digest(np.frombuffer(path.read_bytes(), np.uint8))

        def on_threads():
            with concurrent.futures.ThreadPoolExecutor(2) as executor:
                return built(executor=executor)

        def many():
            with concurrent.futures.ThreadPoolExecutor(2) as executor:
                results = nrs.build_many(["a.ply", "none.ply"], f"built{os.getpid()}", executor=executor)
            return [(result.faces, result.error) for result in results]

        calls = {
            "blocks": built,
            "blocks on threads": on_threads,
            "work folder of a URL": lambda: built(folder=f"file://{os.getcwd()}/work"),
            "many": many,
            "url": lambda: digest(nrs.NaniteMesh.open(url).cut(target_faces=2_000).vertices),
            "url opened before": lambda: digest(opened.cut(target_faces=2_000).vertices),
            "file": lambda: digest(nrs.NaniteMesh.open(io.BytesIO(data)).cut(target_faces=2_000).vertices),
            "check": lambda: nrs.NaniteMesh.open(url).check().clusters,
        }
        same_on_both_sides(calls)
        """,
        tmp_path,
    )
    assert set(out.split("\n")) == {"ok", ""}, out


def test_exports_work_in_children_of_every_start(tmp_path) -> None:
    """Levels, scenes, compressed glTF, tiles, fragments for neuroglancer: the same bytes everywhere."""
    pytest.importorskip("DracoPy")
    out = run(
        """
        opened, shown = nrs.NaniteMesh.open(file), scene_of(mesh)

        def of_charts():
            vertices, faces = nrs.shapes.displaced_icosphere(faces=4_000)
            corners = vertices[faces].reshape(-1, 3)
            uvs = np.random.default_rng(0).random((len(corners), 2), np.float32)
            image = np.random.default_rng(1).integers(0, 255, (32, 32, 3)).astype(np.uint8)
            look = nrs.Material(base_color_texture=nrs.Texture(image))
            faces = np.arange(len(corners)).reshape(-1, 3)
            return nrs.NaniteMesh.from_arrays(corners, faces, uvs=uvs, materials=look)

        def rebaked(plain):
            made = nrs.rebake(plain, texture_size=128)
            coarse = made.cut(error=np.inf)
            return coarse.vertices, coarse.uvs[0], made.materials[-1].base_color_texture.image.pixels

        def content(folder):
            names = sorted(path for path in pathlib.Path(folder).rglob("*") if path.is_file())
            return digest(*(np.frombuffer(path.read_bytes(), np.uint8) for path in names)), len(names)

        def written(write):
            import shutil, uuid
            folder = f"out-{uuid.uuid4().hex}"
            os.mkdir(folder)
            write(folder)
            found = content(folder)
            shutil.rmtree(folder)
            return found

        calls = {
            "levels": lambda: written(lambda to: mesh.export(f"{to}/a.glb", levels=[1, 0.1])),
            "meshopt": lambda: written(lambda to: mesh.export(f"{to}/a.glb", compression="meshopt")),
            "scene": lambda: written(lambda to: shown.export(f"{to}/a.glb", error=0.01)),
            "tiles": lambda: written(lambda to: mesh.to_3dtiles(to, triangles=3_000, workers=3)),
            "tiles of a file": lambda: written(
                lambda to: nrs.NaniteMesh.open(file).to_3dtiles(to, triangles=3_000)
            ),
            "tiles opened before": lambda: written(lambda to: opened.to_3dtiles(to, triangles=3_000)),
            "tiles of a scene": lambda: written(lambda to: shown.to_3dtiles(to, triangles=3_000)),
            "fragments": lambda: written(lambda to: mesh.to_neuroglancer(to, 1, triangles=3_000)),
            "ktx2": lambda: written(lambda to: of_charts().export(f"{to}/a.glb", levels=[0.5], images="ktx2")),
            "clusters": lambda: digest(*(getattr(mesh.clusters(), n) for n in ("vertices", "errors", "ids"))),
            "rebaked": lambda: digest(*rebaked(of_charts())),
            "imposter": lambda: written(lambda to: nrs.bake_imposter(mesh, views=3, size=16).save(to)),
            "imposter of a file": lambda: written(
                lambda to: nrs.bake_imposter(nrs.NaniteMesh.open(file), views=3, size=16).save(to)
            ),
        }
        same_on_both_sides(calls)
        """,
        tmp_path,
    )
    assert set(out.split("\n")) == {"ok", ""}, out
    script = tmp_path / "spawned.py"
    script.write_text(
        HEAD.replace("mesh.save(file)", 'if __name__ == "__main__": mesh.save(file)')
        + textwrap.dedent("""
        def tiled(mesh):
            folder = f"t-{os.getpid()}-{threading.get_ident()}"
            mesh.to_3dtiles(folder, triangles=3_000, overwrite=True)
            names = sorted(path for path in pathlib.Path(folder).rglob("*") if path.is_file())
            return digest(*(np.frombuffer(path.read_bytes(), np.uint8) for path in names))

        if __name__ == "__main__":
            import concurrent.futures
            want = tiled(mesh)
            for method in ("fork", "spawn", "forkserver"):
                context = multiprocessing.get_context(method)
                with concurrent.futures.ProcessPoolExecutor(2, mp_context=context) as pool:
                    print(method, set(pool.map(tiled, [mesh, mesh])) == {want})
        """)
    )
    done = subprocess.run(
        [sys.executable, script], check=False, cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.stdout.split() == ["fork", "True", "spawn", "True", "forkserver", "True"], done.stderr


def test_threads_of_openimageio_that_are_the_parents_are_an_error(tmp_path) -> None:
    """Whoever imports it first may have made them; one who has none goes on."""
    out = run(
        """
        import OpenImageIO
        a, b = np.zeros((64, 64, 3), np.uint8), np.full((64, 64, 3), 5, np.uint8)
        want = nrs.compare(a, b).psnr
        print(forked(lambda: nrs.compare(a, b).psnr))
        OpenImageIO.attribute("threads", 1)
        print(forked(lambda: nrs.compare(a, b).psnr == want))
        """,
        tmp_path,
        OPENIMAGEIO_THREADS="16",
    )
    refused, fine = out.split("\n")[:2]
    assert refused.startswith("ForkError: compare: OpenImageIO has threads in the process")
    assert fine == "True"


def test_what_another_thread_was_at_is_an_error_and_the_rest_works(tmp_path) -> None:
    out = run(
        """
        options = nrs.BuildOptions(quality="fast", error="quadric")
        big = nrs.NaniteMesh.from_arrays(*nrs.shapes.displaced_icosphere(faces=300_000), options=options)
        scene, renderer, stop = scene_of(big), nrs.Renderer(2048, 2048, backend="cpu"), False
        def draw():
            while not stop:
                renderer.render(scene, camera, pose, pixel_error=0.1, samples=16, shading="gltf")
        def build():
            while not stop:
                nrs.NaniteMesh.from_arrays(vertices, faces)
        threads = [threading.Thread(target=draw), threading.Thread(target=build)]
        for thread in threads:
            thread.start()
        time.sleep(0.3)
        ways = [
            lambda: picture(renderer, scene),
            lambda: scene.instances[0].pose[2, 2],
            lambda: len(nrs.NaniteMesh.from_arrays(vertices, faces)),
            lambda: len(big.cut(target_faces=5_000)) <= 5_000,
            lambda: nrs.Renderer(32, 32, backend="cpu").render(scene, camera, pose).depth.any() * 4.0,
        ]
        said = [forked(way) for way in ways]
        stop = True
        for thread in threads:
            thread.join()
        print(said[0].split(":")[0], said[1:] == [1.0, len(faces), True, 4.0] or said[1:])
        """,
        tmp_path,
    )
    assert out == "ForkError True\n", out


def test_a_device_is_not_used_on_both_sides_of_a_fork(tmp_path) -> None:
    try:
        nrs.Renderer(16, 16, backend="gpu").close()
    except nrs.BackendError as error:
        pytest.skip(f"no device: {error}")
    out = run(
        """
        scene, old = scene_of(mesh), nrs.Renderer(160, 120, backend="gpu")
        frame = old.render(scene, camera, pose)
        print(forked(lambda: picture(old, scene)))
        print(forked(lambda: nrs.Renderer(16, 16, backend="gpu")))
        # Where it is kept on the device, it belongs to the parent, too.
        normal = forked(lambda: digest(frame.normal))
        print(normal == digest(frame.normal) or normal.startswith("BackendError"))
        # So do pages of shadow maps, until they are read, as what is shaded on the CPU has done.
        sunny = scene_of(mesh)
        sunny.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 2, 1), (0, 0, 0)))
        lit = old.render(sunny, camera, pose, shadows=True)
        shadow = forked(lambda: digest(lit.shadow))
        own = digest(lit.shadow)
        print(shadow == own or shadow.startswith("BackendError"), forked(lambda: digest(lit.shadow)) == own)
        def auto():
            renderer = nrs.Renderer(160, 120)
            return renderer.backend, picture(renderer, scene) == want
        want = picture(nrs.Renderer(160, 120, backend="cpu"), scene)
        print(forked(auto))
        print(picture(old, scene)[:0] + "parent goes on")
        """,
        tmp_path,
    ).split("\n")
    assert all(line.startswith("BackendError") and '"spawn"' in line for line in out[:2]), out
    assert out[2:6] == ["True", "True True", "('cpu', True)", "parent goes on"], out


def test_workers_of_every_start_give_the_pictures_of_the_parent(tmp_path) -> None:
    script = tmp_path / "loader.py"
    script.write_text(
        HEAD.replace("mesh.save(file)", 'if __name__ == "__main__": mesh.save(file)')
        + textwrap.dedent("""
        class Data:
            # As a PyTorch data set: made in the parent, indexed in workers.
            def __init__(self):
                self.mesh, self.renderer, self.scene = mesh, nrs.Renderer(64, 48, backend="cpu"), None
                self.poses = nrs.orbit(mesh, 50, yfov=0.8)
            def __getitem__(self, i):
                if self.scene is None:
                    self.scene = scene_of(self.mesh)
                    self.scene.add(nrs.DirectionalLight(), pose=self.poses[3])
                frame = self.renderer.render(self.scene, camera, self.poses[i % 50], shadows=True)
                return digest(frame.color, frame.depth, frame.shadow)
            def __getstate__(self):
                return {**vars(self), "scene": None}

        def main():
            import concurrent.futures
            import joblib
            data = Data()
            want = [data[i] for i in range(50)] * 20
            for method, workers, count in (("fork", 8, 1_000), ("spawn", 2, 50), ("forkserver", 2, 50)):
                context = multiprocessing.get_context(method)
                with context.Pool(workers) as pool:
                    got = pool.map_async(data.__getitem__, range(count), chunksize=10).get(120)
                print(method, got == want[:count])
                with concurrent.futures.ProcessPoolExecutor(2, mp_context=context) as pool:
                    print(method, list(pool.map(data.__getitem__, range(4))) == want[:4])
            for backend in ("loky", "multiprocessing"):
                work = (joblib.delayed(data.__getitem__)(i) for i in range(20))
                print(backend, joblib.Parallel(n_jobs=2, backend=backend)(work) == want[:20])

        if __name__ == "__main__":
            main()
        """)
    )
    done = subprocess.run(
        [sys.executable, script], check=False, cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    said = [line.rsplit(" ", 1) for line in done.stdout.strip().split("\n")]
    ways = ["fork"] * 2 + ["spawn"] * 2 + ["forkserver"] * 2 + ["loky", "multiprocessing"]
    assert [way for way, _ in said] == ways
    assert all(equal == "True" for _, equal in said), done.stdout


def test_what_moves_and_what_blends_goes_to_workers(tmp_path) -> None:
    """Ordinary meshes that are updated, glass, wind, groves: in forked children, and in those that get a pickle."""
    (tmp_path / "work.py").write_text(
        textwrap.dedent("""
        import pickle
        import numpy as np
        import nanite_rs as nrs

        def pictures(data):
            scene, vertices = pickle.loads(data) if isinstance(data, bytes) else data
            mesh = next(node.mesh for node in scene.instances if isinstance(node.mesh, nrs.TriangleMesh))
            camera, pose = nrs.PerspectiveCamera(yfov=0.8), np.eye(4)
            pose[2, 3] = 4.0
            found = []
            with nrs.Renderer(64, 48, backend="cpu") as renderer:
                for size in (None, 0.5, 0.9):
                    if size is not None:
                        mesh.update(np.float32(size) * vertices)
                    found.append(renderer.render(scene, camera, pose).color.tobytes())
            mesh.update(np.float32(0.7) * vertices)
            return found
        """)
    )
    said = run(
        """
        sys.path.insert(0, ".")
        import work

        moving = nrs.TriangleMesh(vertices, faces)
        scene = scene_of(moving)
        scene.add(mesh, material=nrs.Material(base_color=(1, 0, 0, 0.4), alpha_mode="blend"))
        swaying = nrs.SwayingMesh(mesh, [nrs.Wave((0.3, 0, 0), 0.5, weight="x")])
        swaying.move(0.4)
        places = np.tile(np.eye(4), (3, 1, 1))
        places[:, :3, 3] = [[-2, 1, 0], [0, 1, -2], [2, 1, 0]]
        grove = nrs.Assembly([(mesh, places)], far_triangles=9_000, progress=False)
        scene.add(swaying, pose=nrs.look_at((0.0, -1.5, 0.5), (0.0, -1.5, 0.0)))
        scene.add(grove)
        moving.update(np.float32(0.7) * vertices)
        expected = work.pictures((scene, vertices))
        assert len(set(expected)) == 3
        assert forked(lambda: work.pictures((scene, vertices))) == expected
        assert work.pictures((scene, vertices)) == expected
        data = pickle.dumps((scene, vertices))
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            theirs = pool.apply_async(work.pictures, (data,)).get(timeout=120)
        assert theirs == expected
        print("the same")
        """,
        tmp_path,
        PYTHONPATH=os.pathsep.join([".", os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep),
    )
    assert said.strip() == "the same"


def test_the_number_of_threads_is_honoured(tmp_path) -> None:
    body = """
    def own():
        names = [(task / "comm").read_text() for task in pathlib.Path("/proc/self/task").iterdir()]
        return len({name for name in names if name.startswith("nanite-")})
    nrs.NaniteMesh.from_arrays(vertices, faces).cut(target_faces=2_000)
    nrs.Renderer(64, 48, backend="cpu").render(scene_of(mesh), camera, pose).color
    print(nrs.get_num_threads(), own())
    """
    if not os.path.isdir("/proc/self/task"):
        pytest.skip("threads are counted in /proc")
    assert run(body, tmp_path, NANITE_NUM_THREADS="1").split() == ["1", "1"]
    assert run(body, tmp_path, NANITE_NUM_THREADS="3", RAYON_NUM_THREADS="1").split() == ["3", "3"]
    assert run(body, tmp_path, RAYON_NUM_THREADS="2").split() == ["2", "2"]


def test_set_num_threads() -> None:
    before = nrs.get_num_threads()
    nrs.set_num_threads(3)
    assert nrs.get_num_threads() == 3
    nrs.set_num_threads(0)
    assert nrs.get_num_threads() == before
    with pytest.raises(nrs.ArgumentError, match=r"^threads: must be between 0 and 1024"):
        nrs.set_num_threads(-1)
    with pytest.raises(nrs.DtypeError, match=r"^threads: expected an integer"):
        nrs.set_num_threads(1.5)  # type: ignore[arg-type]
    with pytest.raises(nrs.ArgumentError, match="threads"):
        nrs.Renderer(16, 16, threads=-2)
