"""Options and materials are checked when they are made, by the ranges that Rust refuses by when they are used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import nanite_rs as nrs

V, F = nrs.shapes.icosphere(faces=80)


@pytest.fixture(scope="module")
def mesh() -> nrs.NaniteMesh:
    return nrs.NaniteMesh.from_arrays(V, F, progress=False)


def build(options: nrs.BuildOptions) -> None:
    nrs.NaniteMesh.from_arrays(V, F, options=options, progress=False)


def unchecked(made, name: str, value: object):
    """The same with a value that its own checks did not see."""
    made = replace(made)
    object.__setattr__(made, name, value)
    return made


WHOLE = {"cluster_triangles": (16, 128), "cluster_vertices": (32, 255), "group_clusters": (4, 24)}
WEIGHTS = ("normal_weight", "color_weight", "uv_weight", "channel_weight")
CHOICES = ("clusterizer", "partition", "quality", "error")


@pytest.mark.parametrize("name", WHOLE)
def test_whole_numbers_of_options(name) -> None:
    for value in WHOLE[name]:
        options = nrs.BuildOptions(**{name: np.uint8(value)})
        assert type(getattr(options, name)) is int
        build(options)
    least, most = WHOLE[name]
    for value in (least - 1, most + 1):
        with pytest.raises(nrs.ArgumentError) as here:
            nrs.BuildOptions(**{name: value})
        with pytest.raises(nrs.ArgumentError) as there:
            build(unchecked(nrs.BuildOptions(), name, value))
        assert (
            str(here.value) == str(there.value) == f"{name}: must be between {least} and {most}, not {value}"
        )
    for value in (64.0, "64", True, None):
        with pytest.raises(nrs.DtypeError, match=f"{name}: expected an integer"):
            nrs.BuildOptions(**{name: value})


@pytest.mark.parametrize("name", WEIGHTS)
def test_weights_of_options(name) -> None:
    for value in (0, 1e30, np.float32(0.5)):
        build(nrs.BuildOptions(**{name: value}))
    for value in (-1.0, float("nan"), float("inf"), 1e39):
        with pytest.raises(nrs.ArgumentError, match=f"{name}: must be finite and not negative"):
            nrs.BuildOptions(**{name: value})
        with pytest.raises(nrs.ArgumentError, match=f"{name}: must be finite and not negative"):
            build(unchecked(nrs.BuildOptions(), name, value))
    with pytest.raises(nrs.DtypeError, match=f"{name}: expected a number, not str"):
        nrs.BuildOptions(**{name: "1"})


@pytest.mark.parametrize("name", CHOICES)
def test_choices_of_options(name) -> None:
    with pytest.raises(nrs.ArgumentError) as here:
        nrs.BuildOptions(**{name: "medianbound"})
    with pytest.raises(nrs.ArgumentError) as there:
        build(unchecked(nrs.BuildOptions(), name, "medianbound"))
    assert str(here.value) == str(there.value)
    for quoted in str(here.value).split(", not ")[0].split('"')[1::2]:
        build(nrs.BuildOptions(**{name: quoted}))
    with pytest.raises(nrs.ArgumentError, match=f"{name}: .*not 3"):
        nrs.BuildOptions(**{name: 3})


def test_threads_and_truths_of_options() -> None:
    with pytest.raises(nrs.ArgumentError, match="threads: must be between 0 and 1024, not -1"):
        nrs.BuildOptions(threads=-1)
    for name in ("preserve_area", "face_ids"):
        assert getattr(nrs.BuildOptions(**{name: np.True_}), name) is True
        with pytest.raises(nrs.DtypeError, match=f"{name}: expected True or False, not str"):
            nrs.BuildOptions(**{name: "no"})


def test_every_option_is_checked() -> None:
    names = {*WHOLE, *WEIGHTS, *CHOICES, "threads", "preserve_area", "face_ids", "crease_angle"}
    # Those of images are in test_rebaking: the core has none.
    assert names | {"rebake", "texture_size"} == set(vars(nrs.BuildOptions()))


UNIT = "must be between 0 and 1"
LOOKS = {
    "base_color": ([(0, 0, 0), (1, 1, 1, 0.0)], [(1.1, 0, 0), (0, -0.1, 0), (0, 0, np.nan)], UNIT),
    "metallic": ([0, 1.0], [-0.1, 1.1, np.nan], UNIT),
    "roughness": ([0, np.float32(1.0)], [-0.1, 1.1, np.inf], UNIT),
    "occlusion_strength": ([0, 1], [-0.1, 1.1, np.nan], UNIT),
    "emissive": ([(0, 0, 0), (1e3, 0, 0)], [(-1, 0, 0), (0, np.inf, 0)], "must be finite and not negative"),
    "normal_scale": ([-2.0, 1e3], [np.nan, 1e39], "must be finite"),
    "alpha_cutoff": ([-1.0, 2.0], [np.inf], "must be finite"),
}


@pytest.mark.parametrize("name", LOOKS)
def test_numbers_of_materials(name, mesh) -> None:
    good, bad, message = LOOKS[name]
    scene = nrs.Scene()
    for value in good:
        scene.add(mesh, material=nrs.Material(**{name: value, "alpha_mode": "mask"}))
    for value in bad:
        with pytest.raises(nrs.ArgumentError, match=f"{name}: {message}"):
            nrs.Material(**{name: value})
        look = unchecked(nrs.Material(alpha_mode="mask"), name, value)
        with pytest.raises(nrs.ArgumentError, match=f"{name}: {message}"):
            scene.add(mesh, material=look)
    with pytest.raises(nrs.DtypeError, match=f"{name}: expected"):
        nrs.Material(**{name: "red"})


def test_alpha_and_modes_of_materials() -> None:
    with pytest.raises(nrs.ArgumentError, match=r"alpha: must be between 0 and 1, not 1\.5"):
        nrs.Material(base_color=(0, 0, 0, 1.5))
    with pytest.raises(nrs.ArgumentError, match=r"base_color: .*divide colours of 0 to 255 by 255"):
        nrs.Material(base_color=(255, 0, 0))
    with pytest.raises(nrs.ArgumentError, match=r'alpha_mode: .*not "masked"; did you mean "mask"\?'):
        nrs.Material(alpha_mode="masked")
    # What single precision rounds to 1 is 1.
    assert nrs.Material(metallic=1.0 + 1e-9).metallic == pytest.approx(1.0)
