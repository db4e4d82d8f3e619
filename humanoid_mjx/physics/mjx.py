# pyright: reportAttributeAccessIssue=false
"""MuJoCo MJX: physics inside compiled jax programs. Only this module touches what is private to MJX."""

import io
from contextlib import redirect_stdout
from copy import copy
from functools import lru_cache, partial
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field, model_validator

from humanoid_mjx import compute
from humanoid_mjx.control.stages import Contacts
from humanoid_mjx.physics.base import Controller, Poses, Sensed, Velocities, World, freeze_if_diverged, where
from humanoid_mjx.physics.model import MujocoPhysics
from humanoid_mjx.robot.description import IMU, below, ground_points
from humanoid_mjx.robot.mjcf import of_field
from humanoid_mjx.robot.touching import FLAGS, SURPLUS_WORDS, touching, word
from humanoid_mjx.spec import InputError, package
from humanoid_mjx.types import AnyArray

with redirect_stdout(io.StringIO()):  # it prints two lines about warp
    from mujoco import mjx

SOLVER_ITERATIONS = {"jax": 4, "warp": 30}
LINE_SEARCH_ITERATIONS = 8
"""Largest numbers of iterations of Newton's method for the contact forces and of its line search. It starts from the
last accelerations. In jax all worlds wait for the slowest; in warp each world stops by itself."""

CONTACTS_PER_WORLD, CONSTRAINTS_PER_WORLD = 16, 64
"""Room in warp's buffers: two feet of four contacts and five pairs of the legs; four rows a foot contact, one each for
the pairs and the ten joint limits."""

LOST = 0b11111
"""Bits of warp's `OverflowType` that report contacts or constraints without room: NEFC, NJMAX_NNZ, BROADPHASE,
NARROWPHASE, CCD."""


IGNORED = (
    *("jnt_springyield", "jnt_stiffnesspoly", "dof_dampingpoly", "tendon_stiffnesspoly", "tendon_dampingpoly"),
    *("actuator_damping", "actuator_dampingpoly", "actuator_armature"),
)
"""Fields of a model that act where they are not 0, and that MJX in jax takes for 0."""


