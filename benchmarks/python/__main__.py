"""Runs the Python benchmarks: Markdown and JSON into ``benchmarks/results``, a page into ``target/report``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from . import report, tables

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python", description=__doc__)
    parser.add_argument(
        "--only",
        nargs="+",
        choices=report.BENCHMARKS,
        default=report.DEFAULT,
        help="which to run; gpu, which needs a device, only when asked for",
    )
    parser.add_argument(
        "--quick", action="store_true", help="smaller meshes: to try the benchmarks, not to quote"
    )
    parser.add_argument("--name", default="python", help="end of the name of the results (%(default)s)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    parser.add_argument(
        "--report", type=Path, default=report.REPORT, help="folder for the page (%(default)s)"
    )
    options = parser.parse_args()
    results = report.measure(tuple(options.only), fast=options.quick)
    options.output.mkdir(parents=True, exist_ok=True)
    stem = f"{results['date']}-{options.name}{'-quick' if options.quick else ''}"
    (options.output / f"{stem}.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.output / f"{stem}.md").write_text(tables.document(results))
    report.write(results, options.report)
    print(f"wrote {options.output / stem}.md and .json, and {options.report / 'index.html'}")


if __name__ == "__main__":
    main()
