"""A handful of ratios in one run, against the record of them that is committed: has something become slow?

    tables             tabular Q-learning as a sweep runs it, against a naive scan in JAX
    chain              the leg without control, against native MuJoCo
    help               `humanoid-mjx --help` in a new process, against importing numpy in one
    trace              tracing and lowering a step of `stand`, its kernel compiled in it, against a program that stays
                       the same
    compile            XLA's share of the same, against compiling such a program
    tree               the lower body on the ground, standing, against native MuJoCo
    moving             the same of bodies that are thrown about
    training           updates of `walk_cpu`, learning and all, against the physics of native MuJoCo alone

A ratio says how many times as fast its subject is as its reference, the work of both counted in the same unit; larger
is better. Time is that of the processor, of all threads together: other programs change it little, and a ratio does not
depend on the number of cores. Both are timed in turn, the fastest of each counts, and what seems to have fallen is
timed again before it is said to have. All of it computes on the CPU. To add a ratio: a function that returns a `Pair`,
and a line in `RATIOS`.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import ground_physics as ground
import jax
import jax.numpy as jnp
import leg_physics as physics
import numpy as np
import opponents
import tabular
from other_tables import naive_scan
from trainings import nothing_compiled

from humanoid_mjx import compute
from humanoid_mjx.compute import rng
from humanoid_mjx.config import load
from humanoid_mjx.tasks import make_task
from humanoid_mjx.training.plan import make_plan

RECORD = Path(__file__).with_suffix(".json")
"""The committed ratios."""

MAY_FALL = 0.25
"""The share of its recorded value that a ratio may lose: repeats on a busy machine differ by up to .15."""

UPDATES = 30
"""Updates before a training is timed: half a minute of each body, most of which has fallen more than once."""

TRIES = 3
"""Number of timings of a fallen ratio before it is reported."""


def processor_s() -> float:
    """Seconds that all threads of this process and the processes that it started have computed."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True)
class Pair:
    """Two calls to time in turn."""

    subject: Callable[[], Any]
    reference: Callable[[], Any]
    work: float = 1.0
    """Work of a call of the subject, in calls of the reference."""
    repeats: int = 7
    clock: Callable[[], float] = processor_s


class Found(NamedTuple):
    """A ratio beside what the record says."""

    name: str
    value: float
    recorded: float | None
    """None: the record does not have it."""

    @property
    def fell(self) -> bool:
        return self.recorded is not None and self.value < (1.0 - MAY_FALL) * self.recorded


def run(recorded: Mapping[str, float], ratios: Mapping[str, Callable[[], Pair]]) -> list[Found]:
    """Measure every ratio, and print it beside its recorded value."""
    found: list[Found] = []
    for name, make in ratios.items():
        found.append(_measured(name, make(), recorded.get(name)))
        value, before = found[-1].value, found[-1].recorded
        beside = "not in the record" if before is None else f"{value / before:5.2f} of the recorded {before:.3g}"
        print(f"{name:12} {value:10.3g}  {beside}{'  FELL' if found[-1].fell else ''}", flush=True)
    return found


def _measured(name: str, pair: Pair, recorded: float | None) -> Found:
    fastest = (np.inf, np.inf)
    for _ in range(TRIES):
        fastest = time_pair(pair, fastest)
        found = Found(name, pair.work * fastest[1] / fastest[0], recorded)
        if not found.fell:
            break
    return found


def time_pair(pair: Pair, fastest: tuple[float, float]) -> tuple[float, float]:
    """Seconds of the fastest call of subject and reference, called in turn, and not slower than `fastest`."""
    subject, reference = fastest
    for _ in range(pair.repeats):
        subject = min(subject, _seconds(pair.subject, pair.clock))
        reference = min(reference, _seconds(pair.reference, pair.clock))
    return subject, reference


def verdict(found: list[Found]) -> str:
    """One sentence about all ratios."""
    if fell := [ratio for ratio in found if ratio.fell]:
        parts = [f"{ratio.name} to {ratio.value / ratio.recorded:.2f}" for ratio in fell if ratio.recorded]
        return f"Of its recorded value fell {', '.join(parts)}; {1.0 - MAY_FALL:g} is allowed."
    return f"None of {len(found)} ratios fell by more than a quarter."


def _seconds(call: Callable[[], Any], clock: Callable[[], float]) -> float:
    start = clock()
    jax.block_until_ready(call())
    return clock() - start


def tables() -> Pair:
    """Both train as many agents; the kernel, being quicker, for more steps."""
    epsilon = np.linspace(0.1, 0.9, tabular.CPU_BLOCK * jax.local_device_count(), dtype=np.float32)
    ours, naive = 8192, 256
    return _warm(Pair(tabular.fused(epsilon, ours).call, naive_scan(epsilon, naive).call, ours / naive, repeats=15))


