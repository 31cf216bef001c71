"""Surfaces compared and counted by position alone: what anyone can verify without trusting the maker."""

from __future__ import annotations

import numpy as np


def _rows(array: np.ndarray) -> np.ndarray:
    """Rows as opaque keys."""
    array = np.ascontiguousarray(array)
    return array.view(np.dtype((np.void, array.dtype.itemsize * array.shape[1]))).ravel()


def position_ids(vertices: np.ndarray) -> np.ndarray:
    """The smallest index with the same position, for every vertex. −0 equals +0, nothing else is merged."""
    clean = np.asarray(vertices, np.float64) + 0.0
    bits = np.ascontiguousarray(clean).view(np.uint64)
    odd = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    mixed = bits * odd
    keys = (mixed ^ (mixed >> np.uint64(29))).sum(axis=1, dtype=np.uint64)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    if not np.array_equal(clean[first[inverse]], clean):  # two positions with one key: compare rows instead
        _, first, inverse = np.unique(_rows(clean), return_index=True, return_inverse=True)
    return first[inverse.ravel()]


def by_position(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces in terms of positions, degenerate ones dropped."""
    f = position_ids(vertices)[np.asarray(faces, np.int64)]
    keep = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    return f[keep]


def without_duplicates(faces: np.ndarray) -> np.ndarray:
    """Faces that are no turned copy of another; those of opposite orientation are different faces."""
    start = np.argmin(faces, axis=1)
    turned = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    return np.unique(turned, axis=0)


def half_edges(faces: np.ndarray) -> np.ndarray:
    """(3M, 2) directed edges."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _edge_keys(edges: np.ndarray) -> np.ndarray:
    return (edges[:, 0].astype(np.int64) << 32) | edges[:, 1].astype(np.int64)


def unbalanced_edges(faces: np.ndarray) -> int:
    """Edges with unequal numbers of halves in the two directions: 0 for a closed, oriented surface."""
    edges = half_edges(faces)
    swapped = edges[:, 0] > edges[:, 1]
    undirected = np.sort(edges, axis=1)
    _, inverse = np.unique(_edge_keys(undirected), return_inverse=True)
    balance = np.zeros(inverse.max() + 1 if len(inverse) else 0, np.int64)
    np.add.at(balance, inverse, np.where(swapped, -1, 1))
    return int(np.count_nonzero(balance))


def edge_valence(faces: np.ndarray) -> tuple[int, int, int]:
    """Numbers of edges with one, two and more faces."""
    _, counts = np.unique(_edge_keys(np.sort(half_edges(faces), axis=1)), return_counts=True)
    return int((counts == 1).sum()), int((counts == 2).sum()), int((counts > 2).sum())


def is_closed(faces: np.ndarray) -> bool:
    """Every edge has exactly two halves, in opposite directions."""
    one, _, more = edge_valence(faces)
    return one == 0 and more == 0 and unbalanced_edges(faces) == 0


def border_half_edges(faces: np.ndarray) -> np.ndarray:
    """Directed edges without their opposite, sorted keys."""
    edges = half_edges(faces)
    keys = _edge_keys(edges)
    return np.sort(keys[~np.isin(keys, _edge_keys(edges[:, ::-1]))])


def euler_characteristic(faces: np.ndarray) -> int:
    """V − E + F of the used vertices."""
    edges = np.unique(_edge_keys(np.sort(half_edges(faces), axis=1)))
    return int(len(np.unique(faces)) - len(edges) + len(faces))


def components(faces: np.ndarray) -> int:
    """Number of components connected through vertices."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    used, f = np.unique(faces, return_inverse=True)
    f = f.reshape(-1, 3)
    n = len(used)
    links = sparse.coo_matrix(
        (np.ones(2 * len(f)), (np.r_[f[:, 0], f[:, 1]], np.r_[f[:, 1], f[:, 2]])), (n, n)
    )
    return int(connected_components(links, directed=False)[0])


def face_keys(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """One opaque key per non-degenerate face: its three positions, turned so that the smallest comes first.

    Equal keys are the same oriented triangle in space, whatever the numbering of vertices and faces.
    """
    v = np.asarray(vertices, np.float64) + 0.0
    f = by_position(v, faces)
    # A total order of positions that does not depend on numbering.
    used = np.unique(f)
    rank = np.zeros(len(v), np.int64)
    rank[used] = np.unique(v[used], axis=0, return_inverse=True)[1].ravel()
    r = rank[f]
    start = np.argmin(r, axis=1)
    order = (start[:, None] + np.arange(3)) % 3
    return _rows(v[np.take_along_axis(f, order, axis=1)].reshape(-1, 9))


def surface_difference(a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> tuple[int, int]:
    """Numbers of oriented triangles that only ``a`` and only ``b`` have; repeated triangles count once."""
    ka, kb = np.unique(face_keys(*a)), np.unique(face_keys(*b))
    return int((~np.isin(ka, kb)).sum()), int((~np.isin(kb, ka)).sum())


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Enclosed volume of a closed surface."""
    v = np.asarray(vertices, np.float64)
    t = (v - v.mean(axis=0))[faces]
    return float(np.einsum("ij,ij->", t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Total area."""
    t = np.asarray(vertices, np.float64)[faces]
    return float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() / 2)


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Angle-weighted unit normals, shared by all vertices at one position; float32."""
    v = np.asarray(vertices, np.float64)
    ids = position_ids(v)
    f = ids[np.asarray(faces, np.int64)]
    t = v[f]
    normal = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    total = np.zeros_like(v)
    for k in range(3):
        a, b = t[:, (k + 1) % 3] - t[:, k], t[:, (k + 2) % 3] - t[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b))
        np.add.at(total, f[:, k], normal * angle[:, None])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    total = np.where(length > 0, total / np.where(length > 0, length, 1), [0.0, 0.0, 1.0])
    return total[ids].astype(np.float32)
