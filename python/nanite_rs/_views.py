"""The views of a viewer: the arrays of a frame that each needs, and the picture made from them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, get_args

import numpy as np

from nanite_rs import _paint

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from nanite_rs._frozen import Frozen, Ids, ViewFrame
    from nanite_rs._picking import ClusterTables, Pick
    from nanite_rs.frame import OutputName
    from nanite_rs.scene import Scene

LiveViewName: TypeAlias = Literal[
    "shaded",
    "wireframe",
    "normals",
    "triangles",
    "clusters",
    "groups",
    "levels",
    "pages",
    "instances",
    "sizes",
    "rasterizers",
    "overdraw",
    "shadow_pages",
    "shadow_levels",
    "shadow_kept",
    "shadow_cut",
]

_SHADOWS: Final = ("shadow_pages", "shadow_levels", "shadow_kept", "shadow_cut")
SHADOW_VIEWS: Final[tuple[LiveViewName, ...]] = _SHADOWS
"""What a `Viewer` that draws shadows can show besides `VIEWS`."""
VIEWS: Final[tuple[LiveViewName, ...]] = tuple(
    name for name in get_args(LiveViewName) if name not in SHADOW_VIEWS
)
"""What a `Viewer` can show."""

_OF_FRAMES: Final = (
    "wireframe",
    "triangles",
    "clusters",
    "groups",
    "levels",
    "rasterizers",
    "overdraw",
    *_SHADOWS,
)
"""Views that frames have themselves."""

_OUTPUTS: Final = ("triangles", "clusters", "groups", "levels", "overdraw")
"""Those that a device makes with the frame."""

_OF_DRAWING: Final = ("wireframe", "rasterizers", "overdraw", *_SHADOWS)
"""Those of how the frame itself was drawn: they show nothing of a frozen cut."""

_UNSEEN: Final = np.array((28.0, 40.0, 64.0), np.float32)
"""What is added to the grey of clusters that a frozen camera did not see: a dark blue."""

IDS: Final[tuple[OutputName, ...]] = ("instance_id", "cluster_id", "triangle_id")
_YELLOW: Final = (255, 224, 30)
_DARK: Final = (25, 25, 30)


def outputs_of(name: LiveViewName, *, frozen: bool, selected: bool) -> list[OutputName]:
    """What the picture of a view is made of, which a GPU makes with the frame."""
    made: list[OutputName] = ["color", "depth"] if name == "shaded" else ["depth"]
    if name in _OUTPUTS and (not frozen or name in _OF_DRAWING):
        made.append(name)
    elif name in _OF_DRAWING:
        pass  # made from what comes with any frame
    elif name != "shaded" or frozen or selected:
        made += IDS
    return made


def painted(name: LiveViewName, shown: ViewFrame, scene: Scene, tables: ClusterTables) -> NDArray[np.uint8]:
    """A frame as a view shows it."""
    frame = shown.frame
    if name == "shaded":
        return frame.color.copy()
    covered = frame.depth > 0.0
    picture = np.empty((*covered.shape, 3), np.uint8)
    picture[:] = np.rint(np.array(scene.bg_color) * 255.0)
    if name in _OF_DRAWING or (name in _OF_FRAMES and shown.frozen is None):
        picture[covered] = frame.view(name)[covered]
    elif name == "normals":
        picture[covered] = np.rint(frame.normal[covered] * 127.5 + 127.5)
    else:
        facing = frame.normal[covered] @ shown.view.pose[:3, 2].astype(np.float32)
        picture[covered] = _paint.faced(_colors(name, shown, scene, tables, covered), facing)
    return picture


def _colors(
    name: str, shown: ViewFrame, scene: Scene, tables: ClusterTables, covered: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Colours of covered pixels by what they show, (N, 3)."""
    instance = shown.ids.instance[covered].view(np.uint32)
    cluster = shown.ids.cluster[covered]
    triangle = shown.ids.triangle[covered].view(np.uint32)
    if name == "sizes":
        return _paint.sizes(instance, cluster, triangle)
    if name == "triangles":
        return _paint.hues(instance, cluster, triangle)
    if name == "clusters":
        return _paint.hues(instance, cluster, _paint.CLUSTERS)
    if name == "pages":
        return _paint.hues(instance, cluster >> np.uint32(_paint.PAGE_BITS), _paint.PAGES)
    if name == "instances":
        return _paint.hues(instance, instance, _paint.INSTANCES)
    # The remaining views are levels and groups of a frozen cut. Points and lines have row −1.
    frozen, rows = shown.cut, shown.rows[covered]
    if name == "levels":
        return _paint.levels(np.append(frozen.level, np.uint8(0)))[rows]
    return _paint.hues(instance, _groups(frozen, scene, tables)[rows], _paint.GROUPS)


