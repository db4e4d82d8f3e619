"""Sweeps on a Ray cluster of this machine: the bits of this process, whatever happens to workers and driver."""

import json
import os
import re
import signal
import sys
from functools import partial

import pytest
from small_sweep import CONFIG, LONG, assert_same_tables, write_config

from humanoid_mjx import InputError, sweep
from humanoid_mjx.config import load
from humanoid_mjx.runs.tables import finished_runs
from humanoid_mjx.training import chunks, on_ray
from humanoid_mjx.training.on_ray import OnRay
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.session import Session
from humanoid_mjx.training.sweep import Run

SMALL = CONFIG | {"chunk": 4}
UNEVEN = CONFIG | LONG | {"seeds": 6, "chunk": 6}

FALLS = """
import sys
from humanoid_mjx.tasks.joint_reach import JointReach

class Falls(JointReach):
    def step(self, *given):
        if "default_worker" in sys.argv[0]:
            raise ValueError("this task falls")
        return super().step(*given)
"""


DIES = """
import os, signal, sys, time
from pathlib import Path
from humanoid_mjx.tasks.joint_reach import JointReach
from humanoid_mjx.training.chunks import Work

class Dies(JointReach):
    pass

def keep(self, pool, keep=Work._keep, folder=Path({folder!r})):
    claimed = pool.progress.mean() > 0.01 and not (folder / "claimed").exists()
    if claimed:
        (folder / "claimed").touch()
        (folder / self.key).touch()
    keep(self, pool)
    while claimed and not (folder / "taken").exists():
        time.sleep(0.01)
    if claimed:
        os.kill(os.getpid(), signal.SIGKILL)

if "default_worker" in sys.argv[0]:
    Work._keep = keep
"""
"""A task whose module kills the first worker that has a state, as soon as the driver has it."""

HOLDS = """
import sys, threading
from humanoid_mjx.tasks.joint_reach import JointReach
from humanoid_mjx.training import chunks
from humanoid_mjx.training.pool import Pool

told = threading.Event()

class Holds(JointReach):
    pass

def stop(self, stop=chunks.Work.stop):
    self.stopped.set()
    told.set()
    return stop(self)

def train(self, train=Pool.train):
    train(self)
    if self.progress.any():
        told.wait()

if "default_worker" in sys.argv[0]:
    chunks.Work.stop, Pool.train, chunks.LEAVE_AFTER_S = stop, train, 60.0
"""
"""A task whose module lets no worker train far before it is stopped."""


@pytest.fixture(scope="module")
def cluster():
    """The address of a cluster of two workers, bound to loopback."""
    os.environ.update(on_ray.SETTINGS)
    utils = pytest.importorskip("ray.cluster_utils")
    node = {"num_cpus": 2, "include_dashboard": False, "object_store_memory": 100 << 20}
    cluster = utils.Cluster(initialize_head=True, head_node_args=node)
    yield cluster.address
    cluster.shutdown()


class Hears(Reporter):
    """Keeps what it is told, kills the first workers that begin, and acts when runs train."""

    def __init__(self, kills=0, act=lambda: None):
        self.notes, self.kills, self.act = [], kills, act

    def note(self, text):
        self.notes.append(text)
        if text.endswith(" trains") and self.kills:
            self.kills -= 1
            os.kill(int(text.split()[1].rpartition(":")[2]), signal.SIGKILL)

    def update(self, state):
        act, self.act = self.act, lambda: None  # once: what workers have may be told while they stop
        act()

    @property
    def workers(self):
        return [int(note.split()[1].rpartition(":")[2]) for note in self.notes if note.endswith(" trains")]

    @property
    def lost(self):
        return [note for note in self.notes if "was lost" in note]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return sweep(UNEVEN, tmp_path_factory.mktemp("whole") / "run").path


def test_chunks_that_are_narrow_for_a_gpu_are_named():
    plan = make_plan(load("leg_reach", ["seeds=64"]))
    words = "chunks of 1 run suit the cache of a CPU core; GPUs train more side by side in little more time"
    assert on_ray.too_narrow(plan, 2) == f"{words}: --set chunk=32"
    for chosen in ("leg_reach seeds=64 chunk=8", "maze seeds=8", "walk seeds=1"):
        name, *overrides = chosen.split()
        assert on_ray.too_narrow(make_plan(load(name, overrides)), 2) == ""


def test_workers_train_the_bits_of_this_process(cluster, tmp_path):
    heard = Hears()
    here = sweep(SMALL, tmp_path / "here")
    there = sweep(
        SMALL, tmp_path / "there", engine=partial(OnRay, address=cluster), reporter=heard, trackers=["tensorboard"]
    )
    assert_same_tables(there.path, here.path)
    assert heard.notes[0] == "5 chunks of up to 4 runs for 2 workers with a CPU each"
    assert len(json.loads((there.path / "provenance.json").read_text())["machines"]) == 1
    assert len(list((there.path / "tensorboard").iterdir())) == 6


def test_halving_on_workers_gives_the_bits_of_this_process(cluster, tmp_path):
    halving = {"sweep": CONFIG["sweep"] | {"mode": "halving", "eta": 2, "rungs": 2}}
    here = sweep(SMALL | halving, tmp_path / "here")
    there = sweep(SMALL | halving, tmp_path / "there", engine=partial(OnRay, address=cluster), reporter=Hears(kills=1))
    assert here.summary["rung"].tolist().count(2) == 9
    assert_same_tables(there.path, here.path)


