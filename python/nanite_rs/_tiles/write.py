"""The files of a tileset: a GLB for each tile, and the tree of them as JSON."""

from __future__ import annotations

import json
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from nanite_rs import _core, _export_gltf
from nanite_rs._export_packing import FLOAT_STEPS, POSITION_STEPS, Grid, ImageFormat, Packing
from nanite_rs._export_parts import translation
from nanite_rs._tiles.content import content
from nanite_rs._tiles.images import Smaller, cropped
from nanite_rs._tiles.place import TURN, Globe, Upright
from nanite_rs._tiles.preview import PAGE, page
from nanite_rs._tiles.target import ROOT, SUBTREES
from nanite_rs.exceptions import ArgumentError
from nanite_rs.report import TilesReport

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from nanite_rs._asset import Notes
    from nanite_rs._tiles.place import Place
    from nanite_rs._tiles.target import Target
    from nanite_rs.material import Material
    from nanite_rs.texture import Image

MOST_ROWS: Final = 4096
"""Tiles of a JSON file, at most, unless it holds a single one: larger trees are several files."""
TURN_BACK: Final = TURN.T
"""What takes z up to y up, as glTF has it."""

_SCHEMA: Final = {
    "id": "nanite_rs",
    "classes": {
        "tile": {
            "name": "Tile",
            "properties": {
                "bound": {
                    "description": "No point of the tile is farther from the source, in units of the tiles",
                    "type": "SCALAR",
                    "componentType": "FLOAT64",
                },
                "attribute_error": {
                    "description": "How far normals, colours, UVs and channels are off, as such a length",
                    "type": "SCALAR",
                    "componentType": "FLOAT64",
                },
                "skirt": {
                    "description": "Length of the strips around the tile, in the same units",
                    "type": "SCALAR",
                    "componentType": "FLOAT64",
                },
                "triangles": {
                    "description": "Triangles without those of skirts",
                    "type": "SCALAR",
                    "componentType": "UINT32",
                },
                "level": {
                    "description": "Level of detail, 0 for the coarsest",
                    "type": "SCALAR",
                    "componentType": "UINT32",
                },
            },
        }
    },
}


@dataclass(frozen=True)
class How:
    """How tiles are made."""

    triangles: int
    packing: Packing | None
    images: ImageFormat | None
    skirts: bool
    pixel_error: float
    preview: bool
    workers: int


@dataclass
class Node:
    """A tile as JSON has it."""

    level: int
    origin: NDArray[np.float64]
    bound: float
    attribute_error: float
    skirt: float
    triangles: int = 0
    uri: str | None = None
    lower: NDArray[np.float64] | None = None
    upper: NDArray[np.float64] | None = None
    region: NDArray[np.float64] | None = None
    geometric_error: float = 0.0
    children: list[Node] = field(default_factory=list)

    def close_ranks(self) -> None:
        """Have what empty children have. One stays where all are empty, so that this tile goes."""
        rows = [one for child in self.children for one in ([child] if child.uri else child.children)]
        if self.children and not rows and self.lower is not None:
            empty = Node(self.level + 1, self.origin, 0.0, 0.0, 0.0, lower=self.lower, upper=self.upper)
            empty.region = self.region
            rows = [empty]
        self.children = rows

    def finish(self) -> None:
        """Enclose children, whose errors are no larger. There is a region where all of them have one."""
        self.geometric_error = max([self.bound, *(child.geometric_error for child in self.children)])
        parts = [one for one in (self, *self.children) if one.lower is not None]
        if parts:
            self.lower = np.min([one.lower for one in parts if one.lower is not None], axis=0)
            self.upper = np.max([one.upper for one in parts if one.upper is not None], axis=0)
            regions = [one.region for one in parts if one.region is not None]
            self.region = _around(regions) if len(regions) == len(parts) else None


