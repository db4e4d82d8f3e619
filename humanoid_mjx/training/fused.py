"""Tabular training as one GPU kernel: every thread trains an agent, whose table lies in the shared memory of its block.

The scan of `training.program` starts several kernels for each training step and moves all state through device memory
between them. Here one kernel makes all steps of a chunk. It runs the learner's and the task's own functions, taken
apart by `elementwise`, so that no rule is written twice: from the same keys it draws the same random numbers as the
scan and makes the same operations in the same order. Results differ by rounding alone, where one compiler contracts a
multiplication and an addition and the other does not; `tests/training/test_table_kernels.py` compares them.

`why_not` says whether a learner can be trained so; the scan is the reference, and trains everything else.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import pallas as pl
from jax.experimental.pallas import triton as gpu
from jaxtyping import Array

from humanoid_mjx import compute
from humanoid_mjx.compute import rng
from humanoid_mjx.kernels.elementwise import Elementwise, NotElementwise, kept_in_common
from humanoid_mjx.kernels.memory import assembly
from humanoid_mjx.kernels.table_memory import DeviceMemory, Record, SharedMemory
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.training.program import Training, record_entry
from humanoid_mjx.types import IntScalar

SHARED_BYTES = 48 * 1024
"""Shared memory that a block of threads may declare."""

BLOCKS = (128, 64, 32)
"""Agents a block, a thread each: as many as have room for their tables."""


class Functions(NamedTuple):
    """Parts of a training step between its accesses to the table. Fixed are the learner and the agent's key."""

    learn: Elementwise
    """(agent, next_q_row) -> row, action and change of the table; point of the record and values to add there."""
    go_on: Elementwise
    """(agent, step) -> agent."""
    move: Elementwise
    """(agent, q_row, step) -> agent."""


def why_not(learner: TabularQ) -> str | None:
    """Return the reason why the kernel cannot train a table of one agent, or such tables; None if it can."""
    if reason := compute.why_no_kernel():
        return reason
    if learner.counts or learner.method in ("sarsa", "n_step") or learner.exploration == "boltzmann":
        return "a GPU's kernel knows no counts of visits, no sarsa, n_step and boltzmann"
    try:
        functions(one_of(learner) if all(map(np.ndim, jax.tree.leaves(learner))) else learner)
    except NotElementwise as reason:
        return f"the task {type(learner.task).__name__} {reason}"
    return None


def one_of(learners: TabularQ) -> Any:
    """The shapes of one of the learners side by side."""
    return jax.eval_shape(lambda tree: jax.tree.map(lambda x: x[0], tree), learners)


def functions(learner: TabularQ) -> Functions:
    """The parts of a training step of one run.

    Raises:
      NotElementwise: the task does more than arithmetic and look-ups in constant tables.
    """
    carry = jax.eval_shape(TabularQ.init, learner, rng.key(0))
    key, agent = carry.agents.key, carry.agents._replace(key=None)
    row = tuple(jax.ShapeDtypeStruct((), jnp.float32) for _ in range(carry.q_table.shape[1]))

    def learn(fixed: Any, varying: Any) -> Any:
        learner, key = fixed
        agent, q_row = varying
        update, outcome = learner.learn(agent._replace(key=key), q_row)
        change = learner.learning_rate * update.td_error
        return update.row, update.column, change, *record_entry(learner, outcome)

    def go_on(fixed: Any, varying: Any) -> Any:
        learner, key = fixed
        agent, step = varying
        return learner.go_on(agent._replace(key=key), step)._replace(key=None)

    def move(fixed: Any, varying: Any) -> Any:
        learner, key = fixed
        agent, q_row, step = varying
        return learner.move(agent._replace(key=key), q_row, step)._replace(key=None)

    fixed = learner, key
    return Functions(
        Elementwise(learn, fixed, (agent, row)),
        Elementwise(go_on, fixed, (agent, carry.step)),
        Elementwise(move, fixed, (agent, row, carry.step)),
    )


def block_size(cells: int) -> int | None:
    """Agents a block whose tables of so many values fit into shared memory; None where not even few do."""
    return next((block for block in BLOCKS if block * cells * 4 <= SHARED_BYTES), None)


