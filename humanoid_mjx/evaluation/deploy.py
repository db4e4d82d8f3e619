"""A policy for the computer of a robot: ONNX graphs, and the contract of what goes in and comes out.

The network takes an observation. For a legged task the controller takes the readings of the sensors: it estimates the
attitude, keeps the gait's clock, builds the observation, and returns set-points of the joints.
"""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array

from humanoid_mjx.control.laws import ServoLaw
from humanoid_mjx.evaluation.onnx_graph import to_onnx
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy
from humanoid_mjx.files import names, whole_file, write_json, write_text
from humanoid_mjx.learners.approximate import ApproximateQ
from humanoid_mjx.learners.linear import LinearQ
from humanoid_mjx.learners.normalisation import MAX_DEVIATIONS, VARIANCE_FLOOR
from humanoid_mjx.learners.tabular import TabularQ
from humanoid_mjx.mechanics.rotations import unit
from humanoid_mjx.physics.base import Readings
from humanoid_mjx.robot import Robot, make_robot
from humanoid_mjx.robot.description import IMU, sensing_spec
from humanoid_mjx.robot.mjcf import checked
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.legged.observations import FARTHEST
from humanoid_mjx.tasks.legged.task import COMMANDED, LeggedTask

FORMAT = "humanoid_mjx contract, version 1"


def write_onnx(trained: StoredPolicy, file: Path) -> list[Path]:
    """Write the network to FILE.onnx, the contract to FILE.json and into the graphs, and for a legged task the
    controller to FILE_controller.onnx; return the files.

    Raises:
      InputError: the policy is a table or needs more than sensors, the package onnx is missing, or an operation of the
        policy has no translation.
    """
    learner: Any = trained.learner
    if isinstance(learner, TabularQ):
        name = trained.config.learner["name"]
        raise InputError(f"{trained.name}: only networks can be written as ONNX; this policy is of {name}: take .npz.")
    names = ["q", "action"] if isinstance(learner, ApproximateQ) else ["action"]
    inputs: dict[str, tuple[int, ...]] = {"observation": (learner.env.observation_size,)}
    contract, graphs = contract_of(trained), {file: (lambda obs: _decision(trained, obs), inputs, names)}
    if isinstance(learner.task, LeggedTask):
        controller = graphs[file.with_name(f"{file.stem}_controller.onnx")] = _controller(trained)
        read = {name: list(shape) for name, shape in controller[1].items()}
        contract["controller"] = {"file": f"{file.stem}_controller.onnx", "inputs": read, "outputs": controller[2]}
    models, texts = {}, {"contract": json.dumps(contract)}
    for path, (function, inputs, outputs) in graphs.items():
        shapes = {name: jax.ShapeDtypeStruct(shape, jnp.float32) for name, shape in inputs.items()}
        models[path] = to_onnx(function, shapes, outputs, texts)
    for path, model in models.items():
        with whole_file(path) as temporary:
            temporary.write_bytes(model)
    return [*models, write_contract(contract, file)]


def write_contract(contract: dict[str, Any], file: Path) -> Path:
    """Write a contract beside the file of a policy, and return the JSON's path."""
    path = file.with_suffix(".json")
    with suppress(OSError, ValueError):
        before = json.loads(path.read_text(encoding="utf-8"))
        if before == contract | {"controller": before.get("controller")}:  # of the same policy as ONNX
            contract = before
    write_json(path, contract, indent=1)
    return path


def check_place(file: Path) -> None:
    """Raise an InputError if another file stands in the place of the contract."""
    path = file.with_suffix(".json")
    if path.exists() and not (path.is_file() and FORMAT in path.read_text(encoding="utf-8", errors="replace")):
        raise InputError(f"{path}: the contract of {file.name} goes here, but another file is in its place; move it.")


def write_robot(what: str, file: Path, point: int | None = None) -> None:
    """Write a robot, by its name or path, or the robot of a policy as MJCF, with its sensors.

    Raises:
      InputError: there is nothing of the kind, the policy's task moves no robot, or MuJoCo refuses the model.
    """
    robot, timestep = None, None
    if Path(what).is_dir() or Path(what).suffix == ".npz" or what in names("policies", ".npz"):
        task: Any = find_policy(what, point).learner.task
        simulator = getattr(task, "simulator", None)
        robot, timestep = getattr(simulator, "robot", None), getattr(simulator, "step_s", None)
        if not isinstance(robot, Robot):
            raise InputError(f"{what}: the task of this policy moves no robot; name a robot.")
    elif point is not None:
        raise InputError(f"--point: {file.name} is of a robot, and only a sweep has points.")
    spec = sensing_spec(robot or make_robot(what), timestep)
    checked(spec.compile)
    write_text(file, spec.to_xml())


def contract_of(trained: StoredPolicy) -> dict[str, Any]:
    """Return what a program must know to use a policy without this package, as plain values in SI units and rad."""
    learner: Any = trained.learner
    env, weights = learner.env, trained.policy
    found: dict[str, Any] = {
        "format": FORMAT,
        "name": trained.name,
        "task": trained.config.task["name"],
        "learner": trained.config.learner["name"],
        "observation": {"size": env.observation_size},
        "action": {"bins": list(env.action_bins), "value_of_choice_k_of_n": "-1 + 2 k / (n - 1)"},
    }
    if hasattr(weights, "moments") and not isinstance(learner, LinearQ):
        seen, limits = weights.moments, {"variance_floor": VARIANCE_FLOOR, "clip": MAX_DEVIATIONS}
        found["normalisation"] = {"mean": _plain(seen.mean), "variance": _plain(seen.variance)} | limits
    return found | (_robot(env) if isinstance(env, LeggedTask) else {})


