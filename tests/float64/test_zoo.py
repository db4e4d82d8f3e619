"""Models of others: gymnasium's and dm_control's, as their packages ship them, against native MuJoCo.

The mechanics alone, from states with contacts. `python tests/float64/test_zoo.py FILE.xml ...` does it for any model.
"""

import importlib.util
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from tree_robots import converged, dropped, native, qacc_of

from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.mechanics.tree.step import Values

FOLDERS = {"gymnasium": "envs/mujoco/assets", "dm_control": "suite"}

TAKEN = {
    "gymnasium": (
        *("ant", "half_cheetah", "hopper", "humanoid", "humanoidstandup", "inverted_double_pendulum"),
        *("inverted_pendulum", "reacher", "walker2d"),
    ),
    "dm_control": ("acrobot", "cheetah", "hopper", "humanoid", "walker"),
}

REFUSED = {
    "gymnasium": {"pusher": ["contacts of a capsule and a cylinder"], "swimmer": ["a fluid"]},
    "dm_control": {
        "humanoid_CMU": ["contacts of a sphere and an ellipsoid", "contacts of a capsule and an ellipsoid"],
        "quadruped": ["equality constraints", "more than one free body"],
        "dog": ["noslip iterations", "more than one free body", "contacts of a box and a box"],
    },
}

FEW = ("reacher", "inverted_double_pendulum", "acrobot", "half_cheetah", "walker")
"""Those that compile within seconds, of which each is moved here; the others by hand."""


def path(package: str, name: str) -> str:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        pytest.skip(f"{package} is not installed")
    return str(Path(spec.submodule_search_locations[0]) / FOLDERS[package] / f"{name}.xml")


@pytest.mark.parametrize(("package", "name"), [(package, name) for package, names in TAKEN.items() for name in names])
def test_models_that_the_tree_takes(package, name):
    model = mujoco.MjModel.from_xml_path(path(package, name))
    assert faults(model) == []
    if name in FEW:
        assert errors(model) < 1e-9


@pytest.mark.parametrize(("package", "name"), [(package, name) for package, names in REFUSED.items() for name in names])
def test_models_that_are_refused_with_all_reasons(package, name):
    said = [fault.what for fault in faults(mujoco.MjModel.from_xml_path(path(package, name)))]
    for words in REFUSED[package][name]:
        assert any(what.startswith(words) for what in said), (words, said)


def test_legs_on_fixed_bodies_are_lanes():
    """The ant's hips turn against bodies that are fixed to its torso."""
    model = mujoco.MjModel.from_xml_path(path("gymnasium", "ant"))
    assert fold(read_tree(model)).lanes == 4


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
