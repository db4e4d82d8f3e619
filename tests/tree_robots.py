"""Robots that are not the lower body, and states of any robot that try all that a contact solver must bear."""

from collections.abc import Callable
from copy import copy
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from humanoid_mjx import compute
from humanoid_mjx.kernels.worlds import one_world
from humanoid_mjx.mechanics.tree.step import accelerate, advance, folded, make_state, motor_forces
from humanoid_mjx.mechanics.tree.structure import Tree

BALLS, BLOCK, FOUR_LEGS, HOPPER, PLANAR, QUADRUPED, SHAPES, SWING, UNEQUAL = (
    (Path(__file__).parent / "data" / f"{name}.xml").read_text()
    for name in ("balls", "block", "four_legs", "hopper", "planar", "quadruped", "shapes", "swing", "unequal")
)


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    """The model with a solver that stops at rounding, as the PGS of some models does not within 100 iterations; its
    motors are torques of their joints."""
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.actuator_gear[:, 0] = model.actuator_gainprm[:, 0] = 1.0
    model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    model.actuator_biasprm[:] = 0.0
    model.opt.tolerance, model.opt.ls_tolerance, model.opt.iterations, model.opt.ls_iterations = 0.0, 1e-12, 100, 100
    return model


def states(model: mujoco.MjModel, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and controls: standing, tilted and lying in, on and off the ground, limbs beyond their
    limits and against each other, slow and fast. No shape touches another within rounding of their distance.
    """
    rng = np.random.default_rng(seed)
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    qpos = np.tile(model.qpos0, (count, 1))
    lower, upper = model.jnt_range[hinges].T
    anywhere = rng.uniform(lower - 0.05, upper + 0.05, (count, len(hinges)))
    near = np.clip(0.02 * rng.normal(size=anywhere.shape), lower - 0.01, upper + 0.01)
    standing = rng.random((count, 1)) < 0.4
    qpos[:, model.jnt_qposadr[hinges]] = np.where(standing, near, anywhere)
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        tilt = rng.choice([0.003, 0.05, 10.0], (count, 1))
        upright = np.concatenate(
            [np.ones((count, 1)), np.where(standing, 0.003, tilt) * rng.normal(size=(count, 3))], 1
        )
        qpos[:, 3:7] = upright / np.linalg.norm(upright, axis=1, keepdims=True)
        qpos[:, :2] = rng.normal(size=(count, 2))
        _place(model, qpos, rng)
    speed = np.exp(rng.uniform(np.log(0.01), np.log(5.0), (count, 1)))
    return qpos, speed * rng.normal(size=(count, model.nv)), rng.uniform(-2.5, 2.5, (count, model.nu))


def _place(model: mujoco.MjModel, qpos: np.ndarray, rng: np.random.Generator) -> None:
    """Put the lowest shape that the ground feels a little above or below it."""
    data = mujoco.MjData(model)
    (plane,) = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    felt = {int(g) for pair in zip(model.pair_geom1, model.pair_geom2, strict=True) if plane in pair for g in pair}
    felt |= {int(g) for g in range(model.ngeom) if model.geom_contype[g] and model.geom_bodyid[g]}
    shapes = sorted(felt - {int(plane)})
    for row in qpos:
        row[2], data.qpos = 0.0, row
        mujoco.mj_kinematics(model, data)
        normal = data.geom_xmat[plane].reshape(3, 3)[:, 2]
        half = np.where(model.geom_type[shapes] == mujoco.mjtGeom.mjGEOM_CAPSULE, model.geom_size[shapes, 1], 0.0)
        tips = np.abs(data.geom_xmat[shapes].reshape(-1, 3, 3)[:, :, 2] @ normal) * half
        lowest = (data.geom_xpos[shapes] @ normal - tips - model.geom_size[shapes, 0]).min()
        row[2] = (rng.choice([0.01, -1e-4, -5e-4, -2e-3, -5e-3]) * rng.uniform(0.1, 1.0) - lowest) / normal[2]


def near_upright(physics: Any) -> Any:
    """Four worlds at rest, their joints up to 0.1 rad away from zero."""
    qpos = np.tile(physics.qpos0, (4, 1))
    qpos[:, 7:] += np.random.default_rng(0).uniform(0, 0.1, (4, 10))
    return jax.jit(jax.vmap(lambda qpos: physics.start(qpos, np.zeros(16))))(qpos)


def dropped(
    model: mujoco.MjModel, count: int, seed: int = 0, spread: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and controls of any model: what native MuJoCo makes of random postures within a second.
    Hinges begin up to `spread`, rad, from the model's posture."""
    rng, model, rows = np.random.default_rng(seed), copy(model), []
    model.opt.tolerance, data = 1e-8, mujoco.MjData(model)  # a solver that stops at rounding takes 16 times as long
    steps = max(2, round(1.0 / model.opt.timestep))
    given = (model.actuator_ctrlrange != 0.0).any(axis=1, keepdims=True)
    low, high = np.where(given, model.actuator_ctrlrange, [[-0.5, 0.5]]).T
    while len(rows) < count:
        mujoco.mj_resetData(model, data)
        for joint, kind in enumerate(model.jnt_type):
            at = model.jnt_qposadr[joint]
            if kind == mujoco.mjtJoint.mjJNT_FREE:
                turned = data.qpos[at + 3 : at + 7] + rng.choice([0.02, 0.2, 1.0]) * rng.normal(size=4)
                data.qpos[at + 3 : at + 7] = turned / np.linalg.norm(turned)
                continue
            way = 0.1 if kind == mujoco.mjtJoint.mjJNT_SLIDE else spread
            lower, upper = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
            data.qpos[at] = np.clip(data.qpos[at] + way * rng.uniform(-1, 1), lower - 0.02, upper + 0.02)
        data.qvel[:] = 0.5 * rng.normal(size=model.nv)
        data.ctrl[:] = (low + high) / 2 + 0.6 * (high - low) * rng.uniform(-1, 1, model.nu)
        mujoco.mj_step(model, data, rng.integers(1, steps))
        wrong = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        if not any(data.warning[kind].number for kind in wrong) and np.abs(data.qvel).max() < 100.0:
            rows.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()))
    qpos, qvel, ctrl = map(np.array, zip(*rows, strict=True))
    return qpos, qvel, ctrl


