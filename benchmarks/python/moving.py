"""Meshes that move: new vertices in every frame, beside pyrender's; 100 bodies; joints; waves; glass; points.

``python -m benchmarks.python.moving``. A frame is colour, depth and ids at 640 × 480.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import nanite_rs as nrs

from . import machine, tables
from .measure import interleaved
from .peer import YFOV

RESULTS = Path(__file__).resolve().parents[1] / "results"
SIZE = (640, 480)
LARGE = (1280, 720)
FACES = 13_776
"""Triangles of a body model."""
CAMERA = nrs.PerspectiveCamera(yfov=YFOV, znear=0.05)
SHAPES = 16


def shapes(faces: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Shapes of one topology, each as a body that bends."""
    vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces)
    bent = []
    for step in range(SHAPES):
        turn = 0.4 * np.sin(0.4 * step) * vertices[:, 1]
        x, z = vertices[:, 0], vertices[:, 2]
        moved = [x * np.cos(turn) - z * np.sin(turn), vertices[:, 1], x * np.sin(turn) + z * np.cos(turn)]
        bent.append(np.ascontiguousarray(np.stack(moved, 1), np.float32))
    return bent, triangles


class Ours:
    """Bodies in rows, all of which change in every frame."""

    def __init__(self, faces: int, count: int) -> None:
        self.shapes, self.faces = shapes(faces)
        self.bodies = [nrs.TriangleMesh(self.shapes[0], self.faces) for _ in range(count)]
        self.scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
        across = int(np.ceil(np.sqrt(count)))
        for k, body in enumerate(self.bodies):
            pose = np.eye(4)
            pose[:3, 3] = 2.6 * (k % across - (across - 1) / 2), 2.6 * (k // across - (across - 1) / 2), 0
            self.scene.add(body, pose=pose)
        self.scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))
        self.pose = nrs.look_at((0, 0, 3.5 * across), (0, 0, 0))
        self.renderer = nrs.Renderer(*SIZE, backend="cpu")

    def update(self, step: int) -> None:
        """New vertices for each."""
        for k, body in enumerate(self.bodies):
            body.update(self.shapes[(step + k) % SHAPES])

    def frame(self, step: int) -> tuple[np.ndarray, ...]:
        """New vertices, and a picture."""
        self.update(step)
        return self.still()

    def still(self) -> tuple[np.ndarray, ...]:
        """A picture alone."""
        frame = self.renderer.render(self.scene, CAMERA, self.pose, outputs=["color", "depth", "instance_id"])
        return frame.color, frame.depth, frame.instance_id


class Pyrender:
    """The same by pyrender: a new mesh in every frame, a picture, and one of ids."""

    def __init__(self, faces: int) -> None:
        import pyrender

        self.shapes, self.faces = shapes(faces)
        self.pyrender, self.node = pyrender, None
        self.scene = pyrender.Scene(ambient_light=(0.2, 0.2, 0.2))
        pose = nrs.look_at((0, 0, 3.5), (0, 0, 0))
        self.scene.add(pyrender.PerspectiveCamera(yfov=YFOV, znear=0.05), pose=pose)
        self.scene.add(pyrender.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))
        self.renderer = pyrender.OffscreenRenderer(*SIZE)

    def frame(self, step: int) -> tuple[np.ndarray, ...]:
        """New vertices with normals, and two pictures."""
        import trimesh

        if self.node is not None:
            self.scene.remove_node(self.node)
        mesh = trimesh.Trimesh(self.shapes[step % SHAPES], self.faces, process=False)
        self.node = self.scene.add(self.pyrender.Mesh.from_trimesh(mesh))
        color, depth = self.renderer.render(self.scene)
        names = {self.node: (1, 0, 0)}
        ids, _ = self.renderer.render(self.scene, self.pyrender.RenderFlags.SEG, seg_node_map=names)
        return color, depth, ids


def glass(runs: int) -> list[dict[str, object]]:
    """Knots behind each other, opaque and blended."""
    mesh = nrs.TriangleMesh(*nrs.shapes.torus_knot(faces=60_000))
    scenes = {}
    for mode, alpha in (("opaque", ()), ("blend", (0.4,))):
        scene = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
        for k in range(3):
            pose = np.eye(4)
            pose[:3, 3] = 0.7 * (k - 1), 0, -0.8 * k
            look = nrs.Material(base_color=(0.8, 0.7, 0.6, *alpha), alpha_mode=mode, double_sided=True)
            scene.add(mesh, pose=pose, material=look)
        scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))
        scenes[mode] = scene
    pose = nrs.look_at((0.5, 0.5, 5.0), (0, 0, 0))
    renderers = {mode: nrs.Renderer(*SIZE, backend="cpu") for mode in scenes}

    def frame(mode: str) -> nrs.Frame:
        return renderers[mode].render(scenes[mode], CAMERA, pose, outputs=["color"])

    calls = {mode: (lambda _, mode=mode: frame(mode).color) for mode in scenes}
    times = interleaved(calls, runs=runs, warm_up=2, budget=60)
    return [
        {"knots": mode, "ms": times[mode]["median"] * 1e3, "layers": frame(mode).stats.layers}
        for mode in scenes
    ]


