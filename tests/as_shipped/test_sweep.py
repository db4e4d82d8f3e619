"""Sweeps: the same bits alone or together and in any pool; what is refused, reported and compiled."""

import json
import re
import shutil
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from small_sweep import CONFIG, assert_same_tables, run_cli, write_config

from humanoid_mjx import InputError, compute, sweep
from humanoid_mjx.cli import main
from humanoid_mjx.runs.folder import RunFolder, read_arrays
from humanoid_mjx.training import pool
from humanoid_mjx.training.plan import resolved
from humanoid_mjx.training.programs import RUNS, _shared_out
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.sweep import Run


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
    assert results["episode"][:10].tolist() == list(range(6, 61, 6))
    np.testing.assert_allclose(np.unique(results["learner.epsilon"]), [0.2, 0.6, 1.0])
    assert (results["task.goal"] == 40).all()
    order = np.lexsort((results["episode"], results["seed"], results["point"]))
    assert (order == np.arange(len(order))).all()
    assert np.isfinite(results["steps"]).all() and (results["steps"] >= 12).all()
    provenance = json.loads((reference.path / "provenance.json").read_text())
    assert provenance["runs_finished"] == provenance["runs"] == 18
    assert {"versions", "machine", "precision", "seed", "wall_s", "compile_s"} <= set(provenance)


def test_arrays_without_entries_are_made_on_each_device():
    """jaxlib 0.11.2 crashes when it compiles a `shard_map` that takes one."""
    mesh = jax.sharding.Mesh(np.array(jax.devices()), (RUNS,))
    runs, same = (jax.sharding.PartitionSpec(*names) for names in ([RUNS], []))
    program = jax.jit(_shared_out(lambda x, empty, n: (x + n, empty), mesh, (runs, runs, same)))
    args = np.ones((2 * mesh.size, 3)), np.ones((2 * mesh.size, 0)), 1
    (passed,) = re.findall(r"manual_computation\((.*?)\)", program.lower(*args).as_text())
    assert mesh.size > 1 and passed.count("%") == 2
    assert [(x.shape, float(x.sum())) for x in program(*args)] == [
        ((2 * mesh.size, 3), 12 * mesh.size),
        ((2 * mesh.size, 0), 0),
    ]


def test_seeds_differ_and_points_share_them(reference):
    summary = reference.summary
    first = summary["return"][summary["point"] == 0]
    assert len(np.unique(first)) == 3


def test_a_point_trains_as_it_would_alone(reference, tmp_path):
    alone = sweep(with_axes(learner__epsilon=[0.6], learner__learning_rate=[0.7]), tmp_path / "run")
    together = reference.results
    chosen = together["point"] == 3
    for name in ("return", "steps", "success"):
        assert alone.results[name].tobytes() == together[name][chosen].tobytes()


@pytest.mark.parametrize("size", [1, 2, 5, 64])
def test_pool_size_changes_no_bit(reference, tmp_path, size, monkeypatch):
    monkeypatch.setattr(pool, "HARVEST_SHARE", 0.5)
    same_bits(reference.results, sweep(CONFIG, tmp_path / "run", pool_size=size).results)


def test_static_values_are_swept_in_groups(tmp_path):
    run = sweep(with_axes(task__states=[13, 5], learner__epsilon=[0.3, 0.9]), tmp_path / "run")
    alone = sweep(with_axes(task__states=[5], learner__epsilon=[0.9]), tmp_path / "alone")
    chosen = (run.results["task.states"] == 5) & (run.results["learner.epsilon"] == 0.9)
    assert run.results["return"][chosen].tobytes() == alone.results["return"].tobytes()


def test_a_sweep_of_other_values_compiles_nothing(reference, tmp_path):
    with compute.counting_compiles() as compiles:
        sweep(
            with_axes(learner__epsilon=[0.25, 0.5, 0.75], task__bonus=[50.0, 70.0]) | {"episodes": 50}, tmp_path / "run"
        )
    assert compiles.programs == 0


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


class TestRefusals:
    """Each gets one sentence, and nothing that is stored is lost."""

    @pytest.fixture
    def refused(self, monkeypatch, capfd):
        """Runs the command line in this process, which must end as one of its own would."""

        def call(words, *arguments, cwd):
            before = {p: p.read_bytes() for p in Path(cwd).rglob("*") if p.is_file() and p.name != ".lock"}
            monkeypatch.chdir(cwd)
            monkeypatch.setattr(compute, "start", lambda **_: None)
            monkeypatch.setattr(sys, "argv", ["humanoid-mjx", *arguments])
            capfd.readouterr()
            with pytest.raises(SystemExit) as ended:
                main()
            stdout, stderr = capfd.readouterr()
            assert ended.value.code == 2 and stdout == ""
            assert stderr.startswith("error: ") and stderr.count("\n") == 1
            for word in words:
                assert word in stderr, stderr
            after = {p: p.read_bytes() for p in Path(cwd).rglob("*") if p.is_file() and p.name != ".lock"}
            assert before == after

        return call

    def test_a_sentence_is_all_that_a_process_says(self, tmp_path):
        done = run_cli("sweep", write_config(tmp_path, episodes=-1), cwd=tmp_path)
        assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1

    def test_a_bad_config_makes_no_folder(self, refused, tmp_path):
        config = write_config(tmp_path, episodes=-1)
        refused([config, "episodes", "at least 1"], "sweep", config, cwd=tmp_path)
        assert not (tmp_path / "runs").exists()

    def test_a_place_that_is_taken(self, refused, tmp_path):
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "precious").write_text("data")
        config = write_config(tmp_path)
        refused(["run", "already exists and is no run folder"], "sweep", config, "--out", "run", cwd=tmp_path)
        (tmp_path / "run" / "config.yaml").write_text("name: another")
        refused(["run", "already exists; resume it with --resume"], "sweep", config, "--out", "run", cwd=tmp_path)

    def test_resume_of_what_is_no_run(self, refused, tmp_path):
        config = write_config(tmp_path)
        refused(["no run to resume"], "sweep", config, "--resume", cwd=tmp_path)
        (tmp_path / "empty").mkdir()
        refused(["no run folder"], "sweep", config, "--resume", "--out", "empty", cwd=tmp_path)

    def test_start_from_what_does_not_fit(self, refused, tmp_path, reference):
        config = write_config(tmp_path, learner=CONFIG["learner"] | {"start_from": "nowhere"})
        refused(["learner.start_from", "nowhere"], "sweep", config, cwd=tmp_path)

    @pytest.fixture
    def copy(self, reference, tmp_path):
        shutil.copytree(reference.path, tmp_path / "run")
        return tmp_path

    def test_resume_with_another_config(self, refused, copy):
        config = write_config(copy, episodes=61)
        refused(["another config", "episodes"], "sweep", config, "--out", "run", "--resume", cwd=copy)

    def test_a_run_folder_in_use(self, refused, copy):
        held = RunFolder.resume(copy / "run", resolved(Run(copy / "run").config))
        config = write_config(copy)
        refused(["run", "in use"], "sweep", config, "--out", "run", "--resume", cwd=copy)
        held.close()

    def test_a_place_below_a_file(self, refused, tmp_path):
        (tmp_path / "file").write_text("data")
        config = write_config(tmp_path)
        refused(["cannot be written"], "sweep", config, "--out", "file/run", cwd=tmp_path)


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
