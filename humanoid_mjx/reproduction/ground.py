"""Motions played on the free lower body on the ground, and what becomes of it."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as P
from jaxtyping import Array, Bool, Float

from humanoid_mjx import control, runtime
from humanoid_mjx.mechanics import balance, gaits, pattern_generator
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.balance import accelerations, foot_corners, link_motion
from humanoid_mjx.physics.base import World
from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import AnyArray, FloatScalar, IntScalar

CONTROLLERS = ("servo", "computed torque", "section 5.7")
"""A plain servo; computed torque within the contacts (`control.ground`); computed torque with the gains of Table 5.1,
which ignores contacts and treats the torso as fixed. Each acts anew at every time step."""

ROLL_HELD = "servo, rolls held"
"""The servo on a body as if without hip rolls: they are held where they are."""

LAWS = (*CONTROLLERS, ROLL_HELD)

HELD_KP, HELD_KD = 100.0, 1.0
"""Gains of a joint that is held, N m/rad and N m s/rad: more than ten times as stiff as the servo."""

FALLEN_M, FALLEN_TILT = 0.15, 60.0
"""Height of the hips above the ground, m (standing: 0.215), below which the body has fallen, and lean of the torso,
degrees, above which it has."""

AT_ONCE = 64
"""Trials that are simulated together."""

ROUND = 256
"""The balance of a path is computed for a multiple of so many steps."""

PUSH_S, PUSH_AT = 0.1, 0.5
"""Length of a push and the time at which it begins, s."""


class Trial(NamedTuple):
    """What one body is to do, and under which controller."""

    controller: str
    """One of `CONTROLLERS`, or `ROLL_HELD`."""
    motion: str = "stand"
    """`stand`, or the name of a gait."""
    frequency: float | None = None
    """Frequency of the pattern generator, Hz, which starts in the gait's mean posture; None plays the table as
    printed."""
    amplitude: float = 1.0
    """Amplitude of the pattern generator; 1 is that of the table."""
    push: tuple[float, float] = (0.0, 0.0)
    """Impulse on the hips, forwards and to the left, N s."""
    signs: tuple[int, int, int] = (1, 1, 1)
    """Signs of hip pitch, knee and ankle: 1 takes the gait's angles as printed, in the senses of `lower_body`, where a
    positive knee swings the shank back and a positive ankle turns the toes down; -1 takes the other sense."""
    same_yaw: bool = False
    """Whether both legs yaw in the same sense, to the right, instead of both toes outwards."""


class Path(NamedTuple):
    """The recorded motion of one body, up to its fall."""

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
        """Duration until the fall or the end, s."""
        return round(float(self.times[-1]), 3)

    @property
    def touching(self) -> Bool[np.ndarray, "times corners"]:
        return self.corners[..., 2] <= 0.0

    @property
    def distance(self) -> float:
        """Distance that the middle between the feet moved forwards, m. The torso is no measure, as it also moves in a
        fall."""
        middle = self.corners[..., 0].mean(axis=1)
        return float(middle[-1] - middle[0])

    @property
    def turn(self) -> float:
        """Turn of the torso about the vertical, to the left, degrees: the twist of its rotation, however it leans."""
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
    """Balance along a path, at each time step but the last."""

    center: Float[AnyArray, "steps 3"]
    """Position of the centre of mass, m."""
    point: Float[AnyArray, "steps 2"]
    """The zero-moment point, m; NaN in flight."""
    margin: Float[AnyArray, " steps"]
    """Margin of the zero-moment point in the support polygon, m; infinite in flight. An edge has no inside: 0 at
    most."""
    center_margin: Float[AnyArray, " steps"]
    """Margin of the point below the centre of mass, m."""


@cache
def physics() -> Any:
    """MJX with the lower body, the human ranges of Table 3.2: the gaits leave the proposed ones."""
    return make_physics("mjx-jax", ranges="human")


def play(
    trials: Sequence[Trial],
    seconds: float,
    config: Mapping[str, Mapping[str, float]],
    tell: Callable[[str], None] = lambda words: None,
) -> dict[Trial, Path]:
    """Simulate trials, some at once.

    Args:
      trials: trials without repetition.
      seconds: duration, a multiple of the time step.
      config: under `servo` the kp and kd of `control.PD`, under `computed_torque` the kp, kd and share of
        `control.GroundControl`, whose servo is the first.
      tell: called with the progress in words.

    Raises:
      InputError: an unknown gait, or gains that no controller takes.
    """
    program, gains, paths = _program(), _gains(config), {}
    for first in range(0, len(trials), AT_ONCE):
        part = list(trials[first : first + AT_ONCE])
        tell(f"{first:,} of {len(trials):,} bodies simulated")
        plans = [_plan(trial, seconds) for trial in part]
        start = [_start(np.asarray(plan.qpos[0], np.float64)) for plan in plans]
        kinds, pushes = [LAWS.index(trial.controller) for trial in part], [trial.push for trial in part]
        # As many in every call, so that one program serves them all: the last trial fills the rest.
        rows = np.minimum(np.arange(AT_ONCE), len(part) - 1)
        wanted = control.Reference(*(jnp.stack(x)[rows] for x in zip(*plans, strict=True)))
        kinds, pushes, start = (
            jnp.asarray(np.asarray(x)[rows], t) for x, t in ((kinds, int), (pushes, float), (start, float))
        )
        states = (np.asarray(x, np.float64) for x in program(gains, kinds, pushes, wanted, start))
        found = zip(part, *states, (np.asarray(plan.qpos) for plan in plans), strict=False)
        paths |= {trial: _until_fall(*rest) for trial, *rest in found}
    return paths


def balance_of(path: Path) -> Balance:
    """Centre of mass, zero-moment point and its margin."""
    qacc = accelerations(path.qvel, physics().step_s)
    links = link_motion(physics().model, path.qpos[:-1], path.qvel[:-1], qacc)
    # The last row fills up to a round number, so that paths that end anywhere share few programs.
    steps = len(qacc)
    rows = np.minimum(np.arange(-(-steps // ROUND) * ROUND), steps - 1)
    given = (*links, path.corners[:-1, :, :2], path.touching[:-1])
    found = _balance(*(np.asarray(x)[rows] for x in given))
    return Balance(*(np.asarray(x, np.float64)[:steps] for x in found))


@jax.jit
def _balance(*given: Array) -> Balance:
    """From the fields of `balance.LinkMotion`, the corners and whether they touch, (steps, ...) each."""
    links, corners, touching = balance.LinkMotion(*given[:-2]), *given[-2:]
    point = balance.zero_moment_point(*balance.ground_wrench(links))
    center = balance.center_of_mass(links.mass, links.position)
    margin = jax.vmap(balance.support_margin)
    return Balance(center, point, margin(point, corners, touching), margin(center[:, :2], corners, touching))


def _plan(trial: Trial, seconds: float) -> control.Reference:
    """The motion of the joints at each time step, (steps + 1, 10)."""
    times = physics().step_s * jnp.arange(physics().substeps(seconds) + 1)
    if trial.motion == "stand":
        return control.Reference(*jnp.zeros((3, len(times), 10)))
    gait = gaits.gait(trial.motion)
    if trial.frequency is None:
        motion = _played(gait, times)
    else:
        motion = _generated(pattern_generator.pattern_generator(gait, trial.frequency, trial.amplitude), times)
    hip, knee, ankle = trial.signs
    leg = np.array([hip, 1, 1, knee, ankle])
    signs = np.stack([leg, leg * ([1, -1, 1, 1, 1] if trial.same_yaw else 1)])
    return control.Reference(*((signs * x).reshape(len(times), 10) for x in motion))


_played = jax.jit(jax.vmap(gaits.Gait.both_legs, in_axes=(None, 0)))


@jax.jit
def _generated(params: pattern_generator.Params, times: Float[Array, " times"]) -> Any:
    begin = pattern_generator.init(params)
    return jax.vmap(lambda time: pattern_generator.step(params, begin, time)[1])(times)


def _start(joints: Float[np.ndarray, " joints"]) -> Float[np.ndarray, " nq"]:
    """Upright in a posture of the joints, the lowest corner of the feet on the ground."""
    qpos = np.concatenate([physics().qpos0[:7], joints])
    qpos[2] -= foot_corners(physics(), qpos[None])[0, :, 2].min()
    return qpos


class _Gains(NamedTuple):
    """Gains of the controllers."""

    servo: control.PD
    grounded: control.GroundControl
    kp: Float[Array, " joints"]
    kd: Float[Array, " joints"]
    held: control.PD
    """The servo's, but for the hips' rolls."""


def _gains(config: Mapping[str, Mapping[str, float]]) -> _Gains:
    servo = {f"servo_{name}": gain for name, gain in config["servo"].items()}
    kp, kd = (jnp.tile(jnp.array(gains), 2) for gains in (thesis.KP, thesis.KD))
    grounded = control.GroundControl.build(10, **config["computed_torque"], **servo)
    roll = np.tile(np.array(thesis.JOINT_NAMES) == "hip_roll", 2)
    held = {"kp": np.where(roll, HELD_KP, config["servo"]["kp"]), "kd": np.where(roll, HELD_KD, config["servo"]["kd"])}
    return _Gains(control.PD.build(10, **config["servo"]), grounded, kp, kd, control.PD.build(10, **held))


@cache
def _program() -> Any:
    """From gains and, by trial, controller, push, plan and start, to the states, (trials, steps + 1, ...) each."""
    simulator = physics()

    def torque(gains: _Gains, kind: IntScalar, reference: control.Reference, stages: Any) -> Float[Array, " joints"]:
        state = reference, stages.qpos, stages.qvel
        torques = (
            control.pd(gains.servo, *state),
            control.grounded_torque(gains.grounded, *state, stages.mass_matrix, stages.bias, stages.contacts()),
            stages.torque_for(control.servo(gains.kp, gains.kd, *state), 1.0),
            control.pd(gains.held, *state),
        )
        return jnp.select([kind == index for index in range(len(LAWS))], torques)

    def simulate(
        gains: _Gains, kind: IntScalar, push: Float[Array, "2"], plan: control.Reference, qpos: Float[Array, " nq"]
    ) -> Any:
        def cycle(world: World, now: tuple[FloatScalar, control.Reference]) -> tuple[World, tuple[Array, Array]]:
            time, reference = now
            acts = (time >= PUSH_AT) & (time < PUSH_AT + PUSH_S)
            force = jnp.pad(jnp.where(acts, push / PUSH_S, 0.0), (0, 1))
            pushed = simulator.replace(push=force)
            world, _ = pushed.step(world, lambda stages: torque(gains, kind, reference, stages))
            return world, (world.qpos, world.qvel)

        world = simulator.start(qpos, jnp.concatenate([jnp.zeros(6), plan.qvel[0]]))
        # The torque of a step brings about the motion at its end.
        ends = control.Reference(*(x[1:] for x in plan))
        moved = jax.lax.scan(cycle, world, (simulator.step_s * jnp.arange(len(ends.qpos)), ends))[1]
        return tuple(jnp.concatenate([first[None], later]) for first, later in zip(world[:2], moved, strict=True))

    # Each device its share: XLA itself would gather what MJX solves.
    devices = jax.local_devices()
    mesh = Mesh(np.array(devices if AT_ONCE % len(devices) == 0 else devices[:1]), ("bodies",))
    share = P("bodies")
    every = jax.vmap(simulate, in_axes=(None, 0, 0, 0, 0))
    spread = jax.shard_map(every, mesh=mesh, in_specs=(P(), *[share] * 4), out_specs=share, check_vma=False)
    return jax.jit(spread, compiler_options=runtime.no_library())


def _until_fall(qpos: np.ndarray, qvel: np.ndarray, plan: np.ndarray) -> Path:
    upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    down = (qpos[:, 2] < FALLEN_M) | (upright < np.cos(np.radians(FALLEN_TILT)))
    end = int(np.argmax(down)) if down.any() else len(qpos)
    error = qpos[:end, 7:] - plan[:end]
    return Path(qpos[:end], qvel[:end], error, foot_corners(physics(), qpos[:end]), bool(down.any()))
