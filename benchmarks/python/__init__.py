"""Python benchmarks: ``python -m benchmarks.python``. What each measures: ``benchmarks/README.md``."""