def test_a_chunk_whose_worker_is_killed_goes_to_another_one(cluster, whole, tmp_path):
    heard = Hears(kills=3)
    run = sweep(UNEVEN, tmp_path / "run", engine=partial(OnRay, address=cluster), reporter=heard)
    assert len(heard.lost) == 3 and re.search(
        r"^worker .*:\d+ was lost \(\w+\); chunk \d goes to another$", heard.lost[0]
    )
    assert_same_tables(run.path, whole)


def test_a_lost_chunk_goes_on_from_its_state(cluster, tmp_path, monkeypatch):
    heard, began, take, begin = Hears(), {}, Session.take, OnRay._begin

    def taken(self, event):
        take(self, event)
        # A state of no progress may be on its way when the worker claims to be the one that dies.
        if isinstance(event, chunks.State) and (tmp_path / event.key).exists() and event.arrays["progress"].any():
            (tmp_path / "taken").touch()

    def beginning(self, chunk, desk):
        states = desk.given([chunk]).states
        began.setdefault(chunk.number, []).append(max([arrays["progress"].max() for _, arrays in states], default=0))
        begin(self, chunk, desk)

    (tmp_path / "dying.py").write_text(DIES.format(folder=str(tmp_path)))
    monkeypatch.setattr(chunks, "CHECKPOINT_EVERY_S", 0.0)
    monkeypatch.setattr(Session, "take", taken)
    monkeypatch.setattr(OnRay, "_begin", beginning)
    dying = UNEVEN | {"task": UNEVEN["task"] | {"name": "dying:Dies"}, "modules": str(tmp_path)}
    run = sweep(dying, tmp_path / "run", engine=partial(OnRay, address=cluster), reporter=heard)
    (note,) = heard.lost
    first, second = began[int(note.split("chunk ")[1].split()[0])]
    assert first == 0 and second > 0
    assert_same_tables(run.path, sweep(dying, tmp_path / "here").path)


def test_a_chunk_that_loses_every_worker_is_given_up(cluster, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(on_ray, "TRIES", 1)
    words = r"1 chunk lost the worker 1 times \(chunk \d+, at last .*:\d+ \(\w+\)\); the others are stored"
    with pytest.raises(InputError, match=words):
        sweep(UNEVEN, tmp_path / "run", engine=partial(OnRay, address=cluster), reporter=Hears(kills=1))
    assert len(Run(tmp_path / "run").summary["point"]) == 30
    assert_same_tables(sweep(UNEVEN, tmp_path / "run", resume=True).path, whole)


def test_a_driver_that_stops_stores_what_workers_have_and_this_process_goes_on(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(on_ray, "LOOK_EVERY_S", 0.05)
    monkeypatch.setattr(chunks, "LEAVE_AFTER_S", 60.0)  # a busy machine may need more than five
    (tmp_path / "holding.py").write_text(HOLDS)
    holding = UNEVEN | {"task": UNEVEN["task"] | {"name": "holding:Holds"}, "modules": str(tmp_path)}

    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(holding, tmp_path / "run", engine=partial(OnRay, address=cluster), reporter=Hears(act=stop))
    assert list(tmp_path.glob("run/checkpoint/pool-*.npz"))
    assert_same_tables(sweep(holding, tmp_path / "run", resume=True).path, sweep(holding, tmp_path / "here").path)
    assert not list(tmp_path.glob("run/checkpoint/pool-*.npz"))


def test_a_task_that_raises_is_not_tried_again(cluster, tmp_path):
    (tmp_path / "falling.py").write_text(FALLS)
    task = {"task": CONFIG["task"] | {"name": "falling:Falls"}, "modules": str(tmp_path)}
    heard = Hears()
    with pytest.raises(
        InputError, match=r"^chunk \d, worker .*: ValueError: this task falls \(falling.py, line 8.*\)\.$"
    ):
        sweep(SMALL | task, tmp_path / "run", engine=partial(OnRay, address=cluster), reporter=heard)
    assert not heard.lost


def test_what_cannot_be_reached_is_said_in_a_sentence(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"^--ray 127.0.0.1:1: no cluster answers there .*write HOST:PORT"):
        sweep(SMALL, tmp_path / "run", engine=partial(OnRay, address="127.0.0.1:1"))
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(
        InputError, match=r"^--ray needs the package ray; pip install 'humanoid-mjx\[ray\]' brings it.$"
    ):
        sweep(SMALL, tmp_path / "run", engine=OnRay)
    assert not (tmp_path / "run").exists()


def test_a_cluster_of_another_version_is_left_at_once(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(on_ray.compute, "versions", lambda: {"jax": "1.0"})
    with pytest.raises(InputError, match=r"^worker .*:\d+ has jax .* and this machine 1.0; install the same there\.$"):
        sweep(SMALL, tmp_path / "run", engine=partial(OnRay, address=cluster))
    assert not finished_runs(tmp_path / "run", ("point",))


@pytest.mark.parametrize(
    ("words", "address"),
    [
        (["--ray"], "local"),
        (["--ray", "--view"], "local"),
        (["--ray", "there:1"], "there:1"),
        (["--ray", "auto"], "auto"),
    ],
)
def test_the_address_may_be_left_out(said, tmp_path, monkeypatch, words, address):
    monkeypatch.setattr("humanoid_mjx.commands.sweep.run_sweep", lambda *given: print("ray", given[-1]))
    assert said("sweep", write_config(tmp_path), *words)[1] == f"ray {address}\n"
