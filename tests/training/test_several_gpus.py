"""Programs of several GPUs are traced and lowered on a CPU, where each device stands for a GPU."""

from importlib import import_module
from importlib.util import find_spec

import jax
import numpy as np
import pytest

from humanoid_mjx.config import load
from humanoid_mjx.kernels import fallback
from humanoid_mjx.kernels.worlds import one_kernel
from humanoid_mjx.physics import tree
from humanoid_mjx.training.cost import training_bytes
from humanoid_mjx.training.plan import make_plan
from humanoid_mjx.training.programs import programs, programs_of

SMALL = ["learner.envs=64", "learner.evaluation_envs=64", "learner.minibatches=4", "total_steps=100000"]
CONFIGS = {"joint1": ["seeds=2", "episodes=10"], "leg_reach": ["seeds=2", *SMALL], "walk": ["seeds=2", *SMALL]}
KERNELS = {"joint1": {"advance"}, "leg_reach": {"advance", "finish"}, "walk": {"advance", "finish"}}
"""Programs that hold a kernel of Triton."""

GPU_INFO = "jax._src.pallas.triton.gpu_info"
"""Where jax from 0.11 on looks up the GPU that Triton compiles for."""


@pytest.fixture(autouse=True)
def traced_for_gpus_alone():
    """Neither what other tests traced for a CPU is found here, nor what is traced here by others."""
    _forget()
    yield
    _forget()


def _forget():
    for cached in programs, one_kernel:
        cached.cache_clear()
    jax.clear_caches()


@pytest.mark.parametrize("config", CONFIGS)
def test_a_training_is_lowered_for_two_gpus(config, monkeypatch):
    """Planning traces a training alone, the programs trace it again under the mesh of the devices."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(fallback, "why_none", lambda: None)
    if find_spec(GPU_INFO):
        monkeypatch.setattr(import_module(GPU_INFO), "get_device_kind", lambda: "NVIDIA H100 80GB HBM3")
    assert tree._kernels_run()
    group = make_plan(load(config, CONFIGS[config])).groups[0]
    assert training_bytes(group) > 0
    devices = jax.local_devices()[:2]
    made, runs = programs_of(group.learners, devices), 2
    assert made.by_run.mesh.size == 2

    def of_runs(leaf, shape):
        return jax.ShapeDtypeStruct((runs, *shape), leaf.dtype, sharding=made.by_run)

    learners = jax.tree.map(lambda leaf: of_runs(leaf, leaf.shape[1:]), group.learners)
    training = jax.tree.map(lambda leaf: of_runs(leaf, leaf.shape), group.one_run)
    steps = jax.ShapeDtypeStruct((), np.int32, sharding=made.everywhere)
    seeds = (jax.ShapeDtypeStruct((runs,), np.uint32, sharding=made.by_run),) * 2
    for name, args in {"advance": (learners, training, steps), "finish": (learners, training, seeds)}.items():
        lowered = getattr(made, name).trace(*args).lower(lowering_platforms=("cuda",)).as_text()
        assert ("triton" in lowered) == (name in KERNELS[config]), name
