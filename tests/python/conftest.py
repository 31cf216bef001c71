"""Fixtures and habits of the Python tests.

Real meshes are read from `../shared/data` (or `$NANITE_SHARED_DATA`); a test that needs one which is absent
is skipped, and `make test` counts it. Skips are also written to `$NANITE_SKIPS` as `test<TAB>reason`.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
os.environ.setdefault("MPLBACKEND", "agg")

SOAK = bool(os.environ.get("NANITE_SOAK"))

#: Files whose tests take more than half a minute together, or run other programs: `make test-fast` leaves them out.
SLOW = (
    *(
        "arrays",
        "assets",
        "bounds",
        "browser",
        "budgets",
        "build_many",
        "cli",
        "content",
        "depth_only",
        "docs",
        "foliage",
        "images",
    ),
    *(
        "kill",
        "nasty",
        "notebooks",
        "partition",
        "processes",
        "report",
        "samples",
        "streaming",
        "stress",
        "stubs",
    ),
    *("stuck", "viewer", "visibility", "zoo"),
)

#: Cases that take long and rarely find what others of their test do not: `make soak` and `pytest --all-cases` run
#: them, elsewhere pytest counts them as deselected. By file and test, words in the ids of the cases: the empty one
#: is in all of them. A star stands for all tests of a file, which share what takes long.
SOAKED = {
    "assets": {
        "*": ("lamborghini", "zdm2_level", "ToyCar", "dutch_ship"),
    },
    "bounds": {
        "test_bounds_of_cuts_are_never_exceeded": (
            "zdm2_level",
            "stanford_dragon",
            "turbine",
            "counter_unitsmm",
            "voron_hubbed_gear",
            "voron_thread",
            "smithsonian_fossil",
            "lucy",
        ),
        "test_bounds_of_groups_are_never_exceeded": (
            "zdm2_level",
            "occlusion_room",
            "counter_unitsmm",
            "voron_hubbed_gear",
            "voron_a_drive",
            "turbine",
            "voron_thread",
            "japanese_bridge",
        ),
    },
    "budgets": {
        "test_budgets_are_met_and_never_exceeded": ("smithsonian_fossil",),
        "test_finished_cuts_open_and_join_nothing": (
            "sphere-fast",
            "knot-best",
            "bunny_full-best",
            "terrain-fast",
        ),
        "test_the_mean_error_lies_between_those_beside": ("best-quadric", "fast-bound"),
    },
    "build_file": {
        "test_arrays_with_attributes_are_one_source": ("1048576-lazy", "4 GiB-dask", "4 GiB-numpy"),
        "test_ply_is_read_in_pieces": ("float32-<", "float64->"),
    },
    "content": {
        "test_textures_stay_in_place": ("chess", "ToyCar"),
    },
    "cuts_elsewhere": {
        "test_a_tenth": (
            "AlphaBlend",
            "FlightHelmet",
            "MultiUV",
            "VertexColor",
            "chess",
            "house",
            "scene",
            "shaderball",
        ),
    },
    "decimate": {
        "test_is_nearer_than_fast_simplification": ("turbine", "armadillo"),
    },
    "foliage": {
        "test_a_generated_tree_covers_what_it_did": ("fast",),
        "test_real_foliage_covers_what_it_did": (
            "scatter_tree-fast",
            "GlassVaseFlowers-fast",
            "pine_tree-best",
        ),
    },
    "full_detail": {
        "test_error_zero_is_the_source": ("dragon", "turbine"),
    },
    "images": {
        "*": ("gpu-fine knot", "gpu-dragon", "gpu-bunny"),
    },
    "nasty": {
        "test_nasty_and_cad_arrays_keep_their_surface": ("generic_twin", "zdm2_level"),
        "test_nasty_and_cad_files": ("zdm2_level", "generic_twin"),
    },
    "rebaking": {
        "test_captures_of_thousands_of_charts": ("",),
    },
    "shadows": {
        "test_rays_and_shadows_agree_but_for_a_band_about_edges": ("scan-0.25", "ball-1.0"),
    },
    "soft_shadows": {
        "test_many_layers_and_large_lights_are_near_it": ("",),
    },
    "stress": {
        "test_extremes_are_built_with_errors_that_hold": ("1e4-best-bound",),
        "test_units_place_direction_and_order_matter_little": (
            "best-quadric",
            "knot-fast",
            "foliage-fast-quadric",
        ),
    },
    "stuck": {
        "test_real_meshes_have_a_root_and_stay_closed": (
            "smithsonian_fossil",
            "zdm2_level-best",
            "lamborghini_gt3-best",
            "chess_board-best",
            "ToyCar-best",
            "dutch_ship_medium_1k-best",
            "stanford_dragon_res2-best",
            "cycloidal-best",
        ),
    },
    "visibility": {
        "test_pixels_show_the_face_the_ray_hits": ("dragon", "turbine"),
    },
}

_skips: dict[str, str] = {}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--all-cases", action="store_true", help="run the cases, too, that are left to make soak"
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    all_cases = SOAK or config.getoption("--all-cases")
    kept, soaked = [], []
    for item in items:
        file = item.path.stem.removeprefix("test_")
        if file in SLOW:
            item.add_marker(pytest.mark.slow)
        name, _, case = item.name.partition("[")
        of_file = SOAKED.get(file, {})
        words = of_file.get(name, of_file.get("*", ()))
        is_soaked = not all_cases and any(word in case for word in words)
        (soaked if is_soaked else kept).append(item)
    config.hook.pytest_deselected(items=soaked)
    items[:] = kept


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.skipped and not hasattr(report, "wasxfail"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        _skips[report.nodeid] = reason.removeprefix("Skipped: ")


def pytest_collectreport(report: pytest.CollectReport) -> None:
    if report.skipped:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        _skips[report.nodeid] = reason.removeprefix("Skipped: ")


def pytest_sessionfinish() -> None:
    target = os.environ.get("NANITE_SKIPS")
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if target and worker:
        # Whoever collects the reports of workers does not hear of modules that they skipped.
        target = target.removesuffix("-skips.txt") + f"-{worker}-skips.txt"
    if target:
        lines = (f"{test}\t{' '.join(reason.split())}\n" for test, reason in _skips.items())
        Path(target).write_text("".join(lines))


@pytest.fixture(scope="session")
def soak() -> bool:
    """True under `make soak`: property tests then run at full length."""
    return SOAK


@pytest.fixture(scope="module", params=("cpu", "gpu"))
def backend(request: pytest.FixtureRequest) -> str:
    """Each backend in turn; one that is not there is skipped, with the reason."""
    import nanite_rs as nrs

    try:
        nrs.Renderer(8, 8, backend=request.param).close()
    except nrs.BackendError as error:
        pytest.skip(str(error))
    return request.param


@pytest.fixture
def heed() -> Iterator[None]:
    """In the background of a shell SIGINT is ignored, and children inherit that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