class Levels:
    """A mesh with levels of detail that moves, and the same with all its triangles, in every frame."""

    def __init__(self, virtual: nrs.SkinnedMesh | nrs.SwayingMesh, vertices: np.ndarray, faces: np.ndarray):
        self.virtual, self.vertices = virtual, vertices
        self.whole = nrs.TriangleMesh(vertices, faces)
        self.renderer = nrs.Renderer(*SIZE, backend="cpu")
        self.scenes = {}
        for name, shape in (("virtual", self.virtual), ("whole", self.whole)):
            scene = self.scenes[name] = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
            scene.add(shape)
            scene.add(nrs.DirectionalLight(intensity=3.0), pose=nrs.look_at((1, 1, 2), (0, 0, 0)))

    def move(self, step: int) -> None:
        """Show another shape."""
        raise NotImplementedError

    def moved(self, step: int) -> np.ndarray:
        """All vertices in that shape, by NumPy."""
        raise NotImplementedError

    def rest(self) -> None:
        """Show the shape at rest."""
        raise NotImplementedError

    def picture(self, name: str) -> nrs.Frame:
        """Of what was moved last."""
        pose = nrs.look_at((0, 0, 3.5), (0, 0, 0))
        return self.renderer.render(
            self.scenes[name], CAMERA, pose, outputs=["color", "depth", "instance_id"]
        )

    def frame(self, step: int) -> np.ndarray:
        """A shape, and a picture."""
        self.move(step)
        return self.picture("virtual").color

    def every_vertex(self, step: int) -> np.ndarray:
        """All vertices moved by NumPy, and a picture of all triangles."""
        self.whole.update(self.moved(step))
        return self.picture("whole").color

    def row(self, runs: int) -> dict[str, object]:
        """Times, and what was drawn."""
        times = interleaved(
            {"move + frame": self.frame, "move": self.move, "all vertices + frame": self.every_vertex},
            runs=max(runs // 4, 3),
            warm_up=2,
            budget=60,
        )
        row = {"triangles": f"{len(self.virtual):,}", "drawn": self.picture("virtual").stats.triangles}
        self.rest()
        row |= {"drawn at rest": self.picture("virtual").stats.triangles}
        return row | {f"{what}, ms": own["median"] * 1e3 for what, own in times.items()}


class Walker(Levels):
    """A mesh that follows joints along its height."""

    JOINTS = 16

    def __init__(self, faces: int) -> None:
        vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces)
        height = (vertices[:, 1] - vertices[:, 1].min()) / np.ptp(vertices[:, 1])
        hats = 1.0 - np.abs(height[:, None] * (self.JOINTS - 1) - np.arange(self.JOINTS))
        self.weights = np.clip(hats, 0.0, 1.0).astype(np.float32)
        mesh = nrs.NaniteMesh.from_arrays(vertices, triangles, channels={"weights": self.weights})
        super().__init__(nrs.SkinnedMesh(mesh), vertices, triangles)

    def matrices(self, step: int) -> np.ndarray:
        """Joints that turn about the height, each by another angle."""
        turn = 0.3 * np.sin(0.4 * step + 0.2 * np.arange(self.JOINTS))
        out = np.tile(np.eye(4), (self.JOINTS, 1, 1))
        out[:, 0, 0], out[:, 0, 2] = np.cos(turn), np.sin(turn)
        out[:, 2, 0], out[:, 2, 2] = -np.sin(turn), np.cos(turn)
        return out

    def move(self, step: int) -> None:
        """Pose the joints."""
        self.virtual.pose(self.matrices(step))

    def moved(self, step: int) -> np.ndarray:
        """Linear blend skinning."""
        rows = np.einsum("vj,jab->vab", self.weights, self.matrices(step)[:, :3].astype(np.float32))
        return np.einsum("vab,vb->va", rows[:, :, :3], self.vertices) + rows[:, :, 3]

    def rest(self) -> None:
        """No joint moves."""
        self.virtual.pose(np.tile(np.eye(4), (self.JOINTS, 1, 1)))


class Swaying(Levels):
    """A mesh that leans with its height, and over which a wave runs."""

    RATE = 25.0

    def __init__(self, faces: int) -> None:
        vertices, triangles = nrs.shapes.displaced_icosphere(faces=faces)
        self.height = ((vertices[:, 1] - vertices[:, 1].min()) / np.ptp(vertices[:, 1])).astype(np.float32)
        mesh = nrs.NaniteMesh.from_arrays(vertices, triangles, channels={"height": self.height})
        self.waves = [
            nrs.Wave((0.2, 0, 0), 0.3, weight="height"),
            nrs.Wave((0, 0, 0.03), 0.7, (0.0, 0.5, 0.0)),
        ]
        super().__init__(nrs.SwayingMesh(mesh, self.waves), vertices, triangles)

    def move(self, step: int) -> None:
        """Set the time."""
        self.virtual.move(step / self.RATE)

    def moved(self, step: int) -> np.ndarray:
        """The displacement as it is written down."""
        out = np.array(self.vertices, np.float32)
        for wave in self.waves:
            turns = wave.frequency * step / self.RATE + self.vertices @ np.array(wave.vector, np.float32)
            weight = 1.0 if wave.weight is None else self.height
            out += (weight * np.sin(2.0 * np.pi * turns))[:, None] * np.array(wave.amplitude, np.float32)
        return out

    def rest(self) -> None:
        """Show the mesh itself."""
        scene = self.scenes["virtual"] = nrs.Scene(ambient_light=(0.2, 0.2, 0.2))
        scene.add(self.virtual.rest)


