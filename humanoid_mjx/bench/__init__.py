"""Benchmarks: functions `(say) -> list[Record]`, whose subjects are timed in one process, in turn."""

import sys
from importlib import import_module
from typing import Any

from humanoid_mjx.files import folder

BENCHES = {
    "tabular": "tabular:run",
    "physics": "physics:run",
    "control": "physics:control",
    "training": "",
    "startup": "",
}
"""Module and function of each benchmark, none of those in the folder `benchmarks` of a checkout."""


def measuring(name: str) -> Any:
    """The function of a benchmark; None where the package is installed without it."""
    module, _, function = BENCHES[name].partition(":")
    if module:
        return getattr(import_module(f"humanoid_mjx.bench.{module}"), function)
    return (others := opponents()) and others.BENCHES[name]


def opponents() -> Any:
    """The module of the alternatives, `benchmarks/opponents.py` of a checkout; None where the package is installed."""
    place = folder("benchmarks")
    if not (place / "opponents.py").is_file():
        return None
    if str(place) not in sys.path:  # of this process, and of those that it starts
        sys.path.append(str(place))
    return import_module("opponents")
