"""Runs the Python benchmarks and writes Markdown and JSON into ``benchmarks/results``."""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path

from . import build, cut, distance, files, frames, gpu, instances, machine, memory, report

BENCHMARKS = {
    "build": build,
    "cut": cut,
    "distance": distance,
    "files": files,
    "frames": frames,
    "gpu": gpu,
    "instances": instances,
    "memory": memory,
}
RESULTS = Path(__file__).resolve().parents[1] / "results"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.python", description=__doc__)
    parser.add_argument(
        "--only",
        nargs="+",
        choices=BENCHMARKS,
        default=[name for name in BENCHMARKS if name != "gpu"],
        help="which to run; gpu, which needs a device, only when asked for",
    )
    parser.add_argument(
        "--quick", action="store_true", help="smaller meshes: to try the benchmarks, not to quote"
    )
    parser.add_argument("--name", default="python", help="end of the name of the results (%(default)s)")
    parser.add_argument("--output", type=Path, default=RESULTS, help="folder for the results (%(default)s)")
    options = parser.parse_args()
    results: dict[str, object] = {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "quick": options.quick,
        "machine": machine.describe(),
    }
    for name in options.only:
        print(f"{name} …", flush=True)
        results[name] = BENCHMARKS[name].run(quick=options.quick)
        print(report.section(name, results[name]), flush=True)
    options.output.mkdir(parents=True, exist_ok=True)
    stem = f"{results['date']}-{options.name}{'-quick' if options.quick else ''}"
    (options.output / f"{stem}.json").write_text(json.dumps(results, indent=1) + "\n")
    (options.output / f"{stem}.md").write_text(report.document(results))
    print(f"wrote {options.output / stem}.md and .json")


if __name__ == "__main__":
    main()
