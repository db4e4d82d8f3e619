"""Tabular Q-learning in one kernel of a GPU: this package's against CUDA by hand, in turn.

    python benchmarks/tabular_cuda.py --json FILE    # on an NVIDIA GPU with CuPy: pip install cupy-cuda13x

    fused    this package's learner, as `humanoid-mjx bench tabular` times it
    cuda     the kernel of `tabular_cuda.cu` with fast arithmetic: one agent a thread, its table in shared memory

Both train the agents of `tabular.py` by the same rules; `cuda` draws cheaper random numbers. With the
most agents both also train the other sizes of table.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tabular import (
    BATCHES,
    BONUS,
    CAP,
    DECAY,
    DISCOUNT,
    EPISODES,
    MOVES,
    POINTS,
    RATE,
    Made,
    fused,
    time_trainings,
)

from humanoid_mjx import compute

OTHER_MOVES = (4, 63)
"""Of the other tables that are trained. A table has a row more."""

BLOCK = 128
"""Threads that share a block's memory."""


def cuda(epsilon: np.ndarray, steps: int, moves: int = MOVES) -> Made:
    """Compile the kernel for tables of `moves` + 1 rows, and make a call that trains an agent for each epsilon."""
    import cupy as cp  # pyright: ignore[reportMissingImports]

    numbers = {"DECAY": DECAY, "RATE": RATE, "DISCOUNT": DISCOUNT, "BONUS": BONUS}
    macros = {"MOVES": moves, "CAP": CAP, "POINTS": POINTS, "EPISODES": EPISODES}
    macros |= {name: f"{number}f" for name, number in numbers.items()}
    options = "-std=c++17", "--use_fast_math", *(f"-D{name}={value}" for name, value in macros.items())
    train = cp.RawKernel(Path(__file__).with_suffix(".cu").read_text(), "train", options=options)
    agents = len(epsilon)
    shared = 4 * 2 * (moves + 1) * BLOCK
    train.max_dynamic_shared_size_bytes = shared
    epsilons, finished = cp.asarray(epsilon), cp.zeros(agents, cp.int32)
    curves = cp.zeros((agents, POINTS, 4), cp.float32)

    def call() -> Any:
        arguments = epsilons, curves, finished, np.int32(steps), np.int32(agents)
        train((-(-agents // BLOCK),), (BLOCK,), arguments, shared_mem=shared)
        cp.cuda.runtime.deviceSynchronize()
        return finished

    return Made(call, lambda result: float(result.sum()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Time both kernels over several numbers of agents and sizes of table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures, as `humanoid-mjx bench` does")
    file = parser.parse_args(arguments).json
    compute.start()
    if jax.default_backend() != "gpu":
        sys.exit("There is no GPU.")
    made_by = compute.made_by()  # before the first kernel: the checkout may change meanwhile
    kernels = {"fused": fused, "cuda": cuda}
    cases = [(batch, kernels) for batch in BATCHES["gpu"]]
    for moves in OTHER_MOVES:
        rows = {f"{name}, {moves + 1} rows": partial(make, moves=moves) for name, make in kernels.items()}
        cases.append((BATCHES["gpu"][-1], rows))
    records = [
        record.as_json() for batch, makers in cases for record in time_trainings(print, batch, makers, tuple(makers))
    ]
    if file is not None:
        file.write_text(json.dumps(made_by | {"records": records}, indent=2) + "\n")
        print(file)


if __name__ == "__main__":
    main()
