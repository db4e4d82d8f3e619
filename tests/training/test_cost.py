"""The estimate of what a run folder takes, against run folders; and what a disk cannot hold is refused."""

import json
import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest
from command_line import told
from small_sweep import CONFIG

from humanoid_mjx import InputError, sweep
from humanoid_mjx.config import parse
from humanoid_mjx.runs.folder import disk_used
from humanoid_mjx.training.cost import disk_bytes
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.pool import Pool

TABLES = CONFIG | {
    "sweep": {"axes": {"learner.epsilon": {"linspace": [0.05, 0.95, 10]}}},
    "seeds": 20,
    "episodes": 200,
    "record": 100,
}
NETWORK = {
    "name": "network",
    "task": CONFIG["task"],
    "learner": {"name": "deep_q", "envs": 8, "rollout": 4, "evaluations": 2, "evaluation_envs": 4},
    "seeds": 2,
    "total_steps": 640,
    "record": 20,
}


@pytest.mark.parametrize("config", [TABLES, NETWORK], ids=["tables", "network"])
def test_the_estimate_is_what_a_finished_run_takes_within_a_factor_of_three(config, tmp_path):
    run = sweep(config, tmp_path / "run")
    estimate = disk_bytes(make_plan(parse(config)), [0])
    # Never below; above as far as the curves in the tables are compressed, which are half of the estimate at most.
    assert estimate / 3 < disk_used(run.path) < 1.05 * estimate


@pytest.mark.parametrize("config", [TABLES, NETWORK], ids=["tables", "network"])
def test_the_estimate_of_the_checkpoint_is_what_is_stored(config):
    (group,) = (plan := make_plan(parse(config))).groups
    pool = Pool(group, deque(group.runs.tolist()), 2, jax.local_devices()[:1], 0)
    stored = sum(array.nbytes for array in pool.state().values())
    estimate = disk_bytes(plan, [2]) - disk_bytes(plan, [0])
    # Twice what is stored, without the bookkeeping of the slots: the times of the record points.
    assert 2 * stored * 0.5 < estimate <= 2 * stored


@pytest.fixture
def free(monkeypatch) -> Callable[[int], None]:
    def set_free(size: int) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=size if Path(path).exists() else 0))

    return set_free


def test_what_the_disk_cannot_hold_is_refused_before_training(tmp_path, free):
    needed = disk_bytes(make_plan(parse(TABLES)), [200])
    free(needed // 2)
    place = tmp_path / "some/where/run"
    with pytest.raises(InputError, match=r"run: the run takes an estimated .*B on disk and .*B are free; "):
        sweep(TABLES, place)
    assert not (tmp_path / "some").exists()
    free(needed)
    sweep(TABLES, place)
    free(needed // 2)  # what the folder holds is not needed again
    with pytest.raises(InputError, match="are free"):
        sweep(TABLES, tmp_path / "other")
    free(needed - disk_used(place))
    sweep(TABLES, place, resume=True)


def test_the_command_refuses_in_one_sentence_and_info_says_the_estimate(tmp_path, free, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tables.yaml").write_text(json.dumps(TABLES))
    shown = told("info", "tables.yaml")
    assert "on disk an estimated" in shown and "B, without figures" in shown
    free(1000)
    with pytest.raises(InputError, match=r"and 1\.0 kB are free"):
        told("sweep", "tables.yaml")
    assert not Path("runs").exists()
