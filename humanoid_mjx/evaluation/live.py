# pyright: reportAttributeAccessIssue=false
"""A live robot: it moves in native MuJoCo in real time, while another thread steers, pushes and changes its world."""

import threading
import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.episode import begun, decided, own_data, robot_of, single, world_of
from humanoid_mjx.evaluation.film import SHOWN_S
from humanoid_mjx.evaluation.policy import Trained, on_physics, on_plane
from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.native import Native
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.continuous import State
from humanoid_mjx.types import IntScalar

FRAME_S = 1 / 40
"""Between two frames that are shown, s."""

LATEST_S = 0.25
"""A machine that is slower than the robot by more than this does not catch up: the robot moves in slow motion."""

MEAN_S = 0.3
"""Over which measured speeds are averaged, s: a walking body sways."""

TILTING = 10.0
"""How fast the ground tilts, degrees/s."""

SHOVE_S = 0.1
"""Length of a push by a key, s."""

SPEEDS = "forward, m/s", "left, m/s", "turn left, rad/s"
"""The measured speeds of a free torso, as `Task.told` calls commands."""


class Grab(NamedTuple):
    """A point of the robot that is drawn to a place."""

    body: int
    point: Float[np.ndarray, "3"]
    """In the body's frame, m."""
    to: Float[np.ndarray, "3"]
    """m, world."""


