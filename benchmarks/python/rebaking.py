"""Levels with images of their own against those that keep the seams: roots, times, FLIP where a level is used.

python -m benchmarks.python.rebaking
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np

import nanite_rs as nrs

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from oracles import data  # noqa: E402
from oracles.captures import capture  # noqa: E402
from test_rebaking import FOSSIL, shots, stripes  # noqa: E402

SIZE = 2048


def sources() -> dict[str, dict[str, object]]:
    out = {}
    for charts in (2_025, 2_601):
        made = capture(120_000, charts, seed=charts)
        image = nrs.Texture(made.painted(SIZE, stripes))
        look = nrs.Material(base_color=(1, 1, 1), metallic=0.0, base_color_texture=image)
        arrays = made.arrays()
        out[f"stone, {charts:,} charts"] = arrays | {"materials": look}
    # As of four images: those of the quarters of the atlas.
    quarter = arrays["uvs"][arrays["faces"][:, 0]] >= 0.5
    several = {"materials": [look] * 4, "face_materials": quarter @ np.array([1, 2], np.int32)}
    out["the same of four materials"] = arrays | several
    return out


def measure(name: str, build) -> None:
    import xatlas

    spent = 0.0
    generate = xatlas.Atlas.generate

    def timed(self, *arguments, **more):
        nonlocal spent
        start = time.perf_counter()
        generate(self, *arguments, **more)
        spent += time.perf_counter() - start

    start = time.perf_counter()
    plain = build(nrs.BuildOptions())
    before = time.perf_counter() - start
    with mock.patch.object(xatlas.Atlas, "generate", timed):
        start = time.perf_counter()
        mesh = build(nrs.BuildOptions(rebake="auto", texture_size=SIZE))
        after = time.perf_counter() - start
    mesh.check()
    roots = [len(one.cut(error=np.inf)) for one in (plain, mesh)]
    print(
        f"{name}: root {roots[0]} and {roots[1]} triangles; {before:.1f} and {after:.1f} s, xatlas {spent:.1f} s"
    )
    full = mesh.cut(error=0.0)
    last = 0.0
    for part in mesh.report.rebaked:
        cut = mesh.cut(target_faces=part.triangles)
        pixel = max(cut.error, cut.attribute_error)
        if pixel < 1.3 * last:
            continue
        last = pixel
        reference = shots(full, mesh.bounds, pixel)
        ours = nrs.compare(shots(cut, mesh.bounds, pixel), reference).flip
        outlines = (shots(one, mesh.bounds, pixel, outline=True) for one in (cut, full))
        outline = nrs.compare(*outlines).flip
        other = plain.cut(target_faces=part.triangles)
        theirs = nrs.compare(shots(other, mesh.bounds, pixel), reference).flip
        print(
            f"  {len(cut):6,} triangles, error {cut.error:.4f}, {len(reference)} pixels: FLIP {ours:.4f}, "
            f"of outlines alone {outline:.4f}; "
            f"with seams {len(other):,} triangles, error {other.error:.4f}: {theirs:.4f}"
        )


def main() -> None:
    for name, arrays in sources().items():
        measure(name, lambda options, arrays=arrays: nrs.NaniteMesh.from_arrays(**arrays, options=options))
    shared = data.shared()
    if shared is None:
        print("the scan is not there")
        return
    path = shared.joinpath(*FOSSIL)
    measure("fossil", lambda options: nrs.NaniteMesh.from_file(path, options=options))


if __name__ == "__main__":
    main()
