"""Full detail (error=0, pixel_error=0) is the source surface exactly: oriented triangles by position."""

import numpy as np
import pytest

import nanite_rs as nrs
from oracles import camera, subjects, topology

NAMES = [*subjects.GENERATED, "bunny", "armadillo", "lucy", "dragon", "horse", "turbine", "mountain"]


@pytest.mark.parametrize("name", NAMES)
def test_error_zero_is_the_source(name: str) -> None:
    source = subjects.subject(name)
    mesh = subjects.built(name)
    cut = mesh.cut(error=0.0)
    assert topology.surface_difference((source.vertices, source.faces), (cut.vertices, cut.faces)) == (0, 0)
    report = mesh.report
    assert len(cut.faces) == len(source.faces) - report.degenerate_faces - report.duplicate_faces
    assert cut.error == 0.0
    assert mesh.cut(target_reduction=0.0).faces.shape == cut.faces.shape


@pytest.mark.parametrize("name", [*subjects.GENERATED, "bunny", "horse"])
def test_pixel_error_zero_is_the_source(name: str) -> None:
    source = subjects.subject(name)
    mesh = subjects.built(name)
    view = camera.framing(source.used, (0.3, 0.5, 1.0))
    far = view.pose.copy()
    far[:3, 3] = source.center + 1000 * source.diagonal * view.pose[:3, 2]
    for pose in (view.pose, far):
        cut = mesh.cut(
            camera=nrs.PerspectiveCamera(yfov=view.yfov, znear=view.znear),
            pose=pose,
            viewport=(view.width, view.height),
            pixel_error=0.0,
        )
        assert topology.surface_difference((source.vertices, source.faces), (cut.vertices, cut.faces)) == (
            0,
            0,
        )


@pytest.mark.parametrize("name", ["cube", "plane", "part", "bunny"])
def test_face_ids_name_the_source_faces(name: str) -> None:
    source = subjects.subject(name)
    mesh = subjects.built(name, face_ids=True)
    cut, ids = mesh.cut(error=0.0), mesh.source_face_ids
    assert ids.shape == (len(cut.faces),)
    assert len(np.unique(ids)) == len(ids)
    assert subjects.built(name).source_face_ids is None
    given = topology.face_keys(source.vertices, source.faces[ids])
    np.testing.assert_array_equal(given, topology.face_keys(cut.vertices, cut.faces))