def native(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray, force: Any = 0.0) -> np.ndarray:
    """Accelerations in native MuJoCo, while `force` acts on the degrees of freedom."""
    data, found = mujoco.MjData(model), np.empty_like(qvel)
    data.qfrc_applied[:] = force
    for row, position, velocity, control in zip(found, qpos, qvel, ctrl, strict=True):
        data.qpos, data.qvel, data.ctrl, data.qacc_warmstart = position, velocity, control, 0.0
        mujoco.mj_forward(model, data)
        row[:] = data.qacc
    return found


def qacc_of(tree: Tree, steps: int = 0) -> Callable[..., Any]:
    """From values, positions, velocities and controls, by world, to accelerations and whether the solver settled, or
    after so many steps to positions and velocities; in jax, by the mechanics alone. With `steps=1` to positions,
    velocities, accelerations and whether it settled."""

    def moved(values: Any, qpos: Any, qvel: Any, ctrl: Any) -> Any:
        def step(qpos: Any, qvel: Any, warmstart: Any) -> Any:
            at = folded(qpos[:, None], tree.coordinates), folded(qvel[:, None], tree.dofs)
            state, motor = make_state(tree, values, *at), motor_forces(tree, ctrl)
            _, solution = accelerate(tree, values, state, motor, folded(warmstart[:, None], tree.dofs))
            parts, settled = advance(tree, values, state, solution, motor)
            return parts, settled & (qvel[0] == qvel[0])

        cold = jnp.zeros_like(qvel)
        if not steps:
            (_, _, qacc), settled = step(qpos, qvel, cold)
            return qacc, settled
        if steps == 1:
            parts, settled = step(qpos, qvel, cold)
            return *parts, settled
        return jax.lax.fori_loop(0, steps, lambda _, at: tuple(step(*at)[0]), (qpos, qvel, cold))

    many = jax.vmap(one_world(moved), in_axes=(None, 0, 0, 0))
    jitted = jax.jit(many, compiler_options=compute.compiler_options("tree"))
    return lambda values, *at: jax.tree.map(np.asarray, jitted(values, *(jnp.asarray(x, float) for x in at)))
