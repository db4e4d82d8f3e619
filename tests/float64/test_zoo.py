"""Models of others, as gymnasium ships them, against native MuJoCo.

The mechanics alone, from states with contacts. `python tests/float64/test_zoo.py FILE.xml ...` does it for any model.
"""

import sys
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest
from tree_robots import converged, dropped, native, qacc_of

from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.mechanics.tree.step import Values

TAKEN = (
    *("ant", "half_cheetah", "hopper", "humanoid", "humanoidstandup", "inverted_double_pendulum"),
    *("inverted_pendulum", "reacher", "walker2d"),
)
REFUSED = {"pusher": "contacts of a capsule and a cylinder", "swimmer": "a fluid"}
MOVED = ("reacher", "half_cheetah")
"""Those that compile within seconds and differ; the others by hand."""


def model_of(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(Path(gymnasium.__file__).parent / f"envs/mujoco/assets/{name}.xml"))


@pytest.mark.parametrize("name", TAKEN)
def test_models_that_the_tree_takes(name):
    model = model_of(name)
    assert faults(model) == []
    if name in MOVED:
        assert errors(model) < 1e-9


@pytest.mark.parametrize("name", REFUSED)
def test_models_that_are_refused_with_a_reason(name):
    assert [fault.what for fault in faults(model_of(name)) if fault.what.startswith(REFUSED[name])]


def test_legs_on_fixed_bodies_are_lanes():
    """The ant's hips turn against bodies that are fixed to its torso."""
    assert fold(read_tree(model_of("ant"))).lanes == 4


def errors(model: mujoco.MjModel, count: int = 32) -> float:
    """The largest error of 32 worlds: of accelerations, relative to 1 and more, and of velocities after a step."""
    model = converged(model)
    at = dropped(model, count)
    _, qvel, qacc, settled = qacc_of(fold(read_tree(model)), 1)(Values(), *at)
    assert settled.all()
    expected, data, moved = native(model, *at), mujoco.MjData(model), np.empty_like(qvel)
    size = 1.0 + np.linalg.norm(expected, axis=1)
    for row, data.qpos, data.qvel, data.ctrl in zip(moved, *at, strict=True):
        data.qacc_warmstart = 0.0
        mujoco.mj_step(model, data)
        row[:] = data.qvel
    return max((np.linalg.norm(qacc - expected, axis=1) / size).max(), (np.abs(qvel - moved).max(axis=1) / size).max())


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    for file in sys.argv[1:]:
        found = mujoco.MjModel.from_xml_path(file)
        print(file, faults(found) or errors(found), flush=True)