def _around(regions: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the region around regions: west, south, east, north, lowest, highest."""
    low, high = np.min(regions, axis=0), np.max(regions, axis=0)
    out: NDArray[np.float64] = np.where([True, True, False, False, True, False], low, high)
    return out


def place_of(up: object, crs: object) -> Place:
    """Return where tiles are."""
    if crs is None:
        return Upright("z" if up is None else up)
    if up not in (None, "z"):
        raise ArgumentError("up: reference systems have z up")
    return Globe(crs)


@dataclass(frozen=True)
class Made:
    """What was written of a mesh."""

    roots: list[Node]
    levels: int
    sizes: list[int]
    """Bytes of contents."""
    shared: int
    """Bytes of images that contents refer to."""
    triangles: int


class Writing:
    """The tiles of a mesh on their way into files, in a folder of a target."""

    def __init__(
        self,
        mesh: _core.Mesh,
        materials: tuple[Material, ...],
        place: Place,
        how: How,
        target: Target,
        folder: str,
        notes: Notes,
    ) -> None:
        tiles = _core.Tiles(mesh, how.triangles)
        self._tiles, self._materials, self._place, self._how = tiles, materials, place, how
        self._origin = np.array(mesh.origin)
        self._target, self._folder, self._notes = target, folder, notes
        self._images = Smaller(materials, target)
        self._level, self._parent = tiles.level, tiles.parent
        self._lower, self._upper = tiles.lower, tiles.upper
        count = len(tiles)
        stretch = np.array([place.stretch(self._lower[k], self._upper[k]) for k in range(count)])
        self._stretch = stretch
        self._error = tiles.error * stretch
        self._attribute_error = tiles.attribute_error * stretch
        above = np.where(self._parent >= 0, self._error[self._parent], self._error)
        # What is beside a tile is of its level, or of the one above: this far apart at most.
        self._skirt = (self._error + np.maximum(above, self._error)) if how.skirts else np.zeros(count)
        self._step = self._steps(np.linalg.norm(self._upper - self._lower, axis=1) * stretch)
        if how.skirts:
            self._skirt += 4.0 * self._step

    def _steps(self, size: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return for each tile the step of its positions: one for all of a level, so that they meet."""
        steps = FLOAT_STEPS // 2 if self._how.packing is None else POSITION_STEPS
        out = np.empty(len(size))
        for level in np.unique(self._level):
            own = self._level == level
            # Skirts leave the box, and have four steps themselves.
            most = float((size[own] + 2.0 * self._skirt[own]).max()) / (steps - 16)
            out[own] = 2.0 ** np.ceil(np.log2(most)) if most > 0.0 else 1.0
        return out

    def run(self, progress: Callable[[int, int], object] | None) -> Made:
        """Write all, several at a time; return the roots of their tree."""
        count = len(self._tiles)
        nodes: list[Node] = []
        sizes: list[int] = []
        waiting: deque[Any] = deque()
        with ThreadPoolExecutor(self._how.workers) as threads:
            try:
                for number in range(count):
                    waiting.append(threads.submit(self._write, number))
                    if len(waiting) > 2 * self._how.workers:
                        self._take(waiting, nodes, sizes, count, progress)
                while waiting:
                    self._take(waiting, nodes, sizes, count, progress)
            except BaseException:
                for future in waiting:
                    future.cancel()
                raise
        roots: list[Node] = []
        # Parents come before what replaces them.
        for number, node in enumerate(nodes):
            parent = int(self._parent[number])
            (roots if parent < 0 else nodes[parent].children).append(node)
        for node in reversed(nodes):
            node.close_ranks()
            node.finish()
        triangles = sum(node.triangles for node in nodes)
        roots = [root for root in roots if root.uri or root.children]
        return Made(roots, len(self._tiles.levels), sizes, self._images.size, triangles)

    def _take(
        self,
        waiting: deque[Any],
        nodes: list[Node],
        sizes: list[int],
        count: int,
        progress: Callable[[int, int], object] | None,
    ) -> None:
        node, size = waiting.popleft().result()
        nodes.append(node)
        if size:
            sizes.append(size)
        if progress is not None:
            progress(len(nodes), count)

    def _write(self, number: int) -> tuple[Node, int]:
        """Write a tile; return it with the bytes of its content."""
        error, step, skirt = (float(x[number]) for x in (self._error, self._step, self._skirt))
        piece = self._tiles.piece(number)
        shown = content(piece, self._materials, self._place, self._origin, skirt)
        node = Node(
            level=int(self._level[number]),
            origin=np.zeros(3),
            bound=error,
            attribute_error=float(self._attribute_error[number]),
            skirt=skirt,
        )
        if shown is None:
            return node, 0
        grid = Grid.about(shown.surface.vertices, step)
        bent, made = shown.bent, shown.rounding * float(self._stretch[number])
        node.origin, node.triangles = grid.origin, shown.triangles
        node.bound = float(np.nextafter(error + made + grid.moved + bent, np.inf))
        vertices = shown.surface.vertices
        node.lower, node.upper = vertices.min(axis=0) - step, vertices.max(axis=0) + step
        if shown.geodetic is not None:
            node.region = _region(shown.geodetic, bent + step)
        per_unit = self._how.pixel_error / error if error > 0.0 else None
        surface = cropped(shown.surface, per_unit, self._images)
        name = f"{self._folder}{node.level}/{number}.glb"
        up = "../" * name.count("/")

        def outside(image: Image, data: bytes, ending: str) -> str | None:
            own = self._images.shared(image, data, ending)
            return None if own is None else up + own

        document = _export_gltf.Document(self._notes, name, self._how.packing, self._how.images, outside)
        document.place(document.mesh(surface, grid), TURN_BACK @ translation(-grid.origin))
        data = document.files()[name]
        self._target.write(name, data)
        node.uri = name
        return node, len(data)


def _region(geodetic: NDArray[np.float64], slack: float) -> NDArray[np.float64] | None:
    """Return west, south, east, north, lowest and highest; None across the antimeridian."""
    low, high = geodetic.min(axis=0), geodetic.max(axis=0)
    if high[0] - low[0] > np.pi:
        return None
    angle = slack / 6.3e6
    return np.array(
        [
            low[0] - 2 * angle,
            low[1] - angle,
            high[0] + 2 * angle,
            high[1] + angle,
            low[2] - slack,
            high[2] + slack,
        ]
    )


# -------------------------------------------------------------------------------------------------- JSON


class Json:
    """The tree of a tileset as files of JSON."""

    def __init__(self, target: Target, regions: bool) -> None:
        self._target, self._regions, self._files = target, regions, 0

    def write(self, root: dict[str, Any], error: float) -> None:
        """Write the root."""
        self._target.write(ROOT, _dumped(root, error))

    def row(self, node: Node, pose: NDArray[np.float64]) -> dict[str, Any]:
        """Return a tile in a space that has such a pose; large trees go into files of their own."""
        return self._row(node, pose @ translation(node.origin), _count(node))

    def _row(self, node: Node, pose: NDArray[np.float64], count: int) -> dict[str, Any]:
        children = []
        for child in node.children:
            own = _count(child) if count > MOST_ROWS else 0
            place = translation(child.origin - node.origin)
            if count > MOST_ROWS >= own > 1:
                children.append(self._file(child, place))
            else:
                children.append(self._row(child, place, own))
        return self._fields(node, pose) | self._content(node) | ({"children": children} if children else {})

    def _fields(self, node: Node, pose: NDArray[np.float64]) -> dict[str, Any]:
        fields: dict[str, Any] = {
            "boundingVolume": self.volume(node),
            "geometricError": node.geometric_error,
            "refine": "REPLACE",
        }
        if not np.array_equal(pose, np.eye(4)):
            fields["transform"] = pose.T.reshape(-1).tolist()
        return fields

    def _content(self, node: Node, base: str = "") -> dict[str, Any]:
        if node.uri is None:
            return {}
        properties = {
            "bound": node.bound,
            "attribute_error": node.attribute_error,
            "skirt": node.skirt,
            "triangles": node.triangles,
            "level": node.level,
        }
        return {
            "content": {"uri": base + node.uri},
            "metadata": {"class": "tile", "properties": properties},
        }

    def volume(self, node: Node) -> dict[str, Any]:
        """Return the box, or the region on the globe, of a tile and what replaces it."""
        if self._regions and node.region is not None:
            return {"region": node.region.tolist()}
        if node.lower is None or node.upper is None:
            return {"box": [0.0] * 12}
        center, half = (node.lower + node.upper) / 2.0 - node.origin, (node.upper - node.lower) / 2.0
        half = np.nextafter(half * (1.0 + 1e-12), np.inf)
        return {"box": [*center.tolist(), *np.diag(half).reshape(-1).tolist()]}

    def _file(self, node: Node, pose: NDArray[np.float64]) -> dict[str, Any]:
        """Write a part of the tree as a tileset of its own; return the tile that refers to it."""
        name = f"{SUBTREES}/{self._files}.json"
        self._files += 1
        below = _Below(self._target, self._regions)
        self._target.write(name, _dumped(below.row(node, translation(-node.origin)), node.geometric_error))
        return self._fields(node, pose) | {"content": {"uri": name}}


class _Below(Json):
    """The same in a folder below: contents are found from there."""

    def _content(self, node: Node, base: str = "../") -> dict[str, Any]:
        return super()._content(node, base)


def _count(node: Node) -> int:
    return 1 + sum(_count(child) for child in node.children)


def _dumped(root: dict[str, Any], error: float) -> bytes:
    document = {
        "asset": {"version": "1.1", "generator": "nanite_rs"},
        "schema": _SCHEMA,
        "geometricError": error,
        "root": root,
    }
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode()


def whole(roots: Sequence[Node]) -> Node:
    """Return a node around roots: the one that there is, or an empty one."""
    if len(roots) == 1:
        return roots[0]
    node = Node(0, roots[0].origin if roots else np.zeros(3), 0.0, 0.0, 0.0, children=list(roots))
    node.finish()
    return node


def size_of(node: Node) -> float:
    """Return the length of the diagonal of the box around a node: its error where nothing is shown."""
    if node.lower is None or node.upper is None:
        return 0.0
    return max(float(np.linalg.norm(node.upper - node.lower)), node.geometric_error)


def show(target: Target, how: How) -> None:
    """Write the page, where one is wanted."""
    if how.preview:
        target.write(PAGE, page("3D Tiles", how.pixel_error))


def report(target: Target, made: Sequence[Made]) -> TilesReport:
    """Return what was written."""
    sizes = [size for own in made for size in own.sizes]
    return TilesReport(
        path=target.where,
        tiles=len(sizes),
        levels=max((own.levels for own in made), default=0),
        triangles=sum(own.triangles for own in made),
        bytes=sum(sizes) + sum(own.shared for own in made),
        median_bytes=int(np.median(sizes)) if sizes else 0,
    )