def _robot(task: LeggedTask) -> dict[str, Any]:
    """The part of a contract that is about a legged task and its robot."""
    robot, law, count = task.robot, task.control.of(task.robot), len(task.robot.joints)
    gains = {"stiffness": law.stiffness, "damping": law.damping} if isinstance(law, ServoLaw) else {}
    observed = *task.observations, *(task.privileged if task.observe == "privileged" else ())
    sizes: dict[Any, int] = {"joints": count, "feet": len(robot.feet)}
    parts = [
        {"name": name if isinstance(name, str) else "own", "size": sizes.get(part.size, part.size)}
        | {"unit": UNITS.get(name, "") if isinstance(name, str) else "", "divided_by": _plain(scale)}
        for name, part, scale in zip(observed, task.observed.parts, task.observed.scales, strict=True)
    ]
    ends = [[None if np.isinf(end) else end for end in pair] for pair in robot.setpoint_limits.T.tolist()]
    points = np.array(robot.point_sensors).reshape(len(robot.feet), -1).tolist()
    return {
        "joints": list(robot.joints),
        "default_pose": _plain(task.robot.posture),
        "joint_ranges": _plain(robot.ranges_rad),
        "action_scale": _plain(task.moved(jnp.ones(count))),
        **({"setpoint_limits": ends} if np.isfinite(robot.setpoint_limits).any() else {}),
        "smoothing": float(task.smoothing),
        "control": task.control.name,
        **{name: _plain(np.broadcast_to(np.asarray(gain), count)) for name, gain in gains.items()},
        "torque_limits": _plain(robot.torque_limits * float(task.torque_limit)),
        "control_period": task.period,
        "simulation_timestep": task.timestep,
        "start_height": robot.start_height,
        "observation": {
            "size": task.observation_size,
            "history": task.history,
            "order": "latest decision first",
            "clip": FARTHEST,
            "mirrored_in_second_half_of_gait": task.symmetric,
            "parts": parts,
        },
        "sensors": {
            "gyroscope": IMU[0],
            "accelerometer": IMU[1],
            "foot_contact": dict(zip(robot.feet, points, strict=True)),
            "averaged_over_control_period": task.sensors.averages,
            "delay_periods": task.sensors.delay,
        },
        "command": dict(zip(COMMANDED, _plain(task.command.ranges), strict=True)) if task.command else {},
    }


UNITS = {
    "encoders": "rad about default_pose",
    "rates": "rad/s",
    "gyroscope": "rad/s",
    "accelerometer": "m/s^2",
    "down": "unit vector, torso's frame",
    "contact": "N",
    "offsets": "last action, -1 to 1",
    "command": "m/s forward, m/s left, rad/s left",
    "clock": "sine and cosine of the gait's phase",
}
"""Units of the observations that a robot's sensors give, before they are divided by their scales."""


def _plain(values: Any) -> Any:
    return np.asarray(values, np.float64).tolist()


def _decision(trained: StoredPolicy, obs: Array) -> tuple[Array, ...]:
    """The values of all choices, if the learner has such, and the greedy action; of equal choices the first."""
    learner, weights = trained.learner, trained.policy
    if not isinstance(learner, ApproximateQ):
        return (learner.act(weights, obs, jax.random.key(0)),)
    q = learner.q_values(weights.value, learner.preprocess(weights, obs))
    return q, jnp.argmax(jnp.where(learner.allowed, q, -jnp.inf), axis=-1).astype(jnp.int32)


def _controller(trained: StoredPolicy) -> tuple[Any, dict[str, tuple[int, ...]], list[str]]:
    """The function of the sensors' readings in the order of `Readings`, the command and the memory, its inputs and its
    outputs. The memory holds 0 before the first decision, and then 1 and the episode as the robot knows it."""
    task: Any = trained.learner.task
    if task.observe == "privileged":
        raise InputError(f"{trained.name}: it observes the true motion of its torso, which no robot's sensors give.")
    own = jax.eval_shape(task.reset, jax.random.key(0)).data
    own = own._replace(world=None, motion=None, sensors=None, plant=None)
    blank, read = ravel_pytree((jnp.float32(0), jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), own)))
    sizes = {"encoders": len(task.robot.joints), "gyroscope": 3, "accelerometer": 3}
    sizes |= {"foot_contact": len(task.robot.feet), "command": 3, "memory": blank.size}

    def control(*given: Array) -> tuple[Array, ...]:
        *readings, command, memory = given
        now = Readings(*readings)
        begun, before = read(memory)
        first = before._replace(readings=now, down=unit(-now.accelerometer), command=command)
        later = before.felt(now, task.period)
        if task.gait:
            first = first._replace(clock=task.gait.start(jnp.float32(0), task.robot))
            later = later._replace(clock=task.gait.after(later.clock, later.command, task.period, task.robot))
        if task.command:
            later = later.under(command, task.period)
        if task.history > 1:
            row = task.observed(task.view(first, None, first.offsets))
            first = first._replace(past=jnp.tile(row, (task.history, 1)))
            later = later._replace(past=jnp.concatenate([later.past[:1], later.past[:-1]]))
        episode = jax.tree.map(lambda new, old: jnp.where(begun > 0, new, old), later, first)
        view = task.view(episode, None, episode.offsets)
        obs = task.seen(view)
        offsets = task.offsets(episode, task.as_numbers(_decision(trained, obs)[-1]))
        target = task.setpoint(offsets, task.reference(episode))
        after = task.remembered(view)._replace(offsets=offsets)
        return target, ravel_pytree((jnp.float32(1), after))[0], obs

    inputs: dict[str, tuple[int, ...]] = {name: (size,) for name, size in sizes.items()}
    return control, inputs, ["target", "memory_after", "observation"]
