# pyright: reportAttributeAccessIssue=false
"""Motions played on the free lower body on the ground, and what becomes of it.

Balance is judged by zero-moment point and support polygon (sections 4.5 and 4.8). The thesis asks that the point stay
in the polygon of the feet and prints no formula. These are the standard ones (Vukobratovic and Borovac, International
Journal of Humanoid Robotics 1, 2004): the ground must give the wrench that the bodies' weights and accelerations
require, and the zero-moment point is where this wrench has no moment about a level axis. As long as the feet can give
it, the point is the centre of pressure of the contact forces and lies in their convex hull.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float

from humanoid_mjx import compute, control
from humanoid_mjx.evaluation.episode import Motion, stepped
from humanoid_mjx.mechanics import gaits
from humanoid_mjx.physics import make_physics
from humanoid_mjx.physics.base import Stages, World
from humanoid_mjx.report.rendering import draw
from humanoid_mjx.reproduction.findings import Setting
from humanoid_mjx.robot.description import ground_points, lowest
from humanoid_mjx.thesis import leg as thesis
from humanoid_mjx.types import AnyArray, IntScalar

HELD_KP, HELD_KD = 100.0, 1.0
"""Gains of a joint that is held, N m/rad and N m s/rad: more than ten times as stiff as the servo."""

FALLEN_M, FALLEN_TILT = 0.15, 60.0
"""Height of the hips above the ground, m (standing: 0.215), below which the body has fallen, and lean of the torso,
degrees, above which it has."""

AT_ONCE = 64
"""Trials that are simulated together."""

LASTS_S = 0.8
"""Length of the end of a motion in which a turn must last, s: a period of the gaits, in which a body twists and
returns."""

PUSH_S, PUSH_AT = 0.1, 0.5
"""Length of a push and the time at which it begins, s."""

PHASES = ("half a period later", "equal", "opposite")
"""Readings of the left leg's motion: chapter 4 says that both legs have equal positions, section 6.4 that the left has
opposite ones; walking takes turns."""


class Trial(NamedTuple):
    """A motion for one body, and its controller."""

    controller: str
    """One of `laws_of`."""
    motion: str = "stand"
    """`stand`, or the name of a gait."""
    push: tuple[float, float] = (0.0, 0.0)
    """Impulse on the hips, forwards and to the left, N s."""
    signs: tuple[int, int, int] = (1, 1, 1)
    """Signs of hip pitch, knee and ankle: 1 takes the gait's angles as printed, in the senses of `lower_body`, where a
    positive knee swings the shank back and a positive ankle turns the toes down; -1 takes the other sense."""
    same_yaw: bool = False
    """True if both legs yaw in the same sense, to the right, instead of both toes outwards."""
    phase: str = "half a period later"
    """One of `PHASES`: what the left leg does beside the right one."""


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
    def seconds(self) -> float:
        """Duration until the fall or the end, s."""
        return round(physics().step_s * (len(self.qpos) - 1), 3)

    def fate(self, otherwise: str) -> str:
        """The end of the motion in words, `otherwise` where it is no fall."""
        return f"falls after {self.seconds:g} s" if self.fell else otherwise

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
    def turned(self) -> Float[np.ndarray, " times"]:
        """Turn of the torso about the vertical, to the left, degrees: the twist of its rotation, however it leans."""
        yaw = np.unwrap(2 * np.arctan2(self.qpos[:, 6], self.qpos[:, 3]))
        return np.degrees(yaw - yaw[0])

    @property
    def lasting_turn(self) -> float:
        """The turn of the torso that lasts, degrees: the least of the last `LASTS_S`, 0 where it turns back."""
        late = self.turned[-round(LASTS_S / physics().step_s) :]
        return float(late[np.abs(late).argmin()]) if (np.sign(late) == np.sign(late[0])).all() else 0.0


@cache
def physics() -> Any:
    """The lower body, with the human ranges of Table 3.2: the gaits leave the proposed ones."""
    return make_physics("tree", robot={"ranges": "human"})


def play(
    trials: Sequence[Trial],
    seconds: float,
    config: Mapping[str, Mapping[str, float]],
    tell: Callable[[str], None] = lambda words: None,
) -> dict[Trial, Path]:
    """Simulate trials without repetition, some at once, for a multiple of the time step, under the laws of a config
    (`laws_of`); `tell` is called with the progress in words.

    Raises:
      InputError: an unknown gait, or gains that no controller takes.
    """
    laws, paths = laws_of(config), {}
    for first in range(0, len(trials), AT_ONCE):
        part = trials[first : first + AT_ONCE]
        tell(f"{first:,} of {len(trials):,} bodies simulated")
        plans = [_plan(trial, seconds) for trial in part]
        bodies = [
            (list(laws).index(trial.controller), np.array(trial.push), plan, standing(plan.qpos[0]))
            for trial, plan in zip(part, plans, strict=True)
        ]
        # As many in every call, so that one program serves them all: the last trial fills the rest.
        bodies += [bodies[-1]] * (AT_ONCE - len(part))
        states = _program()(list(laws.values()), *jax.tree.map(lambda *x: jnp.stack(x), *bodies))
        found = zip(part, *(np.asarray(x, np.float64) for x in states), plans, strict=False)
        paths |= {trial: _until_fall(qpos, qvel, np.asarray(plan.qpos)) for trial, qpos, qvel, plan in found}
    return paths


def laws_of(config: Mapping[str, Mapping[str, float]]) -> dict[str, control.Law]:
    """Return the law of each controller, which acts anew at every time step.

    `servo` is plain; `computed torque` keeps within the contacts (`control.ground`); that of `section 5.7` has the
    gains of Table 5.1, ignores contacts and treats the torso as fixed. In `servo, rolls held` the servo acts on a body
    as if without hip rolls: they are held where they are. The config has under `servo` the stiffness and damping of
    every servo, under `computed_torque` the other gains of the law `grounded`.

    Raises:
      InputError: a gain that no law takes.
    """
    servo = control.make_law("pd", **config["servo"])
    kp, kd = (np.tile(gains, 2) for gains in (thesis.KP, thesis.KD))
    printed = {"natural_frequency": np.sqrt(kp), "damping_ratio": kd / (2 * np.sqrt(kp))}
    roll = np.tile(np.array(thesis.JOINT_NAMES) == "hip_roll", 2)
    held = {"stiffness": np.where(roll, HELD_KP, servo.stiffness), "damping": np.where(roll, HELD_KD, servo.damping)}
    return {
        "servo": servo,
        "computed torque": control.make_law("grounded", **config["servo"], **config["computed_torque"]),
        "section 5.7": control.make_law("computed_torque").replace(**printed),
        "servo, rolls held": servo.replace(**held),
    }


def balanced(path: Path) -> Bool[np.ndarray, " steps"]:
    """True where the zero-moment point is inside the support polygon, at each time step but the last."""
    qacc = np.diff(path.qvel, axis=0) / physics().step_s
    wrench = ground_wrench(physics().model, path.qpos[:-1], path.qvel[:-1], qacc)
    return inside_support(zero_moment_point(*wrench), path.corners[:-1, :, :2], path.touching[:-1])


def _plan(trial: Trial, seconds: float) -> control.Reference:
    """The motion of the joints at each time step, (steps + 1, 10)."""
    times = physics().step_s * jnp.arange(physics().substeps(seconds) + 1)
    if trial.motion == "stand":
        return control.Reference(*jnp.zeros((3, len(times), 10)))
    motion = _played(gaits.gait(trial.motion), times, trial.phase)
    hip, knee, ankle = trial.signs
    leg = np.array([hip, 1, 1, knee, ankle])
    signs = np.stack([leg, leg * ([1, -1, 1, 1, 1] if trial.same_yaw else 1)])
    return control.Reference(*((signs * x).reshape(len(times), 10) for x in motion))


@partial(jax.jit, static_argnames="phase")
def _played(gait: gaits.Gait, times: Float[Array, " times"], phase: str) -> Any:
    """The motion of both legs, (times, 2, 5) each."""
    if phase == "half a period later":
        return jax.vmap(gait.both_legs)(times)
    left = 1.0 if phase == "equal" else -1.0
    return jax.tree.map(lambda x: jnp.stack([x, left * x], axis=1), jax.vmap(gait.at)(times))


def standing(joints: Float[AnyArray, " joints"]) -> Float[np.ndarray, " nq"]:
    """`qpos` of an upright body in a posture of the joints, the lowest corner of its feet on the ground."""
    qpos = np.concatenate([physics().qpos0[:7], joints])
    qpos[2] -= foot_corners(qpos[None])[0, :, 2].min()
    return qpos


def draw_bodies(setting: Setting, title: str, rows: Sequence[Any], size: tuple[float, float]) -> None:
    """Draw a panel for each body, rows of words and `qpos`, of a size in inches."""
    pictures = iter(draw(physics().model, np.array([qpos for row in rows for _, qpos in row])))
    title = f"{title}\nRight leg blue, left leg orange"
    with setting.figure(len(rows), max(map(len, rows)), size=size, title=title) as (_, axes):
        for panel in axes.flat:
            panel.set_axis_off()
        for row, panels in zip(rows, axes, strict=True):
            for (words, _), panel in zip(row, panels, strict=False):
                panel.imshow(next(pictures))
                panel.set_title(words, loc="center", fontsize=8.5)


@cache
def _program() -> Any:
    """From the laws and, by trial, the number of its law, push, plan and start, to the states, (trials, steps + 1, ...)
    each."""
    simulator = physics()

    def simulate(
        laws: Sequence[control.Law],
        number: IntScalar,
        push: Float[Array, "2"],
        plan: control.Reference,
        qpos: Float[Array, " nq"],
    ) -> Any:
        def cycle(world: World, now: tuple[Array, control.Reference]) -> tuple[World, Motion]:
            force, reference = now

            # All laws at once: under vmap a branch computes all as well, and the compiling of the robot takes longer.
            def torque(stages: Stages) -> Float[Array, " joints"]:
                chosen = [number == index for index in range(len(laws))]
                return jnp.select(chosen, [law(reference, stages) for law in laws])

            return stepped(simulator.replace(push=force), world, torque)

        world = simulator.start(qpos, jnp.concatenate([jnp.zeros(6), plan.qvel[0]]))
        # The torque of a step brings about the motion at its end.
        ends = control.Reference(*(x[1:] for x in plan))
        times = simulator.step_s * jnp.arange(len(ends.qpos))
        acts = (times >= PUSH_AT) & (times < PUSH_AT + PUSH_S)
        forces = jnp.where(acts[:, None], jnp.pad(push, (0, 1)) / PUSH_S, 0.0)
        moved = jax.lax.scan(cycle, world, (forces, ends))[1]
        return jnp.vstack([world.qpos, moved.qpos]), jnp.vstack([world.qvel, moved.qvel])

    every = jax.vmap(simulate, in_axes=(None, 0, 0, 0, 0))
    return jax.jit(every, compiler_options=compute.compiler_options("tree"))


def _until_fall(qpos: np.ndarray, qvel: np.ndarray, plan: np.ndarray) -> Path:
    upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
    down = (qpos[:, 2] < FALLEN_M) | (upright < np.cos(np.radians(FALLEN_TILT)))
    end = int(np.argmax(down)) if down.any() else len(qpos)
    error = qpos[:end, 7:] - plan[:end]
    return Path(qpos[:end], qvel[:end], error, foot_corners(qpos[:end]), bool(down.any()))


def ground_wrench(
    model: mujoco.MjModel,
    qpos: Float[AnyArray, "times nq"],
    qvel: Float[AnyArray, "times nv"],
    qacc: Float[AnyArray, "times nv"],
) -> tuple[Float[np.ndarray, "times 3"], Float[np.ndarray, "times 3"]]:
    """Return the force, N, and the moment about the world's origin, N m, that the motion of a body with a free torso
    needs from the ground.

    It is what inverse dynamics leaves to the six degrees of freedom that no motor drives. Where only the ground pushes,
    it is the ground's wrench.
    """
    data, needed = mujoco.MjData(model), np.empty(model.nv)
    force, moment = np.empty((2, len(qpos), 3))
    for t in range(len(qpos)):
        data.qpos, data.qvel, data.qacc = qpos[t], qvel[t], qacc[t]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_rne(model, data, 1, needed)
        force[t] = needed[:3]
        mujoco.mju_rotVecQuat(moment[t], needed[3:6], data.qpos[3:7])
        moment[t] += np.cross(data.qpos[:3], force[t])
    return force, moment


def zero_moment_point(force: Float[np.ndarray, "times 3"], moment: Float[np.ndarray, "times 3"]) -> np.ndarray:
    """Return the points on the plane z = 0 at which a wrench has no moment about x and y, (times, 2), m: of a force, N,
    and a moment about the world's origin, N m. NaN where the force does not push the ground, as in flight."""
    up = np.where(force[:, 2:] > 0, force[:, 2:], np.nan)
    return np.stack([-moment[:, 1], moment[:, 0]], axis=1) / up


