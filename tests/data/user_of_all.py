"""A user's file, which uses every name of the front door; pyright checks it, nobody runs it."""

import jax
import jax.numpy as jnp

import humanoid_mjx
from humanoid_mjx import (
    ContinuousTask,
    Episode,
    FiniteTask,
    InputError,
    Law,
    Learner,
    Outcome,
    Physics,
    Policy,
    Rewards,
    Robot,
    Run,
    State,
    StepLearner,
    Task,
    Trained,
    traced,
)

humanoid_mjx.start()
task = humanoid_mjx.make_task("joint_reach", joint=4)
tabular = humanoid_mjx.make_learner("tabular_q", task, epsilon=0.2)
deep = humanoid_mjx.make_learner("deep_q", humanoid_mjx.make_task("leg_reach"))
learners: list[Learner] = [tabular, deep, humanoid_mjx.make_learner("mine:Mine", task)]
physics: list[Physics] = [humanoid_mjx.make_physics("tree", robot=humanoid_mjx.make_robot("dog"))]
robots: list[Robot] = [humanoid_mjx.make_robot("leg")]
bases: list[type] = [Law, Rewards, Outcome, StepLearner, FiniteTask, InputError]
key = humanoid_mjx.key(0)
own: Task = humanoid_mjx.make_task("mine:Hop")


class Hop(ContinuousTask):
    height: float = traced(1.0)

    @property
    def action_bins(self) -> tuple[int, ...]:
        return (3,)


def in_a_loop(policy: Policy, state: State) -> State:
    action = policy(policy.observation(state), key)
    return policy.task.step(state, action, key)


trained = humanoid_mjx.train(tabular, key)
sweep = jax.vmap(lambda epsilon: humanoid_mjx.train(tabular.replace(epsilon=epsilon), key))(jnp.linspace(0, 1, 9))
some: Trained = humanoid_mjx.train(humanoid_mjx.make_learner("mine:Mine", task), key)
networks = humanoid_mjx.train(deep, key).policy.weights
played: Episode = humanoid_mjx.rollout(task, trained.policy, key)
by_function = humanoid_mjx.rollout(task, lambda obs, key: jnp.zeros(1, int), key)
trained.policy.save("mine.npz")
loaded = humanoid_mjx.load_policy("walk")
run: Run = humanoid_mjx.sweep("joint1", quiet=True)
again = humanoid_mjx.load_run(run.path)
found = humanoid_mjx.evaluate(run, episodes=8) | humanoid_mjx.evaluate(trained) | humanoid_mjx.evaluate(loaded)
pictures = humanoid_mjx.draw(run), humanoid_mjx.plot(run), humanoid_mjx.play("walk")
torques = humanoid_mjx.control.pd, humanoid_mjx.dynamics.gravity, humanoid_mjx.kinematics.forward, humanoid_mjx.Leg

reveal_type(task)  # noqa: F821
reveal_type(tabular)  # noqa: F821
reveal_type(deep)  # noqa: F821
reveal_type(physics[0])  # noqa: F821
reveal_type(humanoid_mjx.make_physics("tree", robot=robots[0]))  # noqa: F821
reveal_type(humanoid_mjx.make_robot("leg"))  # noqa: F821
reveal_type(key)  # noqa: F821
reveal_type(own)  # noqa: F821
reveal_type(trained)  # noqa: F821
reveal_type(trained.policy.weights)  # noqa: F821
reveal_type(trained.curve)  # noqa: F821
reveal_type(trained.places)  # noqa: F821
reveal_type(trained.scores)  # noqa: F821
reveal_type(sweep)  # noqa: F821
reveal_type(networks)  # noqa: F821
reveal_type(played)  # noqa: F821
reveal_type(played.episode_return)  # noqa: F821
reveal_type(played.success)  # noqa: F821
reveal_type(loaded)  # noqa: F821
reveal_type(loaded.task)  # noqa: F821
reveal_type(loaded(jnp.zeros(4), key))  # noqa: F821
reveal_type(run)  # noqa: F821
reveal_type(again)  # noqa: F821
reveal_type(found)  # noqa: F821
reveal_type(found["greedy"].success)  # noqa: F821
reveal_type(pictures)  # noqa: F821
