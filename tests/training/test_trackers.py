"""Trackers, read back: they hold the means over seeds of what results.parquet holds, and all else that is tracked."""

import json
import struct
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import small_sweep
from command_line import told
from tensorboardX.proto.event_pb2 import Event

from humanoid_mjx import InputError, Run, load_policy, sweep
from humanoid_mjx.training import chunks, pool, trackers
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.session import Session
from humanoid_mjx.training.trackers import Tracker

AXES = {"learner.epsilon": [0.1, 0.5, 0.9], "learner.learning_rate": [0.2, 0.4]}
CONFIG = small_sweep.CONFIG | {"sweep": {"axes": AXES}, "episodes": 40, "record": 8}


def read(folder):
    """(tag, step) -> values, from the records of all event files: length, its checksum, the event, its checksum."""
    found = defaultdict(list)
    for file in sorted(folder.glob("events.out.tfevents.*")):
        data = file.read_bytes()
        while data:
            (length,) = struct.unpack("<Q", data[:8])
            event = Event.FromString(data[12 : 12 + length])
            for value in event.summary.value:
                found[value.tag, event.step].append(value.simple_value)
            data = data[16 + length :]
    return found


def expected(run, point, measures):
    """(measure, step) -> the mean over the seeds of a point in results.parquet, where all seeds have one; scores that
    are in the summary alone stand at the last step."""
    results, summary, found = run.results, run.summary, {}
    steps = results["step" if "step" in results else "episode"]
    for name in measures:
        if name in results:
            for step in np.unique(steps):
                found[name, int(step)] = (
                    results[name][(results["point"] == point) & (steps == step)].astype(float).mean()
                )
        else:
            found[name, int(steps.max())] = summary[name][summary["point"] == point].astype(float).mean()
    return {key: value for key, value in found.items() if np.isfinite(value)}


def agree(run, measures):
    """Each point's folder holds each value once, where all seeds have one, and no other."""
    folders = sorted((run.path / "tensorboard").iterdir())
    for folder in folders:
        found, wanted = read(folder), expected(run, int(folder.name.partition("_")[0]), measures)
        assert set(found) == set(wanted) and len(wanted) > len(measures)
        assert all(len(values) == 1 for values in found.values())
        # Events hold single precision.
        np.testing.assert_allclose([found[key][0] for key in wanted], list(wanted.values()), rtol=1e-6)
    return [folder.name for folder in folders]


MEASURES = ("return", "steps", "success", "greedy_return", "greedy_steps", "greedy_success")


def test_both_parts_of_a_training_are_tracked_once(tmp_path):
    config = small_sweep.write_config(tmp_path, sweep={"axes": AXES}, episodes=40, record=8, then={"episodes": 30})
    told("sweep", config, "--out", tmp_path / "run", "--tracker", "tensorboard")
    run = Run(tmp_path / "run")
    for part in run, run.later:
        agree(part, MEASURES)


@pytest.mark.parametrize("size", [4, 64])
def test_events_are_the_means_of_the_table(tmp_path, monkeypatch, size):
    monkeypatch.setattr(chunks, "CURVES_EVERY_S", 0.0)
    monkeypatch.setattr(pool, "MAX_STEPS", 64)
    looks = []
    take = trackers._Means._take

    def kept(self, points, seeds, known, curves):
        looks.append(known.min(initial=8))
        take(self, points, seeds, known, curves)

    monkeypatch.setattr(trackers._Means, "_take", kept)
    run = sweep(CONFIG, tmp_path / "run", pool_size=size, trackers=["tensorboard"])
    assert agree(run, MEASURES)[3] == "3_epsilon=0.5_learning_rate=0.4"
    assert len({known for known in looks if 0 < known < 8}) > 2, "written while it trains"


def test_many_points_and_a_resumed_sweep(tmp_path, monkeypatch):
    monkeypatch.setattr(trackers, "MAX_POINTS", 4)
    run = sweep(CONFIG, tmp_path / "run")
    assert not (run.path / "tensorboard").exists()
    (part,) = (run.path / "checkpoint").glob("part-*.npz")
    with np.load(part) as file:
        arrays = {name: file[name][:7] if file[name].ndim else file[name] for name in file.files}
    np.savez(part, **arrays)
    for _ in range(2):  # what an earlier session wrote is written anew
        resumed = sweep(CONFIG, tmp_path / "run", resume=True, trackers=["tensorboard"])
        assert len(agree(resumed, MEASURES)) == 4