class MjxJax(MujocoPhysics):
    """MJX in jax: CPU and GPU, float32 or float64."""

    implementation: ClassVar[Literal["jax", "warp"]] = "jax"
    terrains: ClassVar[tuple[tuple[str, ...], ...]] = ((),)

    @model_validator(mode="after")
    def _room(self) -> "MjxJax":
        if not compute.make_room():
            raise ValueError(
                "MJX could wait forever: jax already computes, with too few threads for MJX; set "
                f"PJRT_NPROC={compute.POOL_THREADS} in the environment, or make MJX's physics before jax computes"
            )
        return self

    @model_validator(mode="after")
    def _computes_it(self) -> "MjxJax":
        m = self.model
        if self.implementation == "jax":
            found = [words for field in IGNORED if (words := of_field(m, field, getattr(m, field, ())))]
            found += ["noslip iterations"] * bool(m.opt.noslip_iterations)
            fast = m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
            other = m.opt.integrator and not (fast and not m.opt.disableflags & FLAGS.mjDSBL_EULERDAMP)
            found += [f"the {word(mujoco.mjtIntegrator, m.opt.integrator)} integrator"] * bool(other)
            found += [SURPLUS_WORDS] * any(pair.surplus for pair in touching(m))
            if found:
                raise ValueError(f"robot: MJX in jax does not compute {'; '.join(found)}: take mujoco")
        return self

    def step(self, world: World, controller: Controller) -> tuple[World, Float[Array, " joints"]]:
        new, data = self._cycle(self._put(), self._blank_data(), world, controller)
        return new, self._torque(data)

    def run_sensed(self, world: World, controller: Controller, cycles: int) -> tuple[World, Sensed]:
        model, blank = self._put(), self._blank_data()

        def cycle(carry: tuple[World, Sensed], _: None) -> tuple[tuple[World, Sensed], None]:
            world, before = carry
            new, data = self._cycle(model, blank, world, controller, sensed=True)
            now = self._seen(data)
            return (new, where(new.diverged, before, now)), None

        nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(lambda: self._seen(blank)))
        return jax.lax.scan(cycle, (world, nothing), length=cycles)[0]

    def sense(self, world: World, torque: Float[AnyArray, " joints"]) -> Sensed:
        return self._seen(self._cycle(self._put(), self._blank_data(), world, lambda _: torque, sensed=True)[1])

    def _seen(self, data: Any) -> Sensed:
        """Everything that a time step computes about its beginning."""
        poses = Poses(data.xpos, data.xmat.reshape(-1, 3, 3))
        angular, arm = data.cvel[:, :3], data.xpos - data.subtree_com[self.model.body_rootid]
        # MuJoCo's `cvel` is about the centre of mass of a body's tree.
        velocities = Velocities(data.cvel[:, 3:] + jnp.cross(angular, arm), angular)
        turning, felt = (self._read(data.sensordata, (name,)) for name in IMU)
        seen = data.qpos[self.joint_qpos], turning, felt, poses, velocities
        return self._sensed(*seen, self._normal_forces(data), self._torque(data))

    def _torque(self, data: Any) -> Float[Array, " joints"]:
        return data.ctrl * self._motor_scale

    def _normal_forces(self, data: Any) -> Float[Array, " points"]:
        """Normal forces on the corners of the feet, N. In jax they come from the solver, which costs less than MuJoCo's
        touch sensors."""
        balls, _ = ground_points(self.model)
        if self.implementation == "warp" or not len(balls):
            return self._read(data.sensordata, self.robot.point_sensors)
        contact = data._impl.contact
        total = jnp.zeros(len(balls))
        elliptic = self.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
        for dim in np.unique(contact.dim):  # a pyramid's edges, whose forces sum to the normal one, or the normal first
            rows = np.flatnonzero((contact.dim == dim) & (contact.efc_address >= 0))
            edges = contact.efc_address[rows, None] + np.arange(1 if elliptic else max(2 * (dim - 1), 1))
            of_corner = (contact.geom[rows][:, :, None] == balls).any(axis=1)
            total += data._impl.efc_force[edges].sum(axis=1) @ of_corner.astype(data.qpos.dtype)
        return total

    def _put(self) -> Any:
        """The mjx.Model with the traced values in it."""
        model, _ = _mjx_arrays(self.model, self.implementation, jax.config.jax_enable_x64)
        model = jax.tree.map(jnp.asarray, model)
        if self.terrain:
            model = model.replace(opt=model.opt.replace(gravity=self.gravity))
        factors = self.mass_factors(self.mass)
        body_mass = model.body_mass * factors
        return model.replace(
            body_mass=body_mass,
            body_inertia=model.body_inertia * factors[:, None],
            body_subtreemass=below(self.model) @ body_mass,
            dof_damping=model.dof_damping * jnp.asarray(self.damping, float),
            geom_friction=model.geom_friction.at[:, 0].multiply(self.friction),
            pair_friction=model.pair_friction.at[:, :2].multiply(self.friction),
            actuator_ctrlrange=model.actuator_ctrlrange * jnp.asarray(self.torque_limit, float),
            actuator_forcerange=model.actuator_forcerange * jnp.asarray(self.torque_limit, float),
            jnt_actfrcrange=model.jnt_actfrcrange * jnp.asarray(self.torque_limit, float),
        )

    def _blank_data(self) -> Any:
        """An mjx.Data without a state. It is rebuilt in every step, so that loops carry nothing but a `World`."""
        _, data = _mjx_arrays(self.model, self.implementation, jax.config.jax_enable_x64)
        return jax.tree.map(jnp.asarray, data)

    def _at(self, model: Any, blank: Any, world: World) -> Any:
        """The stages that depend on position and velocity."""
        data = blank.replace(qpos=world.qpos, qvel=world.qvel, qacc_warmstart=world.warmstart)
        if self.implementation == "warp":
            return mjx.forward(model, data).replace(qacc_warmstart=world.warmstart)
        return mjx.fwd_velocity(model, mjx.fwd_position(model, data))

    def _cycle(
        self, model: Any, blank: Any, world: World, controller: Controller, sensed: bool = False
    ) -> tuple[World, Any]:
        """One time step, and the mjx.Data of its beginning."""
        data = self._at(model, blank, world)
        torque = self._ask(model, data, world, controller)
        data = data.replace(ctrl=self.controls_for(torque), qfrc_applied=self.pushes())
        new, data = _advance(model, data, sensed)
        return freeze_if_diverged(world, new), data

    def _ask(self, model: Any, data: Any, world: World, controller: Controller) -> Float[Array, " joints"]:
        def dynamics(data: Any) -> tuple[Float[Array, "nv nv"], Float[Array, " nv"]]:
            return mass_matrix(self.model, data), data.qfrc_bias - data.qfrc_passive

        def of_other(physics: MjxJax) -> tuple[Float[Array, "nv nv"], Float[Array, " nv"]]:
            return dynamics(physics._at(physics._put(), data, world))

        def contacts() -> Contacts:
            centers = data.geom_xpos[ground_points(self.model)[0]]
            return self._contacts(centers, data.cdof, data.cdof_dot, data.qvel, data.subtree_com[1])

        return self._within(controller(self._stages(world, partial(dynamics, data), of_other, contacts)))


