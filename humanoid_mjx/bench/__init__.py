"""Benchmarks: each a module with `run(say) -> list[Record]`, whose subjects are timed in one process, in turn."""

BENCHES = ("tabular", "physics", "control", "training", "startup")
