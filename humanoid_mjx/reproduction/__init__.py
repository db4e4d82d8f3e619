"""The thesis again: experiments that compare what is printed with what comes out, and judge it by computing.

`findings` says what an experiment and its verdict are, `runner` runs them by name, every other module holds the
experiments on one subject. The formulas as printed, faults included, live in `printed`.
"""

from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, Verdict
from humanoid_mjx.reproduction.runner import load_experiments, reproduce

__all__ = ["Experiment", "Finding", "Setting", "Verdict", "load_experiments", "reproduce"]
