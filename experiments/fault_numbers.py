"""Faults of numbers: memory that does not suffice, and rewards that are no numbers."""

from pathlib import Path
from typing import Any

import jax
from fault_trying import CONFIGS, TINY, Done, Matrix, bits, command, isolated, whole, write_config

from humanoid_mjx.training import pool as pool_module
from humanoid_mjx.training import sweep as sweep_module


def _limited(kind: str) -> tuple[Done, bool]:
    """A sweep whose device refuses more than so many runs side by side, as XLA does; and whether its bits are right."""
    most = {"a quarter fits": 2, "nothing fits": 0}[kind]
    train_more = pool_module.Pool.train

    def limited(self: Any) -> None:
        if len(self.slots) > most:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8589934592 bytes.")
        train_more(self)

    pool_module.Pool.train = limited
    run = Path.cwd() / kind.replace(" ", "-")
    done = command("sweep", write_config(Path.cwd(), TINY), "--out", run)
    return done, done.how == "worked" and bits(run) == bits(Path.cwd() / "whole")


def memory(matrix: Matrix, folder: Path) -> None:
    """Memory that does not suffice: for all runs side by side, for one run."""

    def tried() -> tuple[list[str], list[str]]:
        folder.mkdir()
        isolated(whole, [folder / "whole"], folder)
        some, none = (isolated(_limited, [kind], folder)[0] for kind in ("a quarter fits", "nothing fits"))
        right = [some[1] and "half as many go on" in some[0].said, none[0].how == "one sentence"]
        words = ["fewer side by side, the same bits", "one sentence"]
        outcomes = [word if fine else "wrong" for word, fine in zip(words, right, strict=True)]
        return outcomes, [str(found) for found, fine in zip((some, none), right, strict=True) if not fine]

    matrix.row("memory does not suffice", "sweep of tables", tried)


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


def _poisoned(learner: str) -> str:
    """A sweep over runs of which some meet rewards that are no numbers: what is wrong with it, or nothing."""
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
            return f"{learner}: {done.said}"
    marks = ["diverged" in done.said, "2 runs stopped at numbers that were not finite" in done.said]
    good, bad = (sweep_module.Run(runs[name]).summary for name in ("healthy", "poisoned"))
    marks.append(bad["diverged"].tolist() == [False, False, True, True])
    marks.append(all(repr(good[name][:2].tolist()) == repr(bad[name][:2].tolist()) for name in good))
    marks.append("diverged" in command("runs", runs["poisoned"]).said)  # words may stand on two lines
    page = runs["poisoned"] / "report.html"
    marks.append(command("report", runs["poisoned"], "--no-motion").how == "worked")
    marks.append("2 of 4 runs stopped at numbers that were not finite" in page.read_text())
    marks.append(command("evaluate", runs["poisoned"], "--episodes", 8).how == "worked")
    return "" if all(marks) else f"{learner}: {marks} {done.said}"


def not_finite(matrix: Matrix, folder: Path) -> None:
    """Rewards that are no numbers in some runs of a sweep, with each learner."""
    folder.mkdir()
    for learner in CONFIGS:

        def tried(learner: str = learner) -> tuple[list[str], list[str]]:
            (wrong,) = isolated(_poisoned, [learner], folder, 400)
            return ["wrong" if wrong else "marked wherever listed, the others keep their bits"], [wrong] * bool(wrong)

        matrix.row("NaN in the rewards of one of two points", learner, tried)
