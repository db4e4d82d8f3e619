"""Event files of TensorBoard, read back: they hold the means over seeds of what results.parquet holds."""

import json
import struct
import sys
from collections import defaultdict

import numpy as np
import pytest
import small_sweep
from command_line import told
from tensorboardX.proto.event_pb2 import Event

from humanoid_mjx import InputError, sweep
from humanoid_mjx.training import chunks, events, pool

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


def agree(run, measures):
    """Each point's folder holds each value once, where all seeds have one, and no other."""
    results, summary = run.results, run.summary
    count = "step" if "step" in results else "episode"
    folders = sorted((run.path / "tensorboard").iterdir())
    for folder in folders:
        point, found = int(folder.name.partition("_")[0]), read(folder)
        expected = {}
        for name in measures:
            if name in results:
                for step in np.unique(results[count]):
                    rows = (results["point"] == point) & (results[count] == step)
                    expected[name, int(step)] = results[name][rows].astype(float).mean()
            else:
                final = summary[name][summary["point"] == point].astype(float).mean()
                expected[name, int(results[count].max())] = final
        expected = {key: value for key, value in expected.items() if np.isfinite(value)}
        assert set(found) == set(expected) and len(expected) > len(measures)
        assert all(len(values) == 1 for values in found.values())
        # Events hold single precision.
        np.testing.assert_allclose([found[key][0] for key in expected], list(expected.values()), rtol=1e-6)
    return [folder.name for folder in folders]


MEASURES = ("return", "steps", "success", "greedy_return", "greedy_steps", "greedy_success")


@pytest.mark.parametrize("size", [4, 64])
def test_events_are_the_means_of_the_table(tmp_path, monkeypatch, size):
    monkeypatch.setattr(chunks, "CURVES_EVERY_S", 0.0)
    monkeypatch.setattr(pool, "MAX_STEPS", 64)
    looks = []
    take = events.EventFiles._take

    def kept(self, points, seeds, known, curves):
        looks.append(known.min(initial=8))
        take(self, points, seeds, known, curves)

    monkeypatch.setattr(events.EventFiles, "_take", kept)
    run = sweep(CONFIG, tmp_path / "run", pool_size=size, tensorboard=True)
    assert agree(run, MEASURES)[3] == "3_epsilon=0.5_learning_rate=0.4"
    assert len({known for known in looks if 0 < known < 8}) > 2, "written while it trains"


def test_many_points_and_a_resumed_sweep(tmp_path, monkeypatch):
    monkeypatch.setattr(events, "MAX_POINTS", 4)
    run = sweep(CONFIG, tmp_path / "run")
    assert not (run.path / "tensorboard").exists()
    (part,) = (run.path / "checkpoint").glob("part-*.npz")
    with np.load(part) as file:
        arrays = {name: file[name][:7] if file[name].ndim else file[name] for name in file.files}
    np.savez(part, **arrays)
    for _ in range(2):  # what an earlier session wrote is written anew
        resumed = sweep(CONFIG, tmp_path / "run", resume=True, tensorboard=True)
        assert len(agree(resumed, MEASURES)) == 4


def test_learners_that_are_evaluated_along_the_way(tmp_path, monkeypatch):
    monkeypatch.setattr(chunks, "CURVES_EVERY_S", 0.0)
    learner = {"name": "linear_q", "envs": 8, "rollout": 4, "evaluations": 2, "evaluation_envs": 4}
    config = {"name": "along", "task": CONFIG["task"], "learner": learner, "seeds": 2, "total_steps": 640, "record": 4}
    run = sweep(config, tmp_path / "run", tensorboard=True)
    names = [name for name in run.results if name not in ("point", "seed", "step") and "." not in name]
    assert "greedy_success" in names and agree(run, names) == ["0"]


def test_the_command_writes_them_and_says_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(json.dumps(CONFIG))
    assert "tensorboard --logdir runs/small/tensorboard" in told("sweep", "small.yaml", "--tensorboard")
    assert len(list((tmp_path / "runs/small/tensorboard").iterdir())) == 6
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(InputError, match=r"needs the package tensorboardX; pip install 'humanoid-mjx\[tensorboard\]'"):
        sweep(CONFIG, tmp_path / "other", tensorboard=True)
    assert not (tmp_path / "other").exists()
