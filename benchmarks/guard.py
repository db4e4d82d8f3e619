"""A handful of ratios in one run, against the record of them that is committed: has something become slow?

    scan               tabular Q-learning of this package, against a naive scan in JAX
    chain              the leg without control, against native MuJoCo on all cores
    help               `humanoid-mjx --help` in a new process, against importing numpy in one
    trace              tracing and lowering a step of `stand`, against a program that stays the same
    compile            XLA's share of the same, against compiling such a program
    tree               running it, the lower body on the ground, against native MuJoCo on all cores
    moving             the same of bodies that random choices have thrown about for up to a second
    training           updates of `walk_cpu`, learning and all, against native MuJoCo alone on all cores

A ratio says how many times as fast its subject is as its reference, the work of both counted in the same unit; larger
is better. Both are timed in turn, the fastest of each counts, and what seems to have fallen is timed again before it is
said to have. All of it computes on the CPU. To add a ratio: a function that returns a `Pair`, and a line in `RATIOS`.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from humanoid_mjx import compute
from humanoid_mjx.bench import ground, physics, tabular
from humanoid_mjx.bench.training import nothing_compiled
from humanoid_mjx.compute import rng
from humanoid_mjx.config import load
from humanoid_mjx.mechanics.tree.search import BLOCK
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


@dataclass(frozen=True)
class Pair:
    """Two calls to time in turn."""

    subject: Callable[[], Any]
    reference: Callable[[], Any]
    work: float = 1.0
    """Work of a call of the subject, in calls of the reference."""
    repeats: int = 7
    clock: Callable[[], float] = time.perf_counter
    """In seconds. That of the processor for what computes in this process for long, on one thread or a few."""


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


def scan() -> Pair:
    """Both train as many agents; the scan, being quicker, for more steps."""
    epsilon = np.linspace(0.1, 0.9, tabular.CPU_BLOCK * jax.local_device_count(), dtype=np.float32)
    ours, naive = 4096, 256
    return _warm(Pair(tabular.scan(epsilon, ours)[0], tabular.naive_scan(epsilon, naive)[0], ours / naive, repeats=15))


def chain() -> Pair:
    """The chain and native MuJoCo, as many legs each; the chain, being quicker, makes five times the steps."""
    return _warm(Pair(physics.chain(1024, 500, "none"), physics.mujoco(1024, 100), work=5.0, repeats=15))


def start_up() -> Pair:
    """Processes of their own."""

    def process(*arguments: str) -> None:
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)

    return Pair(partial(process, "-m", "humanoid_mjx", "--help"), partial(process, "-c", "import numpy"))


class Stand:
    """A step of `stand` for many bodies on every device: traced, compiled and run once for three of the ratios."""

    THROWN_STEPS = 50
    """A second of the task."""

    BODIES = 2 * BLOCK
    """On a device: enough that their contacts are searched block by block, as in training."""

    def __init__(self) -> None:
        devices = np.array(jax.local_devices())
        self.task, self.bodies = make_task("stand"), self.BODIES * len(devices)
        self.over_devices = NamedSharding(Mesh(devices, ("bodies",)), PartitionSpec("bodies"))
        self.lowered: Any = None
        self.compiled: Any = None

    @property
    def time_steps(self) -> int:
        """Those of all bodies in a step of the task."""
        task: Any = self.task
        return self.bodies * task.simulator.substeps(task.period)

    def start(self) -> tuple[Any, ...]:
        """Bodies at the beginning of an episode, an action and a key for each."""
        keys = jax.random.split(jax.random.key(0), self.bodies)
        action = jnp.tile(jnp.array(self.task.action_bins) // 2, (self.bodies, 1))
        return jax.vmap(lambda key: self.task.reset(key))(keys), action, keys

    def trace(self) -> None:
        """Trace and lower it; no cache helps."""
        mesh, spec = self.over_devices.mesh, self.over_devices.spec
        step = jax.vmap(lambda *now: self.task.step(*now))
        step = jax.shard_map(step, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
        step = jax.jit(step, out_shardings=self.over_devices)
        found = jax.eval_shape(self.start)
        given = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=self.over_devices), found)
        self.lowered = _lowered(partial(step.trace, *given))

    def traced(self) -> Any:
        """Last result of `trace`."""
        if self.lowered is None:
            self.trace()
        return self.lowered

    def compile(self) -> None:
        """Compile what has been traced; no cache helps."""
        self.compiled = _compiled(self.traced())

    def steps(self, number: int, first: tuple[Any, ...] | None = None) -> Callable[[], Any]:
        """So many steps from `first`, by default from the beginning of an episode."""
        if self.compiled is None:
            self.compile()
        state, action, keys = first or jax.jit(self.start, out_shardings=self.over_devices)()

        def run() -> Any:
            now = state
            for _ in range(number):
                now = self.compiled(now, action, keys)
            return now

        return run

    def thrown(self) -> tuple[Any, ...]:
        """Bodies that random choices have moved for up to `THROWN_STEPS` steps, another random choice, and keys."""
        random = np.random.default_rng(0)
        state, action, keys = jax.jit(self.start, out_shardings=self.over_devices)()
        ages = random.integers(0, self.THROWN_STEPS, self.bodies, endpoint=True)
        keep = jax.jit(
            lambda step, ages, after, before: jax.tree.map(partial(_older, step < ages), after, before),
            out_shardings=self.over_devices,
        )
        for step in range(self.THROWN_STEPS):
            action = jax.device_put(random.integers(0, self.task.action_bins, action.shape), self.over_devices)
            state = keep(step, ages, self.steps(1, (state, action.astype(int), keys))(), state)
        return jax.device_put((state, action, keys), self.over_devices)


def _older(mask: jax.Array, after: jax.Array, before: jax.Array) -> jax.Array:
    return jnp.where(mask.reshape(-1, *[1] * (after.ndim - 1)), after, before)


@cache
def stand() -> Stand:
    """The one of this process."""
    return Stand()


def trace() -> Pair:
    """No cache helps."""
    return Pair(stand().trace, partial(_lowered, long_program(300)), 1.0, 2, time.process_time)


def compiling() -> Pair:
    """No cache helps; what is compiled has been traced before."""
    stand().traced()
    return Pair(stand().compile, partial(_compiled, _lowered(long_program(100))), 1.0, 1, time.process_time)


def tree() -> Pair:
    """Time steps of `stand`, with what is sensed and decided between them, and of native MuJoCo under its servo."""
    steps, worlds, time_steps = 20, 1024, 20
    native = ground.mujoco(worlds, time_steps)
    return _warm(Pair(stand().steps(steps), native, steps * stand().time_steps / (worlds * time_steps)))


def moving() -> Pair:
    """As `tree`, both from the same states; MuJoCo's set-points are random, too."""
    steps, time_steps = 10, 50
    first = stand().thrown()
    world = first[0].data.world
    qpos, qvel = (np.asarray(part, np.float64) for part in (world.qpos, world.qvel))
    setpoint = stand().task.posture + np.random.default_rng(1).uniform(-0.2, 0.2, (len(qpos), qvel.shape[1] - 6))
    work = steps * stand().time_steps / (len(qpos) * time_steps)
    return _warm(Pair(stand().steps(steps, first), ground.native(qpos, qvel, setpoint, time_steps), work))


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
    setpoint = task.posture + np.random.default_rng(1).uniform(-0.2, 0.2, (len(qpos), qvel.shape[1] - 6))
    steps = learner.rollout * task.simulator.substeps(task.period)
    return _warm(Pair(partial(update, carry), ground.native(qpos, qvel, setpoint, time_steps), steps / time_steps))


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
    "scan": scan,
    "chain": chain,
    "help": start_up,
    "trace": trace,
    "compile": compiling,
    "tree": tree,
    "moving": moving,
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
