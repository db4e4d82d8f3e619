"""Faults of numbers: memory that does not suffice, and rewards that are no numbers."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
from fault_trying import CONFIGS, TINY, Matrix, Try, begin, bits, command, isolated, write_config

from humanoid_mjx.training import pool as pool_module
from humanoid_mjx.training import sweep as sweep_module


def _limited(most: int) -> Try:
    """A sweep whose device refuses more than so many runs side by side, as XLA does."""
    train_more = pool_module.Pool.train

    def limited(self: Any) -> None:
        if len(self.slots) > most:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8589934592 bytes.")
        train_more(self)

    pool_module.Pool.train = limited
    run = Path.cwd() / f"most-{most}"
    done = command("sweep", write_config(Path.cwd(), TINY), "--out", run)
    if not most:
        return ("one sentence", "") if done.how == "one sentence" else ("wrong", str(done))
    fine = "half as many go on" in done.said and bits(run) == bits(Path.cwd() / "whole")
    return ("fewer side by side, the same bits", "") if fine else ("wrong", str(done))


def memory(matrix: Matrix, folder: Path) -> None:
    """Memory that does not suffice: for all runs side by side, for one run."""
    begin(folder)
    matrix.row("memory does not suffice", "sweep of tables", lambda: isolated(_limited, [2, 0], folder))


OWN = """
import jax.numpy as jnp
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.joint_reach import JointReach
from humanoid_mjx.tasks.leg_reach import LegReach

class Table(JointReach):
    poison: float = traced(0.0)
    def step(self, state, action, key):
        state, reward, done = super().step(state, action, key)
        return state, reward + jnp.where(self.poison > 0, jnp.nan, 0.0), done

class Leg(LegReach):
    poison: float = traced(0.0)
    def step_continuous(self, state, command, key):  # `step` goes through it
        found = super().step_continuous(state, command, key)
        return found._replace(reward=found.reward + jnp.where(self.poison > 0, jnp.nan, 0.0))
"""
"""Tasks whose reward is no number where `poison` is above 0."""


def _poisoned(learner: str) -> Try:
    """A sweep over runs of which some meet rewards that are no numbers."""
    (Path.cwd() / "poisoned_tasks.py").write_text(OWN)
    config = CONFIGS[learner]
    kind = "Table" if learner == "tabular_q" else "Leg"
    task = {key: value for key, value in config["task"].items() if key != "name"}
    runs = {}
    for name, poison in (("healthy", [0.0, 0.25]), ("poisoned", [0.0, 0.5])):
        values = [0.0, 0.0] if name == "healthy" else poison
        discount = "learner.discounting" if learner == "brax_ppo" else "learner.discount"
        axes = {"task.poison": values, discount: [0.8, 0.9]}
        changed = {"name": name, "sweep": {"mode": "zip", "axes": axes}, "seeds": 2}
        path = write_config(Path.cwd(), config | {"task": {"name": f"poisoned_tasks:{kind}", **task}} | changed)
        runs[name] = Path.cwd() / f"{learner}-{name}"
        done = command("sweep", path, "--out", runs[name])
        if done.how != "worked":
            return "wrong", f"{learner}: {done.said}"
    marks = ["diverged" in done.said, "2 runs stopped at numbers that were not finite" in done.said]
    good, bad = (sweep_module.Run(runs[name]).summary for name in ("healthy", "poisoned"))
    marks.append(bad["diverged"].tolist() == [False, False, True, True])
    marks.append(all(repr(good[name][:2].tolist()) == repr(bad[name][:2].tolist()) for name in good))
    marks.append("diverged" in command("runs", runs["poisoned"]).said)  # words may stand on two lines
    page = runs["poisoned"] / "report.html"
    marks.append(command("report", runs["poisoned"], "--no-motion").how == "worked")
    marks.append("2 of 4 runs stopped at numbers that were not finite" in page.read_text())
    marks.append(command("evaluate", runs["poisoned"], "--episodes", 8).how == "worked")
    if not all(marks):
        return "wrong", f"{learner}: {marks} {done.said}"
    return "marked wherever listed, the others keep their bits", ""


def not_finite(matrix: Matrix, folder: Path) -> None:
    """Rewards that are no numbers in some runs of a sweep, with each learner."""
    folder.mkdir()
    for learner in CONFIGS:
        poisoned = partial(isolated, _poisoned, [learner], folder, 400)
        matrix.row("NaN in the rewards of one of two points", learner, poisoned)
