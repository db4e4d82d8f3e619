# pyright: reportAttributeAccessIssue=false
"""A live robot in native MuJoCo: pushes, pulls, payload, and ground that tilts below it."""

from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.film import SHOWN_S

MEAN_S = 0.3
"""Time over which measured speeds are averaged, s: a walking body sways."""

TILTING = 10.0
"""Speed at which the ground tilts, degrees/s."""

SHOVE_S = 0.1
"""Length of a push by a key, s."""


class Grab(NamedTuple):
    """A point of the robot that is drawn to a place."""

    body: int
    point: Float[np.ndarray, "3"]
    """In the body's frame, m."""
    to: Float[np.ndarray, "3"]
    """m, world."""


@dataclass
class Hands:
    """Changes that a person makes to all robots and their world. Any thread may set them."""

    friction: float = 1.0
    """Factor on that of the feet on the ground."""
    payload: float = 0.0
    """kg on the torso."""
    slope: float = 0.0
    """Of the ground, degrees, up where the first torso looks at the moment of the change."""
    pace: float = 1.0
    """Seconds of the robot a second."""


WARMSTART = int(mujoco.mjtState.mjSTATE_WARMSTART)
"""The state of native MuJoCo beside positions and velocities."""


class Body:
    """One robot of a stage: MuJoCo's model and data, and what a person does to this robot alone. `rest` is the part of
    MuJoCo's state that goes from one time step to the next beside positions and velocities."""

    def __init__(self, base: mujoco.MjModel, rest: int = WARMSTART):
        self.model, self.data, self.rest = copy(base), mujoco.MjData(base), rest
        self.grab: Grab | None = None
        self.shoves: list[np.ndarray] = []
        """Impulses on the torso that are due, N s, world."""
        self.speeds = np.zeros(3)
        self.ground = np.zeros(3)
        """Height of the ground at the origin, m, and how much it rises for a metre to x and to y."""
        self.time = 0.0
        """Seconds since the episode began."""
        self.ended: float | None = None
        """The stage's `time` at which the episode ended; the robot rests since then."""
        self.ending = ""
        """Words for how the episode ended."""
        self.free = bool((base.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any())
        self.planes = np.flatnonzero(base.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
        self.model.geom_sameframe[self.planes] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turns count nothing
        self._shove, self._until = np.zeros(3), -np.inf
        mujoco.mj_forward(self.model, self.data)
        self.heading, self._begins = self.ahead, False
        """Heading of the torso when the episode began: forward in the picture."""

    def advance(
        self,
        hands: Hands,
        rise: Float[np.ndarray, "2"],
        qpos: Float[np.ndarray, " nq"],
        qvel: Float[np.ndarray, " nv"],
        rest: Float[np.ndarray, " rest"],
        control: Float[np.ndarray, " controls"],
    ) -> tuple[np.ndarray, ...]:
        """Return position above the ground, velocity and `rest` after a time step, and the sensors' readings before it.
        `control` holds the motors' controls, then forces on all degrees of freedom; the ground tilts towards the slope
        `rise` of the picture."""
        model, data = self.model, self.data
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_setState(model, data, rest, self.rest)
        data.ctrl, data.qfrc_applied = control[: model.nu], control[model.nu :]
        if self.free:
            data.qpos[2] += self.height(qpos)
        model.pair_friction[:, :2] *= hands.friction
        model.geom_friction[:, 0] *= hands.friction
        model.body_mass[1] += hands.payload
        model.body_subtreemass[:2] += hands.payload
        self._face()
        self._lay_hands_on(self.turn.T @ rise)
        mujoco.mj_step(model, data)
        sensed = data.sensordata.copy()
        self._measure(model.opt.timestep)
        moved, rest = data.qpos.copy(), np.empty_like(rest)
        mujoco.mj_getState(model, data, rest, self.rest)
        if self.free:
            moved[2] -= self.height(moved)
        return moved, data.qvel.copy(), rest, sensed

    def show(self, qpos: Float[np.ndarray, " nq"], qvel: Float[np.ndarray, " nv"], seconds: float) -> None:
        """Show where another physics has brought the robot in so many seconds."""
        self.data.qpos, self.data.qvel = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        self._face()
        self._measure(seconds)

    @property
    def turn(self) -> Float[np.ndarray, "2 2"]:
        """The turn about the vertical from the robot's world to the picture."""
        x, y = self.heading if self.free else (1.0, 0.0)
        return np.array([[x, y], [-y, x]])

    def _face(self) -> None:
        if self._begins:
            mujoco.mj_kinematics(self.model, self.data)
            self.heading, self._begins = self.ahead, False

    def _measure(self, seconds: float) -> None:
        self.time += seconds
        if self.free:
            (x, y), turn = self.ahead, self.data.xmat[1].reshape(3, 3)[2] @ self.data.qvel[3:6]
            present = np.array([*([[x, y], [-y, x]] @ self.data.qvel[:2]), turn])
            self.speeds += min(seconds / MEAN_S, 1.0) * (present - self.speeds)

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
        self.grab, self.ended, self._until, self.time, self._begins = None, None, -np.inf, 0.0, True
        self.shoves.clear()
        self.speeds[:] = self.ground[:] = 0.0
        self._lay_ground()

    def pressing(self) -> dict[int, tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]]:
        """Return for each body that touches the ground, by index, the centre of pressure, m, and the force on it, N."""
        sums: dict[int, np.ndarray] = {}
        for number in range(self.data.ncon):
            contact, force = self.data.contact[number], np.zeros(6)
            mujoco.mj_contactForce(self.model, self.data, number, force)
            first, second = self.model.geom_bodyid[contact.geom]
            if (first == 0) != (second == 0) and force[0] > 0:
                body, size = int(first or second), np.linalg.norm(force[:3])
                world = contact.frame.reshape(3, 3).T @ force[:3] * (1.0 if second else -1.0)
                sums[body] = np.array([*size * contact.pos, size, *world]) + sums.get(body, 0.0)
        return {body: (each[:3] / each[3], each[4:]) for body, each in sums.items()}

    def height(self, qpos: Float[np.ndarray, " nq"]) -> float:
        """Of the ground below the torso, m."""
        return float(self.ground[0] + self.ground[1:] @ qpos[:2])

    def _lay_hands_on(self, rise: Float[np.ndarray, "2"]) -> None:
        data = self.data
        if self.free and len(self.planes):
            self._tilt(rise)
        if self.shoves and self.time >= self._until:
            self._shove, self._until = self.shoves.pop(0) / SHOVE_S, self.time + SHOVE_S
        if self.time < self._until:
            self._press(1, data.xipos[1], self._shove)
        if grab := self.grab:
            point = data.xpos[grab.body] + data.xmat[grab.body].reshape(3, 3) @ grab.point
            weight = float(self.model.body_mass.sum() * np.linalg.norm(self.model.opt.gravity))
            stiffness = weight / (0.2 * self.model.stat.extent)
            damping = np.sqrt(stiffness * self.model.body_mass.sum())
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_BODY, grab.body, velocity, 0)
            speed = velocity[3:] + np.cross(velocity[:3], point - data.xpos[grab.body])
            force = stiffness * (grab.to - point) - damping * speed
            self._press(grab.body, point, force * min(1.0, 1.5 * weight / max(np.linalg.norm(force), 1e-9)))

    def _press(self, body: int, point: Float[np.ndarray, "3"], force: Float[np.ndarray, "3"]) -> None:
        mujoco.mj_applyFT(self.model, self.data, force, np.zeros(3), point, body, self.data.qfrc_applied)

    def _tilt(self, rise: Float[np.ndarray, "2"]) -> None:
        """Turn the ground about the point below the torso, towards the slope that is wanted."""
        left = rise - self.ground[1:]
        if not left.any():
            return
        most = np.radians(TILTING) * self.model.opt.timestep
        below = self.data.qpos[:2]
        height = self.height(self.data.qpos)
        self.ground[1:] += left * min(1.0, most / float(np.linalg.norm(left)))
        self.ground[0] = height - self.ground[1:] @ below
        self._lay_ground()

    def _lay_ground(self) -> None:
        normal = np.array([*-self.ground[1:], 1.0]) / np.linalg.norm([*self.ground[1:], 1.0])
        self.model.geom_pos[self.planes] = [0.0, 0.0, self.ground[0]]
        for plane in self.planes:
            mujoco.mju_quatZ2Vec(self.model.geom_quat[plane], normal)