def test_learners_that_are_evaluated_along_the_way(tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "CURVES_EVERY_S", 0.0)
    learner = {"name": "linear_q", "envs": 8, "rollout": 4, "evaluations": 2, "evaluation_envs": 4}
    config = {"name": "along", "task": CONFIG["task"], "learner": learner, "seeds": 2, "total_steps": 640, "record": 4}
    run = sweep(config, tmp_path / "run", trackers=["tensorboard"])
    names = [name for name in run.results if name not in ("point", "seed", "step") and "." not in name]
    assert "greedy_success" in names and agree(run, names) == ["0"]


def test_the_command_writes_them_and_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(json.dumps(CONFIG))
    assert "tensorboard --logdir runs/small/tensorboard" in told("sweep", "small.yaml", "--tensorboard")
    assert len(list((tmp_path / "runs/small/tensorboard").iterdir())) == 6
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(InputError, match=r"needs the package tensorboardX; pip install 'humanoid-mjx\[tensorboard\]'"):
        sweep(CONFIG, tmp_path / "other", trackers=["tensorboard"])
    assert not (tmp_path / "other").exists()


MADE = []


class Kept(Tracker):
    """A user's own tracker, which keeps what it is told."""

    def __init__(self):
        self.records, self.ends = [], []
        MADE.append(self)

    def on_start(self, folder, config, points):
        self.folder, self.config, self.points = folder, config, points

    def on_record(self, point, step, means):
        self.records.append((point, step, dict(means)))

    def on_end(self, files, finished):
        self.ends.append(([path.relative_to(self.folder).as_posix() for path in files], finished))
        return f"look at {self.folder}"


class Faulty(Kept):
    def on_record(self, point, step, means):
        super().on_record(point, step, means)
        raise ConnectionError("the server is gone")


class Absent(Kept):
    def on_start(self, folder, config, points):
        raise PermissionError("log in first")


def values_of(tracker, point):
    """(measure, step) -> value of what a tracker was told of a point, each once."""
    told = [(name, step, x) for at, step, means in tracker.records if at == point for name, x in means.items()]
    found = {(name, step): value for name, step, value in told}
    assert len(found) == len(told)
    return found


def test_a_tracker_of_ones_own_gets_the_means_of_the_table_and_the_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(json.dumps(CONFIG))
    MADE.clear()
    assert "look at runs/small" in told("sweep", "small.yaml", "--tracker", f"{Kept.__module__}:Kept")
    (tracker,) = MADE
    run = Run(Path("runs/small"))
    assert tracker.folder == run.path and tracker.config["sweep"]["axes"].keys() == AXES.keys()
    assert tracker.points["3_epsilon=0.5_learning_rate=0.4"] == {"learner.epsilon": 0.5, "learner.learning_rate": 0.4}
    for number, point in enumerate(tracker.points):
        assert values_of(tracker, point) == pytest.approx(expected(run, number, MEASURES))
    ((files, finished),) = tracker.ends
    assert finished and "figures/learning_curves.png" in files and files[-1] == "policy.npz"
    assert load_policy("runs/small/policy.npz").learner.task.joint == 5


def test_a_tracker_that_fails_is_left_out_and_the_sweep_goes_on(tmp_path):
    class Notes(Reporter):
        def __init__(self):
            self.notes = []

        def note(self, text):
            self.notes.append(text)

    faulty, kept, heard = Faulty(), Kept(), Notes()
    sweep(CONFIG, tmp_path / "run", trackers=[faulty, kept], reporter=heard)
    assert len(faulty.records) == 1 and not faulty.ends and kept.ends == [([], True)]
    (note,) = (text for text in heard.notes if "Faulty" in text)
    assert note.startswith("Faulty no longer tracks this sweep: ConnectionError: the server is gone (test_trackers.py,")


def test_a_stopped_sweep_tells_its_trackers_so_and_a_resumed_one_begins_with_what_is_stored(tmp_path, monkeypatch):
    stopped, store = Kept(), Session._store

    def stop(self, event):
        store(self, event)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Session, "_store", stop)
        sweep(CONFIG, tmp_path / "run", trackers=[stopped], pool_size=4)
    assert stopped.ends == [([], False)]
    resumed = Kept()
    run = sweep(CONFIG, tmp_path / "run", resume=True, trackers=[resumed])
    for number, point in enumerate(resumed.points):
        assert values_of(resumed, point) == pytest.approx(expected(run, number, MEASURES))