def _groups(frozen: Frozen, scene: Scene, tables: ClusterTables) -> NDArray[np.uint32]:
    """The group of each cluster of a frozen cut; that of roots is 0xFFFFFFFF."""
    # The last is for what is not of it: points and lines.
    groups = np.zeros(len(frozen.cluster) + 1, np.uint32)
    for node in scene.instances:
        own = frozen.instance == node.instance_id
        if own.any():
            table = tables.of(node)
            rows = np.searchsorted(table["id"], frozen.cluster[own])
            groups[:-1][own] = table["group"][rows].astype(np.uint32)
    return groups


def draw_frozen(picture: NDArray[np.uint8], shown: ViewFrame, center: NDArray[np.float64]) -> None:
    """Draw clusters that the frozen camera did not see in bluish grey, and the frustum of that camera."""
    unseen = np.append(~shown.cut.seen, False)[shown.rows]
    grey = picture[unseen].astype(np.float32).mean(axis=-1, keepdims=True)
    picture[unseen] = (0.45 * grey + _UNSEEN).astype(np.uint8)
    far = 1.5 * float(np.linalg.norm(center - shown.cut.view.pose[:3, 3]))
    _draw_frustum(picture, shown, shown.cut.outline(far))


def _draw_frustum(picture: NDArray[np.uint8], shown: ViewFrame, edges: NDArray[np.float64]) -> None:
    """Draw the edges of a frustum, where nothing is before them."""
    view, (height, width) = shown.view, picture.shape[:2]
    t = np.linspace(0.0, 1.0, 2 * (width + height))[:, None]
    points = np.concatenate([a + (b - a) * t for a, b in edges])
    local = (points - view.pose[:3, 3]) @ view.pose[:3, :3]
    away = -local[:, 2]
    before = away > view.camera.znear
    focal = height / (2.0 * math.tan(view.camera.yfov / 2.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = width / 2.0 + focal * local[:, 0] / away, height / 2.0 - focal * local[:, 1] / away
    inside = before & (x >= 0.0) & (x < width - 1) & (y >= 0.0) & (y < height - 1)
    x, y, away = x[inside].astype(np.intp), y[inside].astype(np.intp), away[inside]
    depth = shown.frame.depth[y, x]
    free = (depth == 0.0) | (away < depth)
    for dx, dy in ((0, 0), (1, 0), (0, 1)):
        picture[y[free] + dy, x[free] + dx] = (214, 69, 38)


def tint(picture: NDArray[np.uint8], ids: Ids, picked: Pick) -> int:
    """Tint a cluster, more so its triangle, draw a line around it, and return how many pixels it has."""
    cluster = (ids.instance == picked.instance_id) & (ids.cluster == picked.cluster_id)
    triangle = cluster & (ids.triangle == picked.triangle_id)
    inner = _shrunk(cluster)
    # One of the two lines is seen on any colour.
    edges = (cluster & ~inner, _YELLOW, 1.0), (inner & ~_shrunk(inner), _DARK, 1.0)
    for where, color, part in ((cluster, _YELLOW, 0.35), (triangle, _YELLOW, 0.8), *edges):
        mixed = picture[where] * (1.0 - part) + np.array(color) * part
        picture[where] = mixed.astype(np.uint8)
    return int(cluster.sum())


def _shrunk(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask without the pixels at its rim, which the rim of the picture is not."""
    padded = np.pad(mask, 1, mode="edge")
    return mask & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
