"""Tilesets as others read them: JSON, transforms one after the other, and contents turned so that z is up."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nanite_rs._flatten import flattened
from nanite_rs.io import read_asset

TURN = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass
class Tile:
    """A tile with what is below it."""

    row: dict[str, Any]
    pose: np.ndarray
    file: Path | None
    children: list[Tile] = field(default_factory=list)

    @property
    def error(self) -> float:
        return self.row["geometricError"]

    @property
    def properties(self) -> dict[str, Any]:
        return self.row["metadata"]["properties"]

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices where they are, float64, and faces."""
        source = self.source()
        vertices = source.vertices.astype(np.float64) @ TURN[:3, :3].T
        return vertices @ self.pose[:3, :3].T + self.pose[:3, 3], np.asarray(source.faces, np.int64)

    def source(self) -> Any:
        return flattened(read_asset(str(self.file)))

    def corners(self) -> np.ndarray:
        """The eight corners of its box."""
        box = np.array(self.row["boundingVolume"]["box"])
        signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
        points = box[:3] + signs @ box[3:].reshape(3, 3)
        return points @ self.pose[:3, :3].T + self.pose[:3, 3]


def opened(path: str | Path) -> Tile:
    """The root; tilesets within it are opened, too."""
    path = Path(path)
    document = json.loads(path.read_text())
    assert document["asset"]["version"] == "1.1"
    return _tile(document["root"], np.eye(4), path.parent)


def _tile(row: dict[str, Any], above: np.ndarray, folder: Path) -> Tile:
    pose = above @ np.array(row.get("transform", np.eye(4).reshape(-1))).reshape(4, 4).T
    uri = row.get("content", {}).get("uri")
    file = None if uri is None else folder / uri
    if file is not None and file.suffix == ".json":
        document = json.loads(file.read_text())
        below = _tile(document["root"], pose, file.parent)
        assert document["geometricError"] == row["geometricError"] == below.error
        return below
    return Tile(row, pose, file, [_tile(child, pose, folder) for child in row.get("children", [])])


def every(tile: Tile) -> list[Tile]:
    """A tile and all below it."""
    return [tile, *(one for child in tile.children for one in every(child))]


def front(tile: Tile, error: float) -> list[Tile]:
    """The tiles that stand where errors up to this are allowed."""
    if tile.error <= error or not tile.children:
        return [tile]
    return [one for child in tile.children for one in front(child, error)]
