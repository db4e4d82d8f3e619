"""Run a sweep: train every point, block by block, into a run folder that can be resumed."""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np

from humanoid_mjx import runtime
from humanoid_mjx.config import Config, load, parse
from humanoid_mjx.results.store import RunFolder, block_name, fresh_path, latest_path, read_arrays
from humanoid_mjx.results.tables import read_table, write_tables
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import Block, Plan, make_plan, resolved
from humanoid_mjx.training.program import compile_program
from humanoid_mjx.training.progress import Reporter, Silent
from humanoid_mjx.training.state import from_arrays, to_arrays

CHECKPOINT_EVERY_S = 30.0
"""Seconds of training that a kill may cost."""

TABLES_SHARE = 0.05
"""The share of the wall time that rewriting the tables may take while blocks finish."""

RUNNING = "checkpoint/running.npz"


@dataclass(frozen=True)
class Run:
    """A run folder, as its reader sees it."""

    path: Path

    @property
    def results(self) -> dict[str, np.ndarray]:
        """One entry per sweep point, seed and record step, by column."""
        return read_table(self.path / "results.parquet")

    @property
    def summary(self) -> dict[str, np.ndarray]:
        """One entry per sweep point and seed, by column."""
        return read_table(self.path / "summary.parquet")


def sweep(
    config: Config | Mapping[str, Any] | str | Path,
    out: Path | str | None = None,
    *,
    resume: bool = False,
    overrides: Sequence[str] = (),
    block: int | None = None,
    reporter: Reporter | None = None,
) -> Run:
    """Train every point of a sweep with every seed.

    Args:
      config: a config, its plain values, a path, or the name of a shipped one.
      out: the run folder; by default the first free of runs/NAME, runs/NAME-2, ..., or the latest to be resumed.
      resume: complete a run folder instead of making one.
      overrides: such as "learner.epsilon=0.1"; only where `config` is a path or a name.
      block: how many runs train at once; by default what memory and cache hold. It changes no result.
      reporter: told what happens; by default nobody.

    Raises:
      InputError: the config or the place cannot be used, in one sentence. Nothing stored is lost.
    """
    if isinstance(config, (str, Path)):
        config = load(config, overrides)
    elif isinstance(config, Mapping):
        config = parse(dict(config))
    plan = make_plan(config)
    sizes = plan.block_sizes(block, len(jax.devices()), _memory())
    if resume:
        folder = RunFolder.resume(Path(out or latest_path(config.name)), resolved(config))
        sizes = json.loads((folder.path / "checkpoint/plan.json").read_text())["block_sizes"]
    else:
        folder = RunFolder.create(Path(out or fresh_path(config.name)), resolved(config))
        folder.write_json("checkpoint/plan.json", {"block_sizes": sizes})
    session = _Session(folder, plan, reporter or Silent())
    try:
        session.train(plan.blocks(sizes))
    finally:
        session.write_results()
        folder.close()
    return Run(folder.path)


class _Session:
    """The work of one process on a run folder."""

    def __init__(self, folder: RunFolder, plan: Plan, reporter: Reporter):
        self.folder, self.plan, self.reporter = folder, plan, reporter
        self.began = self.tables_due = time.monotonic()
        self.started = datetime.now(UTC).isoformat(timespec="seconds")
        self.compile_s = 0.0
        self.done = 0.0
        self.dirty = False

    def train(self, blocks: Sequence[Block]) -> None:
        """Train what is not finished yet."""
        finished = self.folder.blocks()
        for path in finished.values():
            read_arrays(path)
        self.done = float(sum(len(block) for block in blocks if block.index in finished))
        self.dirty = bool(finished)
        with runtime.counting_compiles() as compiles:
            for block in blocks:
                if block.index in finished:
                    continue
                self._train_block(block)
                self.done += len(block)
                self.dirty = True
                self.compile_s = compiles.seconds
                if time.monotonic() >= self.tables_due:
                    self.write_results()

    def _train_block(self, block: Block) -> None:
        self.reporter.phase("compiling")
        program = compile_program(block.group.learner.structure())
        rows = _pad(np.arange(len(block)), block.size, len(jax.devices()))
        hyper = jax.tree.map(lambda x: x[block.rows[rows]], block.group.hyper)
        seeds = np.full(len(rows), self.plan.config.seed, np.uint32), block.seeds[rows].astype(np.uint32)
        carry = program.init(hyper, seeds, None)
        carry = self._restore(block, carry)
        saved = time.monotonic()
        share = 0.0
        while share < 1.0:
            carry, progress = program.train(hyper, carry)
            progress = np.asarray(progress)[: len(block)]
            share = float(progress.min())
            self.reporter.phase("training")
            self.reporter.update((self.done + float(progress.sum())) * self.plan.config.episodes)
            if time.monotonic() - saved > CHECKPOINT_EVERY_S:
                self._save(block, carry)
                saved = time.monotonic()
        finished = jax.tree.map(lambda x: np.asarray(x)[: len(block)], program.finish(hyper, carry, seeds))
        arrays = {f"curve.{name}": a for name, a in finished["curve"].items()}
        arrays |= {f"final.{name}": a for name, a in finished["final"].items()}
        arrays |= to_arrays(finished["policy"], "policy")
        arrays |= {"point": block.points.astype(np.int32), "seed": block.seeds.astype(np.int32)}
        self.folder.write_arrays(block_name(block.index), arrays)
        self.folder.remove(RUNNING)

    def _save(self, block: Block, carry: Any) -> None:
        self.folder.write_arrays(RUNNING, {"block": np.int32(block.index)} | to_arrays(carry, "carry"))

    def _restore(self, block: Block, carry: Any) -> Any:
        """The training state that an interrupted session left of this block, or the fresh one."""
        path = self.folder.path / RUNNING
        if not path.is_file() or int((arrays := read_arrays(path))["block"]) != block.index:
            return carry
        shardings = jax.tree.map(lambda x: x.sharding, carry)
        return jax.device_put(from_arrays(carry, arrays, "carry", str(path)), shardings)

    def write_results(self) -> None:
        """Bring tables and provenance up to date with the finished blocks."""
        if not self.dirty:
            return
        start = time.monotonic()
        write_tables(self.folder, self.plan)
        self.folder.write_json(
            "provenance.json",
            {
                "versions": runtime.versions(),
                "machine": runtime.machine(),
                "precision": "float64" if jax.config.jax_enable_x64 else "float32",  # type: ignore[attr-defined]
                "seed": self.plan.config.seed,
                "points": len(self.plan.points),
                "seeds": self.plan.config.seeds,
                "runs_finished": int(sum(len(read_arrays(p)["point"]) for p in self.folder.blocks().values())),
                "started": self.started,
                "wall_s": round(start - self.began, 3),
                "compile_s": round(self.compile_s, 3),
            },
        )
        now = time.monotonic()
        self.tables_due = now + (now - start) / TABLES_SHARE
        self.dirty = False


def _pad(rows: np.ndarray, size: int, devices: int) -> np.ndarray:
    """Rows, the last repeated, up to `size` and a multiple of the number of devices."""
    length = -(-size // devices) * devices
    return rows[np.minimum(np.arange(length), len(rows) - 1)]


def _memory() -> int:
    """Bytes that training may take on all devices together."""
    stats = [device.memory_stats() for device in jax.devices()]
    free = [s["bytes_limit"] - s["bytes_in_use"] for s in stats if s and "bytes_limit" in s]
    return sum(free) * 8 // 10 if free else HOST_MEMORY


HOST_MEMORY = 1 << 31
"""Bytes of training state on a CPU, which reports no limit: half of the 4 GB that a sweep is to stay under."""
