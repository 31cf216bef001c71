"""Fixtures and habits of the Python tests.

Real meshes are read from `../shared/data` (or `$NANITE_SHARED_DATA`); a test that needs one which is absent
is skipped, and `make test` counts it. Skips are also written to `$NANITE_SKIPS` as `test<TAB>reason`.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

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

_skips: dict[str, str] = {}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.stem.removeprefix("test_") in SLOW:
            item.add_marker(pytest.mark.slow)


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