def chain() -> Pair:
    """The chain and native MuJoCo, as many legs each; the chain, being quicker, makes five times the steps."""
    return _warm(Pair(physics.chain(1024, 500, controlled=False), opponents.mujoco(1024, 100), work=5.0, repeats=15))


def start_up() -> Pair:
    """Processes of their own."""

    def process(*arguments: str) -> None:
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)

    return Pair(partial(process, "-m", "humanoid_mjx", "--help"), partial(process, "-c", "import numpy"))


@cache
def stand() -> Callable[[], Any]:
    """Traces a step of `stand` for many bodies."""
    task, bodies = make_task("stand"), 512

    def step(keys: jax.Array) -> Any:
        action = jnp.tile(jnp.array(task.action_bins) // 2, (bodies, 1))
        return jax.vmap(task.step)(jax.vmap(task.reset)(keys), action, keys)

    return lambda: jax.jit(step).trace(jax.random.split(jax.random.key(0), bodies))


def trace() -> Pair:
    """No cache helps."""
    return Pair(partial(_lowered, stand()), partial(_lowered, long_program(300)), 1.0, 2)


def compiling() -> Pair:
    """No cache helps; what is compiled has been traced before."""
    subject, reference = _lowered(stand()), _lowered(long_program(100))
    return Pair(partial(_compiled, subject), partial(_compiled, reference), 1.0, 1)


def tree(moving: bool = False) -> Pair:
    """As many bodies and steps of both, from the same states to the same set-points under the same servo."""
    steps, states = 50, ground.states_of(2048, moving)
    return _warm(Pair(ground.compiled("tree", states, steps), opponents.native(states, steps)))


def training() -> Pair:
    """Updates of bodies that have learnt for some, and as many time steps of native MuJoCo from where they are then."""
    learner: Any = make_plan(load("walk_cpu")).groups[0].learner()
    task, time_steps = learner.env, 50
    update = jax.jit(learner.train_step, compiler_options=compute.compiler_options(task.arithmetic, learner.program))
    carry = jax.jit(learner.init)(rng.key(0))
    for _ in range(UPDATES):
        carry, _ = update(carry)
    world = carry.envs.state.data.world
    qpos, qvel = (np.asarray(part, np.float64) for part in (world.qpos, world.qvel))
    setpoint = task.robot.posture + np.random.default_rng(1).uniform(-0.2, 0.2, (len(qpos), qvel.shape[1] - 6))
    steps = learner.rollout * task.simulator.substeps(task.period)
    return _warm(Pair(partial(update, carry), opponents.native((qpos, qvel, setpoint), time_steps), steps / time_steps))


def long_program(parts: int) -> Callable[[], Any]:
    """Traces a program that no change of this package touches."""

    def compute(x: jax.Array) -> jax.Array:
        for part in range(parts):
            wave = jnp.sin(x * (part + 1.0))
            x = jnp.where(wave > 0, jnp.cumsum(wave, axis=-1) @ jnp.ones((16, 16)), x[::-1] + wave)
        return x

    return lambda: jax.jit(compute).trace(jax.ShapeDtypeStruct((8, 16), jnp.float32))


def _lowered(traced: Callable[[], Any]) -> Any:
    with nothing_compiled():
        return traced().lower()


def _compiled(lowered: Any) -> Any:
    with nothing_compiled():
        # Without options it would keep what it compiled, and not do it again.
        return lowered.compile(compute.compiler_options("scalars"))


def _warm(pair: Pair) -> Pair:
    """Compile both, which is not timed."""
    jax.block_until_ready((pair.subject(), pair.reference()))
    return pair


RATIOS: dict[str, Callable[[], Pair]] = {
    "tables": tables,
    "chain": chain,
    "help": start_up,
    "trace": trace,
    "compile": compiling,
    "tree": tree,
    "moving": partial(tree, moving=True),
    "training": training,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure all ratios on the CPU, write them if asked to, and exit with 1 where one fell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the ratios; the record is benchmarks/guard.json"
    )
    file = parser.parse_args(arguments).json
    compute.start()
    jax.config.update("jax_platforms", "cpu")
    made_by = compute.made_by()  # before the first ratio: the checkout may change meanwhile
    recorded = json.loads(RECORD.read_text())["ratios"] if RECORD.is_file() else {}
    found = run(recorded, RATIOS)
    if file is not None:
        ratios = {ratio.name: round(ratio.value, 4) for ratio in found}
        file.write_text(json.dumps(made_by | {"ratios": ratios}, indent=2) + "\n")
        print(file)
    print(verdict(found))
    sys.exit(any(ratio.fell for ratio in found))


if __name__ == "__main__":
    main()
