"""Motions played on the free lower body on the ground, and what becomes of it."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx import control
from humanoid_mjx.mechanics import balance, gaits, pattern_generator
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.balance import accelerations, foot_corners, link_motion
from humanoid_mjx.physics.base import World
from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import FloatScalar, IntScalar

CONTROLLERS = ("servo", "computed torque", "section 5.7")
"""A plain servo; computed torque within the contacts (`control.ground`); computed torque with the gains of Table 5.1
that knows no contacts and takes the torso for held. Each is asked at every time step."""

FALLEN_M, FALLEN_TILT = 0.15, 60.0
"""Of the hips above the ground (standing: 0.215), and of the torso in degrees: the body has fallen."""

PUSH_S, PUSH_AT = 0.1, 0.5
"""How long a push takes, and when it begins, s."""


class Trial(NamedTuple):
    """What one body is told."""

    controller: str
    motion: str = "stand"
    """Or the name of a gait."""
    frequency: float | None = None
    """Hz of the pattern generator, which starts in the gait's mean posture; without it the table as it is printed."""
    amplitude: float = 1.0
    """Of the pattern generator."""
    push: tuple[float, float] = (0.0, 0.0)
    """On the hips, forwards and to the left, N s."""


class Path(NamedTuple):
    """What became of it, up to its fall."""

    qpos: Float[np.ndarray, "times nq"]
    qvel: Float[np.ndarray, "times nv"]
    error: Float[np.ndarray, "times joints"]
    """Distance from the plan, rad."""
    corners: Float[np.ndarray, "times corners 3"]
    """The lowest points of the feet's corners, m: the right foot's four, then the left's."""
    fell: bool

    @property
    def times(self) -> Float[np.ndarray, " times"]:
        return physics().step_s * np.arange(len(self.qpos))

    @property
    def seconds(self) -> float:
        """s, till the fall or the end."""
        return round(float(self.times[-1]), 3)

    @property
    def touching(self) -> Bool[np.ndarray, "times corners"]:
        return self.corners[..., 2] <= 0.0

    @property
    def distance(self) -> float:
        """Of the middle between the feet, forwards, m. A falling torso goes somewhere, too."""
        middle = self.corners[..., 0].mean(axis=1)
        return float(middle[-1] - middle[0])

    @property
    def turn(self) -> float:
        """Of the torso about the vertical, to the left, degrees: the twist of its rotation, whatever it leans."""
        yaw = np.unwrap(2 * np.arctan2(self.qpos[:, 6], self.qpos[:, 3]))
        return float(np.degrees(yaw[-1] - yaw[0]))

    @property
    def slip(self) -> float:
        """The mean speed of the corners that touch over the ground, m/s."""
        stays = self.touching[1:] & self.touching[:-1]
        speed = np.linalg.norm(np.diff(self.corners[..., :2], axis=0), axis=-1) / physics().step_s
        return float(speed[stays].mean())

    @property
    def tracking(self) -> float:
        """The root mean square of the distance from the plan over time and joints, rad."""
        return float(np.sqrt(np.mean(self.error**2)))


class Balance(NamedTuple):
    """Of a path, at each time step but the last."""

    center: Float[np.ndarray, "steps 3"]
    """Of mass, m."""
    point: Float[np.ndarray, "steps 2"]
    """The zero-moment point, m; NaN in flight."""
    margin: Float[np.ndarray, " steps"]
    """Of the point in the support polygon, m; infinite in flight. An edge has no inside: 0 at most."""
    center_margin: Float[np.ndarray, " steps"]
    """Of the point below the centre of mass."""


@cache
def physics() -> Any:
    """MJX with the lower body, the human ranges of Table 3.2: the gaits leave the proposed ones."""
    return make_physics("mjx-jax", ranges="human")


def play(trials: Sequence[Trial], seconds: float, config: Mapping[str, Mapping[str, float]]) -> dict[Trial, Path]:
    """Simulate all trials at once.

    Args:
      trials: none twice.
      seconds: a multiple of the time step.
      config: under `servo` the kp and kd of `control.PD`, under `computed_torque` the kp, kd and share of
        `control.GroundControl`, whose servo is the first.

    Raises:
      InputError: an unknown gait, gains that no controller takes.
    """
    plans = [_plan(trial, seconds) for trial in trials]
    start = np.stack([_start(np.asarray(plan.qpos[0], np.float64)) for plan in plans])
    kinds = jnp.array([CONTROLLERS.index(trial.controller) for trial in trials])
    pushes = jnp.array([trial.push for trial in trials], float)
    wanted = control.Reference(*(jnp.stack(x) for x in zip(*plans, strict=True)))
    simulate = jax.jit(jax.vmap(_simulation(config)))
    states = simulate(kinds, pushes, wanted, jnp.asarray(start, float))
    qpos, qvel = (np.asarray(x, np.float64) for x in states)
    rows = zip(trials, qpos, qvel, wanted.qpos, strict=True)
    return {trial: _until_fall(qpos, qvel, np.asarray(plan)) for trial, qpos, qvel, plan in rows}