def advance(
    learners: TabularQ, training: Training, steps: IntScalar, block: int | None = None, interpret: bool = False
) -> Training:
    """Advance the training states of runs side by side, all with a leading axis, as `program.advance` does.

    `block`: agents a block. `interpret`: run on a CPU, slowly, with the tables in device memory.
    """
    runs, num_states, num_actions = training.carry.q_table.shape
    fits = block_size(num_states * num_actions)
    shared, block = fits is not None and not interpret, block or fits or BLOCKS[-1]
    padded = pl.cdiv(runs, block) * block
    if padded != runs:
        rows = np.minimum(np.arange(padded), runs - 1)
        wide = jax.tree.map(lambda x: jnp.asarray(x)[rows], (learners, training))
        return jax.tree.map(lambda x: x[:runs], advance(wide[0], wide[1], steps, block, interpret))
    parts = functions(one_of(learners))
    key, agents = training.carry.agents.key, training.carry.agents._replace(key=None)
    kept: dict[int, Array] = {}
    numbers = kept_in_common(parts)
    for part, mine in zip(parts, numbers, strict=True):
        kept |= zip(mine, jax.vmap(part.once)((learners, key)), strict=True)
    laps = (jnp.int32(steps) + learners.lap - 1) // learners.lap * learners.lap
    tables = [jnp.asarray(table) for table in {id(table): table for part in parts for table in part.tables}.values()]
    state = jax.tree.map(_storable, (agents, training.carry.step))
    memory = training.carry.q_table.reshape(runs, -1), training.record
    inputs = (laps[None], kept, tables, (state, *memory))
    first = len(jax.tree.leaves(inputs[:3]))
    outputs = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), inputs[3])
    found = pl.pallas_call(
        partial(
            _kernel,
            parts=parts,
            numbers=numbers,
            inputs=jax.tree.structure(inputs),
            like=(agents, training.carry.step),
            place=(num_states, num_actions, block) if shared else None,
            block=block,
            num_actions=num_actions,
        ),
        grid=(runs // block,),
        out_shape=jax.tree.leaves(outputs),
        input_output_aliases={first + i: i for i in range(len(jax.tree.leaves(outputs)))},
        compiler_params=gpu.CompilerParams(num_warps=max(1, block // 32), num_stages=1),
        interpret=interpret,
    )(*jax.tree.leaves(inputs))
    state, q_table, record = jax.tree.unflatten(jax.tree.structure(outputs), found)
    agents, step = jax.tree.map(lambda new, old: new.astype(old.dtype), state, (agents, training.carry.step))
    carry = training.carry._replace(
        q_table=q_table.reshape(training.carry.q_table.shape), agents=agents._replace(key=key), step=step
    )
    return training._replace(carry=carry, record=record)


def _storable(x: Array) -> Array:
    return x.astype(jnp.int32) if x.dtype == bool else x


def _kernel(
    *refs: Any,
    parts: Functions,
    numbers: list[list[int]],
    inputs: Any,
    like: Any,
    place: Any,
    block: int,
    num_actions: int,
) -> None:
    """All steps of a block of agents; `numbers`: for each part, the indices in `kept` of the values that it takes."""
    count = inputs.num_leaves
    steps, kept, constants, _ = jax.tree.unflatten(inputs, refs[:count])
    *state_refs, tables, record = refs[count:]
    run = pl.program_id(0) * block + jnp.arange(block, dtype=jnp.int32)
    kept = jax.tree.map(lambda ref: gpu.load(ref.at[run]), kept)
    fixed = [[kept[number] for number in mine] for mine in numbers]
    places = {name: i for i, name in enumerate({id(table): None for part in parts for table in part.tables})}

    def lookup(table: np.ndarray, index: Array) -> Array:
        return gpu.load(constants[places[id(table)]].at[jnp.clip(index, 0, len(table) - 1)])

    def truncate(x: Array) -> Array:
        return x.astype(jnp.int32) if place is None else assembly("cvt.rzi.s32.f32 $0, $1;", "=r,f", jnp.int32, x)

    agent, step = jax.tree.unflatten(
        jax.tree.structure(like),
        [gpu.load(ref.at[run]).astype(x.dtype) for ref, x in zip(state_refs, jax.tree.leaves(like), strict=True)],
    )
    token = jnp.zeros(block, jnp.int32)
    memory: Any = DeviceMemory(tables, run, num_actions)
    if place is not None:
        shared = SharedMemory.of(*place)

        def fill(cell: Array, token: Array) -> Array:
            return shared.write(token, shared.cell(cell), gpu.load(tables.at[run, jnp.full(block, cell)]))

        token, memory = jax.lax.fori_loop(0, place[0] * num_actions, fill, token), shared

    def one(_: Array, inner: Any) -> Any:
        token, agent, step, here, sums = inner
        q_row = memory.row(token, agent.next_row)
        row, action, change, point, values = parts.learn.step(fixed[0], (agent, q_row), lookup, truncate)
        token = memory.add(token, row, action, change, (*agent.q_row, *q_row))
        moved = point != here
        curve.put(here, sums, moved)
        sums = [old + value for old, value in zip(curve.row(point, sums, moved), values, strict=True)]
        step = step + 1
        agent = parts.go_on.step(fixed[1], (agent, step), lookup, truncate)
        agent = parts.move.step(fixed[2], (agent, memory.row(token, agent.row), step), lookup, truncate)
        return token, agent, step, point, sums

    here = jnp.zeros(block, jnp.int32)
    curve = Record(record, run)
    sums = curve.row(here, [jnp.zeros(block)] * record.shape[2], here == 0)
    start = token, agent, step, here, sums
    token, agent, step, here, sums = jax.lax.fori_loop(0, steps[0], one, start)
    curve.put(here, sums, here >= 0)
    if place is not None:

        def empty(cell: Array, _: Any) -> None:
            gpu.store(tables.at[run, jnp.full(block, cell)], shared.read(token, shared.cell(cell)))

        jax.lax.fori_loop(0, place[0] * num_actions, empty, None)
    for ref, value in zip(state_refs, jax.tree.leaves((agent, step)), strict=True):
        gpu.store(ref.at[run], _storable(value))