def levels(kind: type[Walker | Swaying], runs: int) -> list[dict[str, object]]:
    """Meshes that move, with levels of detail and without."""
    return [kind(faces).row(runs) for faces in (100_000, 1_000_000)]


def points(runs: int) -> list[dict[str, object]]:
    """A million points through a ball and on a surface, beside pyrender's."""
    import pyrender

    rng = np.random.default_rng(0)
    inside = rng.normal(size=(1_000_000, 3))
    inside *= rng.uniform(0.3, 1.0, (len(inside), 1)) / np.linalg.norm(inside, axis=1, keepdims=True)
    clouds = {"ball": inside, "surface": np.asarray(nrs.shapes.displaced_icosphere(faces=2_000_000)[0])}
    pose, rows = nrs.look_at((0, 0, 2.2), (0, 0, 0)), []
    flat = pyrender.RenderFlags.FLAT
    for name, cloud in clouds.items():
        colors = np.clip(cloud * 0.5 + 0.5, 0.0, 1.0).astype(np.float32)
        for size in (1.0, 3.0):
            shown = nrs.Points(cloud, colors=colors, radius=size / 2.0)
            scene = nrs.Scene()
            scene.add(shown)
            script = pyrender.Scene()
            script.add(pyrender.Mesh.from_points(cloud, colors=colors))
            script.add(pyrender.PerspectiveCamera(yfov=YFOV, znear=0.05), pose=pose)
            ours = nrs.Renderer(*LARGE, backend="cpu")
            theirs = pyrender.OffscreenRenderer(*LARGE, point_size=size)

            def frame(_: int, ours: nrs.Renderer = ours, scene: nrs.Scene = scene) -> object:
                picture = ours.render(scene, CAMERA, pose, outputs=["color", "depth"])
                return picture.color, picture.depth

            times = interleaved(
                {
                    "frame": frame,
                    "update": lambda step, shown=shown, cloud=cloud: shown.update(
                        cloud * (1.0 + 0.001 * step)
                    ),
                    "pyrender": lambda _, renderer=theirs, script=script: renderer.render(script, flags=flat),
                },
                runs=max(runs // 4, 3),
                warm_up=2,
                budget=60,
            )
            theirs.delete()
            row = {"points": f"{len(cloud):,}, {name}", "pixels wide": size}
            row |= {f"{what}, ms": own["median"] * 1e3 for what, own in times.items()}
            rows.append(row | {"pyrender ÷ frame": times["pyrender"]["median"] / times["frame"]["median"]})
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python.moving", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer runs: to try it, not to quote")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    runs = 5 if options.quick else 60
    one, peer, many = Ours(FACES, 1), Pyrender(FACES), Ours(FACES, 100)
    times = interleaved(
        {
            "nanite_rs, one body": one.frame,
            "nanite_rs, its update alone": one.update,
            "nanite_rs, its picture alone": lambda _: one.still(),
            "pyrender, one body": peer.frame,
        },
        runs=runs,
        warm_up=3,
        budget=120,
    )
    times |= interleaved(
        {"nanite_rs, 100 bodies": many.frame, "nanite_rs, their updates alone": many.update},
        runs=runs // 4 + 1,
        warm_up=1,
        budget=120,
    )
    base = times["nanite_rs, one body"]["median"]
    rows = [
        {"what": name, "ms": own["median"] * 1e3, "× one body": own["median"] / base}
        for name, own in times.items()
    ]
    here = machine.describe()
    date = tables.today()
    lines = [
        f"# Meshes that move, {date}" + (" (quick: not to quote)" if options.quick else ""),
        "",
        f"`python -m benchmarks.python.moving`. {here['processor']}, {here['cores']} cores,",
        f"{here['memory_gib']} GiB. {FACES:,} triangles, new vertices and normals in every frame; colour,",
        f"depth and ids at {SIZE[0]}×{SIZE[1]}, on the CPU backend. pyrender draws a second picture for the ids.",
        "Medians of runs in turn.",
        "",
        tables.table(rows),
        f"## Joints, {Walker.JOINTS} of them, a pose in every frame",
        "",
        tables.table(levels(Walker, runs)),
        "## Waves, two of them, a time in every frame",
        "",
        tables.table(levels(Swaying, runs)),
        "## Three knots of 60,000 triangles each",
        "",
        tables.table(glass(runs)),
        f"## Points, {LARGE[0]}×{LARGE[1]}, colour and depth",
        "",
        "pyrender draws squares without light, ours are discs.",
        "",
        tables.table(points(runs)),
    ]
    tables.publish(lines, options.output, "moving", quick=options.quick)


if __name__ == "__main__":
    main()