def balance_of(path: Path) -> Balance:
    """Centre of mass, zero-moment point and its margin."""
    qacc = accelerations(path.qvel, physics().step_s)
    links = link_motion(physics().model, path.qpos[:-1], path.qvel[:-1], qacc)
    point = balance.zero_moment_point(*balance.ground_wrench(links))
    center = balance.center_of_mass(links.mass, links.position)
    support = path.corners[:-1, :, :2], path.touching[:-1]
    margin = jax.jit(jax.vmap(balance.support_margin))
    found = center, point, margin(point, *support), margin(center[:, :2], *support)
    return Balance(*(np.asarray(x, np.float64) for x in found))


def _plan(trial: Trial, seconds: float) -> control.Reference:
    """The motion of the joints at each time step, (steps + 1, 10)."""
    times = physics().step_s * jnp.arange(physics().substeps(seconds) + 1)
    if trial.motion == "stand":
        return control.Reference(*jnp.zeros((3, len(times), 10)))
    gait = gaits.gait(trial.motion)
    if trial.frequency is None:
        motion = jax.vmap(gait.both_legs)(times)
    else:
        params = pattern_generator.pattern_generator(gait, trial.frequency, trial.amplitude)
        begin = pattern_generator.init(params)
        motion = jax.vmap(lambda t: pattern_generator.step(params, begin, t)[1])(times)
    return control.Reference(*(x.reshape(len(times), 10) for x in motion))


def _start(joints: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " nq"]:
    """Upright in a posture of the joints, the lowest corner of the feet on the ground."""
    qpos = np.concatenate([physics().qpos0[:7], joints])
    qpos[2] -= foot_corners(physics(), qpos[None])[0, :, 2].min()
    return qpos


def _simulation(config: Mapping[str, Any]) -> Any:
    """From controller, push, plan and start to the states, (steps + 1, ...)."""
    held = control.PD.build(10, **config["servo"])
    servo = {f"servo_{name}": gain for name, gain in config["servo"].items()}
    grounded = control.GroundControl.build(10, **config["computed_torque"], **servo)
    kp, kd = (jnp.tile(jnp.array(gains), 2) for gains in (thesis.KP, thesis.KD))
    simulator = physics()

    def torque(kind: IntScalar, reference: control.Reference, stages: Any) -> Float[Array, " joints"]:
        state = reference, stages.qpos, stages.qvel
        torques = (
            control.pd(held, *state),
            control.grounded_torque(grounded, *state, stages.mass_matrix, stages.bias, stages.contacts()),
            stages.torque_for(control.servo(kp, kd, *state), 1.0),
        )
        return jnp.select([kind == index for index in range(len(CONTROLLERS))], torques)

    def simulate(kind: IntScalar, push: Float[Array, "2"], plan: control.Reference, qpos: Float[Array, " nq"]) -> Any:
        def cycle(world: World, now: tuple[FloatScalar, control.Reference]) -> tuple[World, tuple[Array, Array]]:
            time, reference = now
            acts = (time >= PUSH_AT) & (time < PUSH_AT + PUSH_S)
            force = jnp.pad(jnp.where(acts, push / PUSH_S, 0.0), (0, 1))
            pushed = simulator.replace(push=force)
            world, _ = pushed.step(world, lambda stages: torque(kind, reference, stages))
            return world, (world.qpos, world.qvel)

        world = simulator.start(qpos, jnp.concatenate([jnp.zeros(6), plan.qvel[0]]))
        # The torque of a step brings about the motion at its end.
        ends = control.Reference(*(x[1:] for x in plan))
        moved = jax.lax.scan(cycle, world, (simulator.step_s * jnp.arange(len(ends.qpos)), ends))[1]
        return tuple(jnp.concatenate([first[None], later]) for first, later in zip(world[:2], moved, strict=True))

    return simulate


def _until_fall(qpos: np.ndarray, qvel: np.ndarray, plan: np.ndarray) -> Path:
    upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    down = (qpos[:, 2] < FALLEN_M) | (upright < np.cos(np.radians(FALLEN_TILT)))
    end = int(np.argmax(down)) if down.any() else len(qpos)
    error = qpos[:end, 7:] - plan[:end]
    return Path(qpos[:end], qvel[:end], error, foot_corners(physics(), qpos[:end]), bool(down.any()))