class MjxWarp(MjxJax):
    """MJX on NVIDIA Warp, float32. All worlds share one contact buffer, so the last bits of a world's results depend on
    the other worlds.

    A world that may have lost contacts or constraints for want of room counts as diverged; contacts lost from the
    shared buffer may be any world's, so then all count as diverged.
    """

    implementation: ClassVar[Literal["jax", "warp"]] = "warp"
    terrains: ClassVar[tuple[tuple[str, ...], ...]] = ()

    worlds: int = Field(8192, ge=1, description="how many worlds the contact buffer has room for")

    @model_validator(mode="after")
    def _installed(self) -> "MjxWarp":
        warp = package("warp", "cuda", "mjx-warp")
        if jax.config.jax_enable_x64:
            raise ValueError("mjx-warp computes in float32 only, but jax_enable_x64 is set")
        warp.config.log_level = warp.LOG_WARNING
        return self

    def _blank_data(self) -> Any:
        contacts = self.worlds * CONTACTS_PER_WORLD
        return mjx.make_data(self.model, impl="warp", naconmax=contacts, njmax=CONSTRAINTS_PER_WORLD)


def mass_matrix(model: mujoco.MjModel, data: Any) -> Float[Array, "nv nv"]:
    """Dense mass matrix of the position stage, from either implementation: dense in jax, a packed lower triangle in
    warp."""
    packed = data._impl.M
    if packed.shape == (model.nv, model.nv):
        return packed
    row, column = np.repeat(np.arange(model.nv), model.M_rownnz), model.M_colind
    packed = packed.reshape(-1)[: len(row)]
    return jnp.zeros((model.nv, model.nv), packed.dtype).at[row, column].set(packed).at[column, row].set(packed)


@lru_cache
def _mjx_arrays(model: mujoco.MjModel, implementation: str, x64: bool) -> tuple[Any, Any]:
    """MJX's model and data with numpy leaves, outside any device and any trace."""
    model = copy(model)
    model.opt.iterations, model.opt.ls_iterations = SOLVER_ITERATIONS[implementation], LINE_SEARCH_ITERATIONS
    if implementation == "jax":  # forces on the corners of the feet are the solver's: see `_normal_forces`
        model.sensor_needstage[model.sensor_type == mujoco.mjtSensor.mjSENS_TOUCH] = mujoco.mjtStage.mjSTAGE_NONE
    with jax.ensure_compile_time_eval():
        try:
            put = mjx.put_model(model, impl=implementation)
        except NotImplementedError as error:
            raise InputError(f"physics: MJX cannot represent the robot, {error}: take mujoco.") from error
        if implementation == "warp":  # it would print a line for each world and step; see `LOST`
            put = put.tree_replace({"opt._impl.warn_overflow": 0})
        data = mjx.make_data(model, impl=implementation) if implementation == "jax" else None
    return jax.tree.map(np.asarray, (put, data))


def _advance(model: Any, data: Any, sensed: bool = False) -> tuple[World, Any]:
    """One time step of semi-implicit Euler from where the position and velocity stages are; also the data of its
    beginning, if `sensed` with the readings of the sensors there."""
    if model.impl.value == "warp":
        after = mjx.step(model, data)
        data, lost = data.replace(sensordata=after.sensordata), (after._impl.overflow & LOST).any()
    else:
        data = mjx.sensor_vel(model, mjx.sensor_pos(model, data)) if sensed else data
        data = mjx.fwd_acceleration(model, mjx.fwd_actuation(model, data))
        data = mjx.solve(model, data) if data._impl.nefc else data.replace(qacc=data.qacc_smooth)
        data = mjx.sensor_acc(model, data) if sensed else data
        after, lost = mjx.euler(model, data), jnp.bool_(False)
    return World(after.qpos, after.qvel, after.qacc_warmstart, lost), data