def inside_support(
    point: Float[np.ndarray, "*times 2"],
    corners: Float[np.ndarray, "*times corners 2"],
    touching: Bool[np.ndarray, "*times corners"],
) -> Bool[np.ndarray, "*times"]:
    """Return whether a point is inside the support polygon, the convex hull of the corners that touch: seen from it
    they lie on all sides, no two neighbours half a turn or more apart. An edge and a corner have no inside."""
    x, y = np.moveaxis(corners - point[..., None, :], -1, 0)
    side = np.sort(np.where(touching, np.arctan2(y, x), np.nan), axis=-1)  # NaN at the end
    following = np.concatenate([side[..., 1:], np.full_like(side[..., :1], np.nan)], axis=-1)
    following = np.where(np.isnan(following), side[..., :1] + 2 * np.pi, following)
    gap = np.nan_to_num(following - side, nan=-np.inf).max(axis=-1)
    return (gap > 0) & (gap < np.pi - 1e-9)


def foot_corners(qpos: Float[AnyArray, "times nq"]) -> Float[np.ndarray, "times corners 3"]:
    """The lowest points of the feet's corners in recorded postures, m, outside jax; where z <= 0 they touch."""
    model, (balls, _) = physics().model, ground_points(physics().model)
    data, found = mujoco.MjData(model), np.empty((len(qpos), len(balls), 3))
    for row, posture in zip(found, qpos, strict=True):
        data.qpos = posture
        mujoco.mj_kinematics(model, data)
        row[:] = lowest(model, data.geom_xpos[balls])
    return found
