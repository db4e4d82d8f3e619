"""Live robots: they move in native MuJoCo in real time, while another thread steers, pushes and changes their world."""

import threading
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.episode import begun, decided, own_data, robot_of, single, world_of
from humanoid_mjx.evaluation.live.body import Grab as Grab
from humanoid_mjx.evaluation.live.stage import LiveMujoco, LiveUnmodified, Stage
from humanoid_mjx.evaluation.policy import UNMODIFIED, StoredPolicy, in_world, on_plane
from humanoid_mjx.evaluation.rest import AtRest, Posed
from humanoid_mjx.learners import Learner
from humanoid_mjx.physics.base import where
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.continuous import State

REST_S = 1.5
"""Rest of a robot that fell before the next episode, s."""

SPEEDS = "forward, m/s", "left, m/s", "turn left, rad/s"
"""The measured speeds of a free torso, as `Task.told` calls commands."""


class Live:
    """A policy that plays without an end. `run` moves its robots in its own thread; any other may set what it reads."""

    def __init__(self, trained: StoredPolicy, episode: int = 0, robots: int = 1):
        """Take a policy's task to a stage with so many robots, each in an episode of its own from `episode` on; raises
        as `robot_of`."""
        robot_of(trained)
        self.touchable, trained = True, on_plane(trained)
        try:
            own = getattr(trained.learner.task, "physics", None) == UNMODIFIED
            trained = in_world(trained, f"{__name__}:{(LiveUnmodified if own else LiveMujoco).__name__}")
        except InputError:  # a task with a physics of its own is shown and steered, but nobody can touch it
            self.touchable = False
        task: Any = trained.learner.task.for_driving()
        task = Posed.of(task) if isinstance(trained.learner, AtRest) else task
        self.trained, self.task = trained, task
        self.learner: Learner = trained.learner.replace(task=task)
        self.model = robot_of(trained)
        self.stage: Stage = task.simulator.stage if self.touchable else Stage(self.model)
        self.stage.fill(robots)
        self.ranges: dict[str, tuple[float, float]] = task.told_ranges
        self.home: dict[str, float] = task.home if isinstance(task, Posed) else {}
        """The parts of the command that are set-points of joints: those of the robot's posture, degrees."""
        self.told = dict.fromkeys(self.ranges, 0.0) | self.home
        """The command that the robots are to follow."""
        self.feet: tuple[str, ...] = getattr(getattr(task, "robot", None), "feet", ()) if self.touchable else ()
        """Bodies whose load is shown."""
        self.rewards: dict[str, Float[np.ndarray, " robots"]] = {}
        """Of the last decision, by the names of the reward's terms."""
        self.ready = False
        self.episodes = episode + np.arange(robots)
        """Numbers of the held-out episodes."""
        self.again = threading.Event()
        """Set: begin `episodes` anew."""
        self.going = threading.Event()
        """Cleared: wait."""
        self.once = False
        """True: wait after the next decision."""
        self.over = False
        self.going.set()

    @property
    def words(self) -> str:
        """Message about the robots for the page, empty if there is none."""
        if not self.ready:
            return "compiling"
        names = ["The robot"] if len(self.episodes) == 1 else [f"Robot {i + 1}" for i in range(len(self.episodes))]
        bodies = zip(names, self.stage.bodies, strict=True)
        resting = [f"{name} {body.ending}" for name, body in bodies if body.ended is not None]
        return f"{', '.join(resting)}; the next episode follows." if resting else ""

    def stop(self) -> None:
        """Let `run` return."""
        self.over = True
        self.again.set()
        self.going.set()

    def run(self) -> None:
        """Move the robots until `stop`, or until the thread is interrupted."""
        bodies, every = self.stage.bodies, np.ones(len(self.episodes), bool)
        state, steps = self._begun(), np.zeros(len(every), np.int32)
        self._decide(state, steps)  # compiles
        self.ready = True
        self.again.set()
        while not self.over:
            anew = np.array([body.ended is not None and self.stage.time > body.ended + REST_S for body in bodies])
            self.episodes += len(every) * anew
            if self.again.is_set():
                self.again.clear()
                self.stage.level()
                anew = every
            if anew.any():
                state, steps = _chosen(anew, self._begun(), state), np.where(anew, 0, steps)
                for body in np.array(bodies)[anew]:
                    body.forget()
            self.going.wait()
            if self.once:
                self.once = False
                self.going.clear()
            state, steps = self._decide(state, steps), steps + 1
            if not self.going.is_set():
                self.stage.shown()

    def _begun(self) -> State:
        """The first states of the episodes, which nobody sees."""
        self.stage.playing = False
        state = jax.block_until_ready(single(_all_begun)(self.learner, jnp.asarray(self.episodes, jnp.int32)))
        self.stage.playing = True
        return state

    def _decide(self, state: State, steps: Any) -> State:
        told = {name: jnp.float32(self.told[name]) for name in self.ranges}
        numbers, policy = jnp.asarray(self.episodes, jnp.int32), self.trained.policy
        after = single(_all_decided)(self.learner, policy, numbers, state, jnp.asarray(steps, jnp.int32), told)
        bodies, found = self.stage.bodies, jax.device_get({"reward": after.reward} | after.metrics)
        self.rewards = {name: np.asarray(values) for name, values in found.items()}
        if not self.touchable:
            world = jax.device_get(jax.vmap(lambda state: world_of(own_data(self.task, state)))(after))
            for i, body in enumerate(bodies):
                body.show(world.qpos[i], world.qvel[i], self.task.period if body.ended is None else 0.0)
            self.stage.wait(self.task.period)
        for body, done, success in zip(bodies, np.asarray(after.done), np.asarray(after.success), strict=True):
            if done and body.ended is None:
                body.ending = "reached its aim" if success else "fell" if self.ranges else "did not reach its aim"
                body.ended = self.stage.time  # last: other threads read the ending once this is set
        return after


_all_begun = jax.vmap(begun, in_axes=(None, 0))


@partial(jax.vmap, in_axes=(None, None, 0, 0, 0, None))
def _all_decided(*args: Any) -> State:
    """`decided`, where an episode that has ended stays as it is."""
    before: State = args[3]
    after = decided(*args)[0]
    return where(before.done, before, after)


_chosen = jax.jit(jax.vmap(where))