@dataclass
class Hands:
    """Changes that a person makes to the robot and its world. Any thread may set them."""

    friction: float = 1.0
    """Factor on that of the feet on the ground."""
    payload: float = 0.0
    """kg on the torso."""
    slope: float = 0.0
    """Of the ground, degrees, up where the torso looks at the moment of the change."""
    pace: float = 1.0
    """Seconds of the robot a second."""
    grab: Grab | None = None
    shoves: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Impulses on the torso that are due, N s, world."""


class Stage:
    """The one world of a live robot: MuJoCo's model and data, the hands on it, and the clock."""

    def __init__(self, base: mujoco.MjModel):
        self.model, self.data = copy(base), mujoco.MjData(base)
        self.hands = Hands()
        self.time = 0.0
        self.speeds = np.zeros(3)
        self.ground = np.zeros(3)
        """Height of the ground at the origin, m, and how much it rises for a metre to x and to y."""
        self.shown: Callable[[], None] = lambda: None
        """Called for each frame."""
        self.free = bool((base.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())
        self.planes = np.flatnonzero(base.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        self.model.geom_sameframe[self.planes] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turns count nothing
        self._wanted, self._rise = 0.0, np.zeros(2)
        self._shove, self._until = np.zeros(3), -np.inf
        self._zero, self._next = time.monotonic(), 0.0
        mujoco.mj_forward(self.model, self.data)

    @property
    def weight(self) -> float:
        """N"""
        return float(self.model.body_mass.sum() * np.linalg.norm(self.model.opt.gravity))

    def advance(
        self,
        qpos: Float[np.ndarray, " nq"],
        qvel: Float[np.ndarray, " nv"],
        warmstart: Float[np.ndarray, " nv"],
        control: Float[np.ndarray, " controls"],
    ) -> tuple[np.ndarray, ...]:
        """Return position above the ground, velocity and acceleration after a time step, and the sensors' readings
        before it. `control` holds the torques of the motors, then forces on all degrees of freedom."""
        model, data = self.model, self.data
        data.qpos, data.qvel, data.qacc_warmstart = qpos, qvel, warmstart
        data.ctrl, data.qfrc_applied = control[: model.nu], control[model.nu :]
        if self.free:
            data.qpos[2] += self._height(qpos)
        model.pair_friction[:, :2] *= self.hands.friction
        model.body_mass[1] += self.hands.payload
        model.body_subtreemass[:2] += self.hands.payload
        self._lay_hands_on()
        mujoco.mj_step(model, data)
        sensed = data.sensordata.copy()
        self.wait()
        moved = data.qpos.copy()
        if self.free:
            moved[2] -= self._height(moved)
        return moved, data.qvel.copy(), data.qacc.copy(), sensed

    def show(self, qpos: Float[np.ndarray, " nq"], qvel: Float[np.ndarray, " nv"], seconds: float) -> None:
        """Show where another physics has brought the robot in so many seconds."""
        self.data.qpos, self.data.qvel = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        self.wait(seconds)

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the present moment of the robot has come, and show it where a frame is due."""
        seconds = self.model.opt.timestep if seconds is None else seconds
        self.time += seconds
        self._zero += seconds * (1.0 - 1.0 / self.hands.pace)
        if self.free:
            (x, y), turn = self.ahead, self.data.xmat[1].reshape(3, 3)[2] @ self.data.qvel[3:6]
            present = np.array([*([[x, y], [-y, x]] @ self.data.qvel[:2]), turn])
            self.speeds += min(seconds / MEAN_S, 1.0) * (present - self.speeds)
        ahead = self.time - (time.monotonic() - self._zero)
        if ahead < -LATEST_S:
            self._zero -= ahead
        if self.time >= self._next:
            self._next = max(self._next + FRAME_S, self.time)
            self.shown()
        if ahead > 1e-3:
            time.sleep(ahead)

    @property
    def shoved(self) -> Float[np.ndarray, "3"] | None:
        """The impulse of a push by a key, N s, so long as it is to be seen."""
        return SHOVE_S * self._shove if self.time < self._until - SHOVE_S + SHOWN_S else None

    @property
    def ahead(self) -> Float[np.ndarray, "2"]:
        """The horizontal direction in which the torso looks."""
        ahead = self.data.xmat[1].reshape(3, 3)[:2, 0]
        return ahead / max(float(np.linalg.norm(ahead)), 1e-9)

    def forget(self) -> None:
        """Begin an episode on ground that is level still, with nothing in hand."""
        self.hands.grab, self._until = None, -np.inf
        self.hands.shoves.clear()
        for each in (self.speeds, self.ground, self._rise):
            each[:] = 0.0
        self._wanted = 0.0
        self._lay_ground()

    def pressing(self) -> dict[int, tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
        """By the number of each body that touches the ground: where, m, and with which force on it, N."""
        found: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
        for number in range(self.data.ncon):
            contact, force = self.data.contact[number], np.zeros(6)
            mujoco.mj_contactForce(self.model, self.data, number, force)
            first, second = self.model.geom_bodyid[contact.geom]
            if (first == 0) != (second == 0) and force[0] > 0:
                world = contact.frame.reshape(3, 3).T @ force[:3] * (1.0 if second else -1.0)
                found.setdefault(int(first or second), []).append((contact.pos.copy(), world))
        means = {}
        for body, each in found.items():
            places, forces = (np.array(parts) for parts in zip(*each, strict=True))
            sizes = np.linalg.norm(forces, axis=1)
            means[body] = (sizes @ places / sizes.sum(), forces.sum(axis=0))
        return means

    def _height(self, qpos: Float[np.ndarray, " nq"]) -> float:
        """Of the ground below the torso, m."""
        return float(self.ground[0] + self.ground[1:] @ qpos[:2])

    def _lay_hands_on(self) -> None:
        data, hands = self.data, self.hands
        if self.free and len(self.planes):
            self._tilt()
        if hands.shoves and self.time >= self._until:
            self._shove, self._until = hands.shoves.pop(0) / SHOVE_S, self.time + SHOVE_S
        if self.time < self._until:
            self._press(1, data.xipos[1], self._shove)
        if grab := hands.grab:
            point = data.xpos[grab.body] + data.xmat[grab.body].reshape(3, 3) @ grab.point
            stiffness = self.weight / (0.2 * self.model.stat.extent)
            damping = np.sqrt(stiffness * self.model.body_mass.sum())
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_BODY, grab.body, velocity, 0)
            speed = velocity[3:] + np.cross(velocity[:3], point - data.xpos[grab.body])
            force = stiffness * (grab.to - point) - damping * speed
            self._press(grab.body, point, force * min(1.0, 1.5 * self.weight / max(np.linalg.norm(force), 1e-9)))

    def _press(self, body: int, point: Float[np.ndarray, "3"], force: Float[np.ndarray, "3"]) -> None:
        mujoco.mj_applyFT(self.model, self.data, force, np.zeros(3), point, body, self.data.qfrc_applied)

    def _tilt(self) -> None:
        """Turn the ground about the point below the torso, towards the slope that is wanted."""
        if self.hands.slope != self._wanted:
            self._wanted = self.hands.slope
            self._rise = np.tan(np.radians(self._wanted)) * self.ahead
        left = self._rise - self.ground[1:]
        if not left.any():
            return
        most = np.radians(TILTING) * self.model.opt.timestep
        below = self.data.qpos[:2]
        height = self._height(self.data.qpos)
        self.ground[1:] += left * min(1.0, most / float(np.linalg.norm(left)))
        self.ground[0] = height - self.ground[1:] @ below
        self._lay_ground()

    def _lay_ground(self) -> None:
        normal = np.array([*-self.ground[1:], 1.0]) / np.linalg.norm([*self.ground[1:], 1.0])
        self.model.geom_pos[self.planes] = [0.0, 0.0, self.ground[0]]
        for plane in self.planes:
            mujoco.mju_quatZ2Vec(self.model.geom_quat[plane], normal)


class LiveMujoco(Native):
    """Native MuJoCo for one world on a `Stage`."""

    @property
    def stage(self) -> Stage:
        """Where this robot moves; there is one of each robot."""
        return _stage(self._team.base)

    def _advance(self, sensed: bool, values: Any, *state: Any) -> tuple[np.ndarray, ...]:
        stage = self.stage
        self._team._tune(stage.model, values[0])  # pyright: ignore[reportPrivateUsage]
        *moved, read = stage.advance(*(rows[0] for rows in state))
        return *(each[None] for each in moved), read[None, : len(read) * sensed]


@lru_cache
def _stage(base: mujoco.MjModel) -> Stage:
    return Stage(base)


class Live:
    """A policy that plays without an end. `run` moves the robot in its own thread; any other may set what it reads."""

    def __init__(self, trained: Trained, episode: int = 0):
        """Take a policy's task to a stage.

        Raises:
          InputError: the task moves no robot.
        """
        robot_of(trained)
        self.touchable = True
        try:
            trained = on_physics(on_plane(trained), f"{__name__}:{LiveMujoco.__name__}")
        except InputError:  # a task with a physics of its own is shown and steered, but nobody can touch it
            self.touchable = False
        task: Any = trained.learner.task.for_driving()
        self.trained, self.task = trained, task
        self.learner: Learner = trained.learner.replace(task=task)
        self.model = robot_of(trained)
        self.stage: Stage = task.simulator.stage if self.touchable else Stage(self.model)
        self.ranges: dict[str, tuple[float, float]] = task.told_ranges
        self.told = dict.fromkeys(self.ranges, 0.0)
        """The command that the robot is to follow."""
        self.feet: tuple[str, ...] = getattr(getattr(task, "robot", None), "feet", ()) if self.touchable else ()
        """Bodies whose load is shown."""
        self.rewards: dict[str, float] = {}
        """Of the last decision, by the names of the reward's terms."""
        self.words, self.ready = "compiling", False
        self.episode = episode
        self.again = threading.Event()
        """Set: begin `episode` anew."""
        self.going = threading.Event()
        """Cleared: wait."""
        self.over = False
        self.going.set()

    def stop(self) -> None:
        """Let `run` return."""
        self.over = True
        self.again.set()
        self.going.set()

    def run(self) -> None:
        """Move the robot until `stop`, or until the thread is interrupted."""
        number = jnp.int32(self.episode)
        state, steps = single(begun)(self.learner, number), 0
        state = self._decide(number, state, steps)  # compiles
        self.ready = True
        while not self.over:
            self.again.clear()
            self.stage.forget()
            number, steps = jnp.int32(self.episode), 0
            state, self.words = single(begun)(self.learner, number), ""
            while not self.again.is_set() and not state.done:
                self.going.wait()
                state, steps = self._decide(number, state, steps), steps + 1
            if not self.again.is_set():
                ended = "reached its aim" if bool(state.success) else "fell" if self.ranges else "did not reach its aim"
                self.words = f"The robot {ended}; the next episode follows."
                self.stage.shown()
                self.again.wait(1.5)
                self.episode += not self.again.is_set()

    def _decide(self, number: IntScalar, state: State, steps: int) -> State:
        told = {name: jnp.float32(self.told[name]) for name in self.ranges}
        state = single(decided)(self.learner, self.trained.policy, number, state, jnp.int32(steps), told)[0]
        found = jax.device_get({"reward": state.reward} | state.metrics)
        self.rewards = {name: float(value) for name, value in found.items()}
        if not self.touchable:
            world = jax.device_get(world_of(own_data(self.task, state)))
            self.stage.show(world.qpos, world.qvel, self.task.period)
        return state
