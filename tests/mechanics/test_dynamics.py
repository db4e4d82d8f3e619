"""The size of the dynamics' program, the MJCF model and the benchmark; the rest is in tests/float64."""

import jax
import jax.numpy as jnp
import pytest

from humanoid_mjx import InputError, Leg, dynamics
from humanoid_mjx.bench import physics
from humanoid_mjx.robot.legs import make_mjspec


def test_zeros_of_the_structure_stay_out_of_the_program():
    def operations(leg):
        return len(jax.make_jaxpr(lambda q: dynamics.mass_matrix(leg, q))(jnp.zeros(5)).eqns)

    assert operations(Leg.physical()) < operations(Leg.thesis())


def test_mujoco_refuses_what_it_cannot_simulate():
    leg = Leg.physical()
    with pytest.raises(InputError, match="mass"):
        make_mjspec(leg.scaled(jnp.array([1.0, 1.0, 0.0, 1.0, 1.0])))
    with pytest.raises(InputError, match="one chain"):
        make_mjspec(jax.vmap(leg.scaled)(jnp.ones(2)))


def test_benchmark_runs():
    lines = []
    records = physics.legs(lines.append, physics.Setting((1,), 2, 2, 2))  # one leg is on one device
    control = {f"{name} control+physics steps/s" for name in ("chain", "mjx-jax", "mjx-jax plain")}
    physical = {f"{name} physics steps/s" for name in ("chain", "mjx-jax", "mujoco")}
    assert {f"{r.subject} {r.unit}" for r in records} == control | physical
    assert all(r.value > 0 for r in records)
    assert "mjx-jax plain" in lines[-1]
