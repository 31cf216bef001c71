"""Multi-resolution meshes of neuroglancer: read by the words of the format's specification."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import distance

if TYPE_CHECKING:
    from pathlib import Path

DracoPy = pytest.importorskip("DracoPy")


@dataclass
class Fragment:
    lod: int
    place: np.ndarray
    data: bytes


class Segment:
    """A manifest and its fragments."""

    def __init__(self, folder: Path, number: int) -> None:
        self.info = json.loads((folder / "info").read_text())
        raw, data = (folder / f"{number}.index").read_bytes(), (folder / str(number)).read_bytes()
        at = 0

        def take(dtype: str, count: int) -> np.ndarray:
            nonlocal at
            out = np.frombuffer(raw, dtype, count, at)
            at += out.nbytes
            return out

        self.chunk, self.origin = take("<f4", 3).astype(float), take("<f4", 3).astype(float)
        self.lods = int(take("<u4", 1)[0])
        self.scales = take("<f4", self.lods)
        self.offsets = take("<f4", 3 * self.lods).reshape(-1, 3)
        counts = take("<u4", self.lods)
        self.fragments, begin = [], 0
        for lod, count in enumerate(counts.tolist()):
            places = take("<u4", 3 * count).reshape(3, count).T
            for place, size in zip(places, take("<u4", count).tolist(), strict=True):
                self.fragments.append(Fragment(lod, place, data[begin : begin + size]))
                begin += size
        assert at == len(raw)
        assert begin == len(data)

    def surface(self, lod: int) -> tuple[np.ndarray, np.ndarray]:
        """The surface of a level."""
        most = 2 ** self.info["vertex_quantization_bits"] - 1
        points, faces, count = [], [], 0
        for fragment in self.fragments:
            if fragment.lod == lod:
                mesh = DracoPy.decode(fragment.data)
                whole = np.rint(mesh.points)
                assert np.abs(whole - mesh.points).max() < 0.01
                part = fragment.place + whole / most
                points.append(self.origin + self.offsets[lod] + self.chunk * 2.0**lod * part)
                faces.append(mesh.faces.astype(np.int64) + count)
                count += len(whole)
        return np.concatenate(points), np.concatenate(faces)


@pytest.mark.parametrize("bits", [10, 16])
def test_a_segment(bits, tmp_path) -> None:
    vertices, faces = nrs.shapes.displaced_icosphere(faces=40_000)
    mesh = nrs.NaniteMesh.from_arrays(vertices * 0.5 + 3, faces, options=nrs.BuildOptions(quality="fast"))
    errors = mesh.to_neuroglancer(tmp_path / "m", 12, triangles=2_000, quantization_bits=bits, unit=1_000.0)
    found = Segment(tmp_path / "m", 12)
    assert found.info["@type"] == "neuroglancer_multilod_draco"
    assert found.info["vertex_quantization_bits"] == bits
    assert found.lods == len(errors) >= 3
    assert np.allclose(found.scales, errors)
    assert (np.diff(found.scales) > 0.0).all()
    source = (vertices.astype(np.float32) * 0.5 + 3).astype(np.float64) * 1_000.0
    for lod in range(found.lods):
        points, corners = found.surface(lod)
        far = distance.to_surface(distance.samples(points, corners, 3_000), source, faces)
        assert far.max() <= errors[lod]
        # All of it is there.
        back = distance.to_surface(distance.samples(source, faces, 3_000), points, corners)
        assert back.max() <= errors[lod]
    # Coarser levels have fewer, and larger, fragments.
    counts = [sum(fragment.lod == lod for fragment in found.fragments) for lod in range(found.lods)]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] == 1


def test_triangles_stay_in_their_octants_and_fragments_are_sorted(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.torus_knot(faces=30_000))
    mesh.to_neuroglancer(tmp_path / "m", 1, triangles=1_500)
    found = Segment(tmp_path / "m", 1)
    most = 2**16 - 1
    for fragment in found.fragments:
        corners = DracoPy.decode(fragment.data)
        if fragment.lod:
            # Half a step of rounding lies on either side.
            inside = corners.points[corners.faces] - most / 2
            assert ((inside <= 1.0).all(axis=1) | (inside >= -1.0).all(axis=1)).all()
    for lod in range(found.lods):
        places = [fragment.place for fragment in found.fragments if fragment.lod == lod]
        codes = [
            sum((int(v) >> b & 1) << (3 * b + axis) for axis, v in enumerate(place) for b in range(16))
            for place in places
        ]
        assert codes == sorted(set(codes))


def test_several_segments_share_a_folder(tmp_path) -> None:
    mesh = nrs.NaniteMesh.from_arrays(*nrs.shapes.icosphere(faces=1_280))
    for segment in (3, 2**63 + 5):
        mesh.to_neuroglancer(tmp_path / "m", segment, workers=2)
    assert (tmp_path / "m" / "3").read_bytes() == (tmp_path / "m" / str(2**63 + 5)).read_bytes()
    with pytest.raises(nrs.FileError, match="holds other meshes"):
        mesh.to_neuroglancer(tmp_path / "m", 4, quantization_bits=10)


def test_flat_meshes_and_mistakes(tmp_path) -> None:
    flat = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]], np.float32)
    mesh = nrs.NaniteMesh.from_arrays(flat, [[0, 1, 2]])
    assert len(mesh.to_neuroglancer(tmp_path / "m", 1)) == 1
    assert len(Segment(tmp_path / "m", 1).surface(0)[1]) == 1
    for given, named in [
        ({"segment": -1}, "segment"),
        ({"quantization_bits": 12}, "quantization_bits"),
        ({"unit": 0.0}, "unit"),
        ({"triangles": 3}, "triangles"),
    ]:
        with pytest.raises(nrs.ArgumentError, match=named):
            mesh.to_neuroglancer(tmp_path / "m", **({"segment": 1} | given))
