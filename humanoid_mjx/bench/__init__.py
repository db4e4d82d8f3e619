"""Benchmarks: functions `(say) -> list[Record]`, whose subjects are timed in one process, in turn."""

BENCHES = {
    "tabular": "tabular:run",
    "physics": "physics:run",
    "control": "physics:control",
    "training": "training:run",
    "startup": "startup:run",
}
"""Module and function of each benchmark."""