def test_trackers_that_cannot_be_had(tmp_path, monkeypatch):
    with pytest.raises(
        InputError, match=r"unknown tracker 'wand'; did you mean 'wandb'\? known are mlflow, tensorboard"
    ):
        sweep(CONFIG, tmp_path / "run", trackers=["wand"])
    with pytest.raises(InputError, match=r"must be a class derived from humanoid_mjx.training.trackers.Tracker"):
        sweep(CONFIG, tmp_path / "run", trackers=["pathlib:Path"])
    for name in ("wandb", "mlflow"):
        monkeypatch.setitem(sys.modules, name, None)
        words = rf"--tracker {name} needs the package {name}; pip install 'humanoid-mjx\[{name}\]' brings it"
        with pytest.raises(InputError, match=words):
            sweep(CONFIG, tmp_path / "run", trackers=[name])
    assert not (tmp_path / "run").exists()
    kept = Kept()
    with pytest.raises(InputError, match="exists and is no run folder"):
        sweep(CONFIG, Path(__file__).parent, trackers=[kept])
    assert not kept.ends
    with pytest.raises(InputError, match="Absent cannot track this sweep: PermissionError: log in first"):
        sweep(CONFIG, tmp_path / "run", trackers=[kept, Absent()])
    assert kept.ends == [([], False)]


def records(file):
    """The records of an offline run of Weights & Biases: pieces with checksum, length and kind in blocks of 32 KiB."""
    from wandb.proto.wandb_internal_pb2 import Record

    data, place, piece = file.read_bytes(), 7, b""
    while place < len(data):
        if (left := -place % 32768) < 7 and left:
            place += left
            continue
        length, kind = struct.unpack("<HB", data[place + 4 : place + 7])
        piece += data[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # whole, or the last of several
            yield Record.FromString(piece)
            piece = b""


def test_weights_and_biases_without_a_network(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    for name, value in {"MODE": "offline", "PROJECT": "mine", "CACHE_DIR": tmp_path, "DATA_DIR": tmp_path}.items():
        monkeypatch.setenv(f"WANDB_{name}", str(value))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(json.dumps(CONFIG))
    assert f"wandb sync {tmp_path}/wandb/offline-run-*" in told("sweep", "small.yaml", "--tracker", "wandb")
    run, found = Run(Path("runs/small")), {}
    for file in tmp_path.glob("wandb/offline-run-*/*.wandb"):
        parts = defaultdict(list)
        for record in records(file):
            parts[kind := record.WhichOneof("record_type")].append(getattr(record, kind))
        (begun,) = parts["run"]
        found[begun.display_name] = parts
        assert (begun.run_group, begun.project) == ("small", "mine") and parts["exit"][0].exit_code == 0
    whole = found.pop("small")
    assert len(found) == 6 and [artifact.name for artifact in whole["artifact"]] == ["small-policy"]
    assert {"learning_curves"} <= {key for row in whole["history"] for key in names(row)}
    for name, parts in found.items():
        config = {item.key: json.loads(item.value_json) for item in parts["run"][0].config.update}
        number = int(name.partition("_")[0])
        assert config["learner"]["epsilon"] == [0.1, 0.1, 0.5, 0.5, 0.9, 0.9][number] and "sweep" not in config
        rows = [{key: json.loads(item.value_json) for key, item in names(row).items()} for row in parts["history"]]
        curves = {(key, row["trained"]): row[key] for row in rows for key in row if key in MEASURES}
        assert curves == pytest.approx(expected(run, number, MEASURES))


def names(row):
    """Items of a row of a history by name."""
    return {item.key or item.nested_key[0]: item for item in row.item}


def test_mlflow_in_files(tmp_path, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setattr(trackers, "METRICS", 7)
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    monkeypatch.setenv("MLFLOW_EXPERIMENT_NAME", "mine")
    monkeypatch.chdir(tmp_path)
    uri = (tmp_path / "store").as_uri()
    mlflow.set_tracking_uri(uri)
    (tmp_path / "small.yaml").write_text(json.dumps(CONFIG))
    assert f"mlflow ui --backend-store-uri {uri}" in told("sweep", "small.yaml", "--tracker", "mlflow")
    run, client = Run(Path("runs/small")), mlflow.MlflowClient()
    found = {
        each.info.run_name: each for each in client.search_runs([client.get_experiment_by_name("mine").experiment_id])
    }
    whole = found.pop("small")
    files = {file.path for file in client.list_artifacts(whole.info.run_id)}
    assert {"config.yaml", "policy.npz", "learning_curves.png"} <= files and len(found) == 6
    for name, each in found.items():
        number = int(name.partition("_")[0])
        assert each.info.status == "FINISHED" and each.data.tags["mlflow.parentRunId"] == whole.info.run_id
        assert each.data.params["learner.epsilon"] == str([0.1, 0.1, 0.5, 0.5, 0.9, 0.9][number])
        history = [client.get_metric_history(each.info.run_id, name) for name in each.data.metrics]
        curves = {(one.key, one.step): one.value for metric in history for one in metric}
        assert curves == pytest.approx(expected(run, number, MEASURES))
