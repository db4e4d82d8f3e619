"""Sweeps: the same bits alone or together and in any pool; what is refused, reported and compiled."""

import json
import re
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from docs_reader import blocks
from small_sweep import CONFIG, assert_same_tables, write_config

from humanoid_mjx import InputError, compute, make_learner, make_task, sweep
from humanoid_mjx.learners.base import ENVS
from humanoid_mjx.runs.folder import RunFolder, read_arrays
from humanoid_mjx.training import pool
from humanoid_mjx.training.plan import resolved
from humanoid_mjx.training.program import begin, train
from humanoid_mjx.training.programs import RUNS, _shared_out
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.sweep import Run


def test_the_learner_with_replay_of_the_documentation_compiles(tmp_path, monkeypatch):
    """By the options of its `program`: with those of `DeepQ`, XLA aborts."""
    page = (Path(__file__).parents[2] / "docs" / "own_parts.md").read_text(encoding="utf-8")
    (text,) = (block.text for block in blocks(page) if block.title == "replay.py")
    (tmp_path / "with_replay.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    values = {"total_steps": 99, "capacity": 4321, "envs": 3, "width": 8, "layers": 1, "batch": 16, "evaluations": 1}
    learner = make_learner("with_replay:ReplayQ", make_task("leg_reach"), **values)
    runs = jax.eval_shape(jax.vmap(lambda key: begin(learner, key)), jax.random.split(jax.random.key(0), 2))
    options = compute.compiler_options(learner.env.arithmetic, learner.program)
    train_all = jax.jit(jax.vmap(lambda run: train(learner, run, jnp.int32(64))), compiler_options=options)
    assert train_all.lower(runs).compile()


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    return sweep(CONFIG, tmp_path_factory.mktemp("reference") / "run")


def same_bits(a, b):
    assert list(a) == list(b)
    for name in a:
        assert a[name].dtype == b[name].dtype, name
        if a[name].dtype == object:
            assert (a[name] == b[name]).all(), name
        else:
            assert a[name].tobytes() == b[name].tobytes(), name


def with_axes(**axes):
    return CONFIG | {"sweep": {"axes": {name.replace("__", "."): values for name, values in axes.items()}}}


def test_tables_hold_a_row_for_every_point_seed_and_record_step(reference):
    results, summary = reference.results, reference.summary
    assert len(results["point"]) == 6 * 3 * 10 and len(summary["point"]) == 6 * 3
    assert len(np.unique(summary["return"][summary["point"] == 0])) == 3, "seeds differ"
    assert results["episode"][:10].tolist() == list(range(6, 61, 6))
    np.testing.assert_allclose(np.unique(results["learner.epsilon"]), [0.2, 0.6, 1.0])
    assert (results["task.goal"] == 40).all()
    order = np.lexsort((results["episode"], results["seed"], results["point"]))
    assert (order == np.arange(len(order))).all()
    assert np.isfinite(results["steps"]).all() and (results["steps"] >= 12).all()
    provenance = json.loads((reference.path / "provenance.json").read_text())
    assert provenance["runs_finished"] == provenance["runs"] == 18
    assert {"versions", "machine", "precision", "seed", "wall_s", "compile_s"} <= set(provenance)


@pytest.mark.parametrize(("episodes", "record"), [(82, 2), (82, 30), (41, 3), (5, 2)])
def test_a_row_of_a_learning_curve_is_the_mean_of_the_episodes_since_the_row_before(tmp_path, episodes, record):
    def columns(record):
        return sweep(CONFIG | {"episodes": episodes, "record": record}, tmp_path / str(record)).results

    rows, every = columns(record), columns(episodes)
    ends = rows["episode"][:record]
    assert np.abs(ends - np.arange(1, record + 1) * episodes / record).max() <= 0.5
    for name in ("steps", "return", "success"):
        parts = np.split(every[name].reshape(-1, episodes), ends[:-1], axis=1)
        means = np.stack([part.mean(axis=1) for part in parts], axis=1)
        np.testing.assert_allclose(rows[name].reshape(-1, record), means, rtol=1e-5, err_msg=name)


def test_arrays_without_entries_are_made_on_each_device():
    """jaxlib 0.11.2 crashes when it compiles a `shard_map` that takes one."""
    mesh = jax.sharding.Mesh(np.array(jax.devices())[:, None], (RUNS, ENVS))
    runs, same = (jax.sharding.PartitionSpec(*names) for names in ([RUNS], []))
    program = jax.jit(_shared_out(lambda x, empty, n: (x + n, empty), mesh, (runs, runs, same)))
    args = np.ones((2 * mesh.size, 3)), np.ones((2 * mesh.size, 0)), 1
    (passed,) = re.findall(r"manual_computation\((.*?)\)", program.lower(*args).as_text())
    assert mesh.size > 1 and passed.count("%") == 2
    assert [(x.shape, float(x.sum())) for x in program(*args)] == [
        ((2 * mesh.size, 3), 12 * mesh.size),
        ((2 * mesh.size, 0), 0),
    ]


def test_a_point_trains_as_it_would_alone(reference, tmp_path):
    alone = sweep(with_axes(learner__epsilon=[0.6], learner__learning_rate=[0.7]), tmp_path / "run", pool_size=1)
    together = reference.results
    chosen = together["point"] == 3
    for name in ("return", "steps", "success"):
        assert alone.results[name].tobytes() == together[name][chosen].tobytes()


@pytest.mark.parametrize("size", [1, 5, 64])
def test_pool_size_changes_no_bit(reference, tmp_path, size, monkeypatch):
    """One slot on each device, a number that does not divide 18 runs, and more slots than runs."""
    monkeypatch.setattr(pool, "HARVEST_SHARE", 0.5)
    same_bits(reference.results, sweep(CONFIG, tmp_path / "run", pool_size=size).results)


def test_static_values_are_swept_in_groups(tmp_path):
    run = sweep(with_axes(task__states=[13, 5], learner__epsilon=[0.3, 0.9]), tmp_path / "run", pool_size=1)
    alone = sweep(with_axes(task__states=[5], learner__epsilon=[0.9]), tmp_path / "alone", pool_size=1)
    chosen = (run.results["task.states"] == 5) & (run.results["learner.epsilon"] == 0.9)
    assert run.results["return"][chosen].tobytes() == alone.results["return"].tobytes()


def test_start_from_what_was_learned_before(reference, tmp_path):
    learner = CONFIG["learner"] | {"start_from": str(reference.path)}
    again = sweep(CONFIG | {"learner": learner, "episodes": 10, "record": 10}, tmp_path / "run")
    fresh = sweep(CONFIG | {"episodes": 10, "record": 10}, tmp_path / "fresh")
    first = again.results["steps"][again.results["episode"] == 1].mean()
    assert first < fresh.results["steps"][fresh.results["episode"] == 1].mean()


def test_collective_sweep_is_repeatable(tmp_path):
    config = CONFIG | {"learner": CONFIG["learner"] | {"agents": 20}}
    a, b = (sweep(config, tmp_path / name, pool_size=size) for name, size in (("a", 2), ("b", 9)))
    same_bits(a.results, b.results)


@pytest.mark.parametrize(
    ("changes", "options", "there", "words"),
    [
        ({"episodes": -1}, [], {}, "episodes must be at least 1"),
        ({}, ["--out", "run"], {"run/precious": "data"}, "already exists and is no run folder"),
        ({}, ["--out", "run"], {"run/config.yaml": "name: another"}, "already exists; resume it with --resume"),
        ({}, ["--resume"], {}, "no run to resume"),
        ({}, ["--resume", "--out", "."], {}, "no run folder"),
        ({"episodes": 61}, ["--resume", "--out", "whole"], {}, "another config (episodes differs)"),
        ({"seeds": 400}, ["--resume", "--out", "whole"], {}, "another config (seeds differs)"),  # chunk, too
        ({"learner": CONFIG["learner"] | {"start_from": "nowhere"}}, [], {}, "learner.start_from: nowhere"),
        ({}, ["--out", "file/run"], {"file": "data"}, "cannot be written"),
    ],
)
def test_what_a_sweep_refuses_loses_nothing(reference, said, tmp_path, monkeypatch, changes, options, there, words):
    """It gets one sentence; what is stored stays, and no folder is made."""
    shutil.copytree(reference.path, tmp_path / "whole")
    monkeypatch.chdir(tmp_path)
    for name, text in there.items():
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(text)
    config, before = write_config(tmp_path, **changes), files(tmp_path)
    code, out, err = said("sweep", config, *options)
    assert code == 2 and out == "" and err.startswith("error: ") and err.count("\n") == 1 and words in err, err
    assert files(tmp_path) == before and not Path("runs").exists()


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


def test_a_run_folder_in_use_is_refused(reference):
    held = RunFolder.resume(reference.path, resolved(Run(reference.path).config))
    with pytest.raises(InputError, match="in use"):
        sweep(CONFIG, reference.path, resume=True)
    held.close()


@pytest.mark.parametrize("enough", [3, 0])
def test_where_memory_does_not_suffice_fewer_runs_train_side_by_side(reference, tmp_path, monkeypatch, enough):
    """Tables learn the same bit by bit; for fewer than one run there is a sentence."""
    notes, train = [], pool.Pool.train

    class Kept(Reporter):
        def note(self, text):
            notes.append(text)

    def limited(self):
        if len(self.slots) > enough:
            raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 12345 bytes.")
        train(self)

    monkeypatch.setattr(pool.Pool, "train", limited)
    if not enough:
        with pytest.raises(InputError, match="the memory does not suffice for one run"):
            sweep(CONFIG, tmp_path / "run", pool_size=4, reporter=Kept())
        return
    sweep(CONFIG, tmp_path / "run", pool_size=4, reporter=Kept())
    assert sum("the memory does not suffice for" in note for note in notes) == 2
    assert_same_tables(tmp_path / "run", reference.path)


def test_runs_that_approximate_train_side_by_side_with_shared_kernels(tmp_path):
    """XLA aborted on two writes of snapshots in one kernel: of the moments, and of a network's leaves of one shape."""
    learner = {"name": "deep_q", "width": 8, "layers": 1, "envs": 4, "rollout": 4, "minibatches": 1, "evaluations": 2}
    config = {"name": "side", "task": CONFIG["task"], "learner": learner | {"evaluation_envs": 1}}
    run = sweep(config | {"seeds": 4, "total_steps": 32, "record": 2}, tmp_path / "run")
    assert np.isfinite(run.results["greedy_return"]).all()


def test_an_update_counts_at_the_record_point_of_its_last_step(tmp_path):
    """Of seven updates of 16 steps, in 100 steps; the last tenth of the curve holds the last of them."""
    learner = {"name": "deep_q", "width": 4, "layers": 1, "envs": 4, "rollout": 4, "minibatches": 1}
    config = {"name": "few", "task": CONFIG["task"], "learner": learner | {"evaluation_envs": 1}, "total_steps": 100}
    run = sweep(config, tmp_path / "run")
    ends = np.round(1.12 * np.arange(1, 101))
    expected = np.searchsorted(ends, 16 * np.arange(1, 8))
    assert np.flatnonzero(np.isfinite(run.results["td_error"])).tolist() == expected.tolist()
    assert np.isfinite(run.summary["td_error"]).all()


def test_a_flipped_bit_of_a_checkpoint_is_named_or_harmless(tmp_path):
    """Every bit of a small file: its checksums find most, its headers and directory must be read without surprise."""
    path = tmp_path / "part.npz"
    arrays = {"point": np.arange(2, dtype=np.int32), "curve.steps": np.ones((2, 3), np.float32)}
    np.savez(path, **arrays, config=np.array("digest"))
    whole, refused = path.read_bytes(), 0
    for place in range(8 * len(whole)):
        data = bytearray(whole)
        data[place // 8] ^= 1 << place % 8
        path.write_bytes(bytes(data))
        try:
            read_arrays(path, digest="digest")
        except InputError as error:
            assert "truncated or damaged" in str(error)
            refused += 1
    assert refused > 4 * len(whole)
