"""Compare shipped policies as C with themselves in JAX on 10,000 states, and time a decision of theirs on one core.

python experiments/c_policy.py --json docs/bench/c_policy.json       # in seconds; needs a C compiler, `cc`
"""

import argparse
import ctypes
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.commands.export import export
from humanoid_mjx.compute import rng
from humanoid_mjx.evaluation.policy import find_policy

FLOATS, INTS = (np.ctypeslib.ndpointer(kind, flags="C") for kind in (np.float32, np.int32))
STATES = 10_000


class Answers(NamedTuple):
    """Of JAX and of C: the values of all choices, (states, joints, bins); the actions of C, (states, joints)."""

    q: np.ndarray
    found: np.ndarray
    actions: np.ndarray
    seconds: float
    """Processor time of one decision of C, with the call from Python."""


def answers(name: str, folder: Path) -> Answers:
    """The answers to states spread twice as far as those seen in training; the C and its library stay in `folder`."""
    source, library = folder / "policy.c", folder / "policy.so"
    export(name, source)
    flags = "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC"
    subprocess.run(["cc", *flags, str(source), "-o", str(library), "-lm"], check=True)
    compiled = ctypes.CDLL(str(library))
    compiled.q_values.argtypes, compiled.act.argtypes = (FLOATS, FLOATS), (FLOATS, INTS)
    trained = find_policy(name)
    learner: Any = trained.learner
    policy = trained.policy
    seen = policy.moments
    draw = jax.random.normal(rng.key(0), (STATES, len(seen.mean)))
    obs = np.asarray(seen.mean + 2.0 * jnp.sqrt(seen.variance) * draw, np.float32)
    q = np.asarray(jax.jit(lambda obs: learner.q_values(policy.value, learner.preprocess(policy, obs)))(obs))
    found, actions = np.empty_like(q), np.empty(q.shape[:2], np.int32)
    for row, values in zip(obs, found, strict=True):
        compiled.q_values(row, values)
    began = time.process_time()
    for row, action in zip(obs, actions, strict=True):
        compiled.act(row, action)
    return Answers(q, found, actions, (time.process_time() - began) / STATES)


def main() -> None:
    """Write the record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    target = parser.parse_args().json
    rows: list[dict[str, Any]] = []
    for name in ("walk", "walk_sturdy", "stand"):
        with tempfile.TemporaryDirectory() as folder:
            q, found, actions, seconds = answers(name, Path(folder))
        off, same = float(np.abs(found - q).max() / q.std()), float((actions == q.argmax(axis=-1)).mean())
        rows.append({"policy": name, "states": STATES, "error_by_std": off, "same": same, "seconds": seconds})
        print(f"{name}: error {off:.1e} of the spread, same choices {same:.2%}, {1e6 * seconds:.0f} µs a decision")
    target.write_text(json.dumps(compute.made_by() | {"rows": rows}) + "\n")


if __name__ == "__main__":
    main()
