"""Print how many tests were skipped and why; with --strict, fail when any was.

Reads what `make test` left in its report folder: skips of both languages as lines `test<TAB>reason` in
`*-skips.txt`, and Rust's `#[ignore = "reason"]` from the log of `cargo test`.
"""

import argparse
import re
import sys
from collections import defaultdict
from pathlib import Path

IGNORED = re.compile(r"^test (?P<test>\S+) \.\.\. ignored(?:, (?P<reason>.*))?$")


def skipped(reports: Path) -> list[tuple[str, str]]:
    """Every skipped test with its reason."""
    named = {}
    # Workers that share the tests out collect all of them, so that each names the modules that are skipped.
    for file in sorted(reports.glob("*-skips.txt")):
        for line in file.read_text().splitlines():
            test, _, reason = line.partition("\t")
            named[test] = reason or "no reason given"
    found = list(named.items())
    log = reports / "rust-log.txt"
    if log.exists():
        matches = filter(None, map(IGNORED.match, log.read_text().splitlines()))
        found += [(match["test"], match["reason"] or "no reason given") for match in matches]
    return found


def main() -> int:
    """Print the summary; the exit code says whether it is acceptable."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reports", type=Path)
    parser.add_argument("--strict", action="store_true")
    arguments = parser.parse_args()

    by_reason = defaultdict(list)
    for test, reason in skipped(arguments.reports):
        by_reason[reason].append(test)
    total = sum(len(tests) for tests in by_reason.values())
    print(f"skipped tests: {total}")
    for reason, tests in sorted(by_reason.items(), key=lambda item: -len(item[1])):
        print(f"  {len(tests)} × {reason}: {', '.join(tests[:3])}{', …' if len(tests) > 3 else ''}")
    if total and arguments.strict:
        print("STRICT=1: no test may be skipped", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
