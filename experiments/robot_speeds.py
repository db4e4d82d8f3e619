# pyright: reportAttributeAccessIssue=false
"""Time robots that are thrown about: on `physics: tree` beside native MuJoCo, and on a GPU beside MJX.

    pip install -q --no-deps --target others 'playground<1' mujoco-warp
    PYTHONPATH=others python experiments/robot_speeds.py           # writes docs/bench/robot_speeds_*.json, in minutes
    PYTHONPATH=others python experiments/robot_speeds.py --write FOLDER    # the models as plain files, without meshes
    python experiments/robot_speeds.py --models FOLDER --worlds 8192       # those files, where no package is installed

Each robot is pushed, follows random set-points, and mostly falls; a tenth of the worlds begin with bodies that touch
each other, where the robot has such contacts. A servo drives every joint: the model's own, or one of the motors' limit
a radian. All subjects take the same steps from the same states, in turn, each in a process of its own:

    tree                 this package, float32, its solver run to the exact minimum
    mujoco               native MuJoCo on all cores, float64, solved to convergence, the servo its own
    mujoco as published  the same with the model's own iterations, which may be fewer than convergence needs
    mjx-jax, mjx-warp    on a GPU: MJX with the model's own iterations, but at most those of this package's own physics
"""

import argparse
import json
import os
import re
import statistics
import sys
import tempfile
import time
import warnings
from concurrent.futures import Future, ProcessPoolExecutor, wait
from copy import copy
from importlib.util import find_spec
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

sys.path += [str(Path(__file__).parent), str(Path(__file__).parent.parent / "benchmarks")]
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from other_calls import native_rollout, with_servo
from other_robots import file_of, touches, without_meshes  # pyright: ignore[reportMissingImports]
from timing import joined, on_all_devices

from humanoid_mjx import compute
from humanoid_mjx.control.stages import Stages
from humanoid_mjx.physics import make_physics
from humanoid_mjx.robot import Robot, make_robot
from humanoid_mjx.robot.description import compiled

BENCH = Path(__file__).parent.parent / "docs" / "bench"
PUBLISHED = {
    "go1": "mujoco_playground/go1 feet",
    "h1": "mujoco_playground/h1",
    "g1": "mujoco_playground/g1",
    "humanoid": "mujoco_warp/humanoid",
}
ROBOTS = ("lower_body", *PUBLISHED)
STEPS, REPEATS = 50, 5
DISTINCT, MOVES, MOVE_S = 1024, 8, 0.2
"""Worlds that are thrown about one by one, their set-points, and how long each of these holds."""

OFFSETS, PUSH, TANGLED = (0.35, 1.2), (0.3, 1.5), 0.1
"""Largest distance of set-points from the posture, rad, of one half of the worlds and of the other; speeds of a push,
m/s and rad/s; share of worlds that touch themselves."""

BLOCK = {"cpu": 1024}
CONTACTS, CONSTRAINTS = 40, 160
"""Room in warp's buffers for each world; worlds that had too little count as lost."""


class Published(Robot):
    """A model of others, its motors torques of their joints."""

    name: str = "published"
    file: str = ""

    def spec(self, timestep: float | None = None) -> mujoco.MjSpec:
        spec = mujoco.MjSpec.from_file(self.file)
        model = spec.compile()
        joints, _, limits = gains(model)
        for part in (*spec.actuators, *spec.keys, *spec.sensors):
            spec.delete(part)
        for joint, limit in zip(joints, limits, strict=True):
            motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
            motor.ctrllimited, motor.ctrlrange = mujoco.mjtLimited.mjLIMITED_TRUE, (-limit, limit)
        spec.option.timestep = timestep or spec.option.timestep
        return spec


def gains(model: mujoco.MjModel) -> tuple[list[str], np.ndarray, np.ndarray]:
    """The joints that motors drive, the stiffness and damping of each one's servo, and its largest torque."""
    driven = model.actuator_trnid[:, 0]
    gear = model.actuator_gear[:, :1]
    stiffness = -model.actuator_biasprm[:, 1:3] * gear**2
    limit = np.where(model.jnt_actfrclimited[driven], np.abs(model.jnt_actfrcrange[driven]).max(axis=1), np.inf)
    forced = np.where(model.actuator_forcelimited, np.abs(model.actuator_forcerange).max(axis=1), np.inf)
    told = np.where(model.actuator_ctrllimited, np.abs(model.actuator_ctrlrange).max(axis=1), np.inf)
    is_servo = stiffness[:, 0] > 0.0
    told = np.where(is_servo, np.inf, told * model.actuator_gainprm[:, 0])
    limit = np.minimum(limit, np.abs(gear[:, 0]) * np.minimum(forced, told))
    limit = np.where(np.isfinite(limit), limit, stiffness[:, 0])
    stiffness = np.where(is_servo[:, None], stiffness, limit[:, None] * [1.0, 0.02])
    return [model.joint(joint).name for joint in driven], stiffness, limit


def plain(name: str, folder: Path) -> Path:
    """A file in the folder with a published model, without meshes, pictures and what it includes."""
    file = file_of(PUBLISHED[name])
    if file is None:
        sys.exit(f"{name}: {PUBLISHED[name].partition('/')[0]} is not installed; --models FOLDER reads plain files")
    spec = mujoco.MjSpec.from_file(str(file))
    for field in spec.hfields:
        spec.delete(field)
    without_meshes(spec)
    found = folder / f"{name}.xml"
    found.write_text(re.sub(r' material="[^"]*"', "", spec.to_xml()), encoding="utf-8")  # that of defaults, too
    return found


def robot_of(name: str, folder: str) -> tuple[Robot, mujoco.MjModel, np.ndarray]:
    """The robot, its model as published, and the gains of its servo, (joints, 2)."""
    if name == "lower_body":
        robot: Any = make_robot(name)
        model = copy(compiled(robot, None))
        return robot, model, np.tile([3.0, 0.1], (model.nu, 1))  # as the task `stand`
    robot = Published(file=str(Path(folder) / f"{name}.xml"))
    return robot, mujoco.MjModel.from_xml_path(robot.file), gains(mujoco.MjModel.from_xml_path(robot.file))[1]


def native_model(robot: Robot, published: mujoco.MjModel, servo: np.ndarray, own: bool) -> mujoco.MjModel:
    """The robot's model with its servo as MuJoCo's own; with the iterations as published if `own`."""
    model = with_servo(robot.model, servo)
    fresh = mujoco.MjOption()
    for key in ("solver", "iterations", "ls_iterations", "tolerance", "ls_tolerance"):
        setattr(model.opt, key, getattr(published.opt if own else fresh, key))
    return model


def states_of(name: str, folder: str, worlds: int) -> tuple[tuple[np.ndarray, ...], dict[str, Any]]:
    """Positions, velocities and set-points of robots that are thrown about, and what is true of them."""
    robot, published, servo = robot_of(name, folder)
    model, rng = native_model(robot, published, servo, own=False), np.random.default_rng(1)
    joints = model.actuator_trnid[:, 0]
    qpos = published.qpos0.copy()
    if published.nkey and name != "humanoid":
        qpos = published.key_qpos[0].copy()
    places = model.jnt_qposadr[joints]
    qpos[places] = np.radians(robot.home) if robot.home else qpos[places]
    qpos[2] = robot.start_height if name == "lower_body" else qpos[2]
    home = qpos[places]

    spread = rng.choice(OFFSETS, (DISTINCT, 1))
    qpos, qvel, setpoint = np.tile(qpos, (DISTINCT, 1)), np.zeros((DISTINCT, model.nv)), np.tile(home, (DISTINCT, 1))
    qvel[:, :6] = rng.normal(0.0, np.repeat(PUSH, 3), (DISTINCT, 6))
    ages, steps = rng.integers(1, MOVES, DISTINCT, endpoint=True)[:, None], round(MOVE_S / model.opt.timestep)
    for move in range(MOVES):
        new = home + spread * rng.uniform(-1.0, 1.0, setpoint.shape)
        after = native_rollout(model, qpos, qvel, steps, new)()
        parts = after[:, : model.nq], after[:, model.nq :], new
        sound = np.isfinite(after).all(axis=1) & (abs(parts[1]).max(axis=1) < 80.0)
        moves = (move < ages) & sound[:, None]
        qpos, qvel, setpoint = (np.where(moves, *both) for both in zip(parts, (qpos, qvel, setpoint), strict=True))
    found = np.array(contacts(model, qpos, qvel))
    tangled, others = np.flatnonzero(found[:, 1] > 0), np.flatnonzero(found[:, 1] == 0)
    rows = rng.choice(others, worlds)
    if len(tangled):
        rows = np.where(rng.random(worlds) < TANGLED, rng.choice(tangled, worlds), rows)
    setpoint = setpoint[rows] + 0.1 * rng.uniform(-1.0, 1.0, (worlds, model.nu))  # no two worlds are the same
    facts = {
        "worlds": worlds,
        "contacts with the ground": float(found[rows, 0].mean()),
        "touch themselves": float((found[rows, 1] > 0).mean()),
        "touch themselves when left alone": len(tangled) / len(found),
    }
    return tuple(part.astype(np.float32) for part in (qpos[rows], qvel[rows], setpoint)), facts


def contacts(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> list[tuple[int, int]]:
    """Contacts with the ground and between bodies, by world."""
    data, found = mujoco.MjData(model), []
    for data.qpos, data.qvel in zip(qpos, qvel, strict=True):
        mujoco.mj_forward(model, data)
        found.append(touches(model, data))
    return found


def make_tree(name: str, folder: str) -> tuple[Any, int]:
    """The program of a block of worlds."""
    robot, _, servo = robot_of(name, folder)
    physics = make_physics("tree", robot=robot)

    def simulate(qpos: Any, qvel: Any, setpoint: Any) -> Any:
        def controller(stages: Stages) -> Any:
            return servo[:, 0] * (setpoint - stages.qpos) - servo[:, 1] * stages.qvel

        world = physics.run(physics.start(qpos, qvel), controller, STEPS)
        return world.qpos, ~world.diverged

    return jax.jit(jax.vmap(simulate), compiler_options=compute.compiler_options("tree")), physics.model.nq


def make_mjx(name: str, folder: str, worlds: int, implementation: str) -> tuple[Any, int]:
    """The same on MJX."""
    from humanoid_mjx.physics.mjx import LINE_SEARCH_ITERATIONS, LOST, SOLVER_ITERATIONS, mjx

    robot, published, servo = robot_of(name, folder)
    model = native_model(robot, published, servo, own=True)
    model.opt.iterations = min(model.opt.iterations, SOLVER_ITERATIONS[implementation])
    model.opt.ls_iterations = min(model.opt.ls_iterations, LINE_SEARCH_ITERATIONS)
    put = mjx.put_model(model, impl=implementation)
    warp = implementation == "warp"
    if warp:
        put = put.tree_replace({"opt._impl.warn_overflow": 0})
    room: dict[str, Any] = {"naconmax": worlds * CONTACTS, "njmax": CONSTRAINTS} if warp else {}

    def simulate(qpos: Any, qvel: Any, setpoint: Any) -> Any:
        data = mjx.make_data(model, impl=implementation, **room).replace(qpos=qpos, qvel=qvel, ctrl=setpoint)

        def step(carry: tuple[Any, Any], _: None) -> tuple[tuple[Any, Any], None]:
            data, lost = carry
            data = mjx.step(put, data)
            return (data, lost | ((data._impl.overflow & LOST).any() if warp else False)), None

        (data, lost), _ = jax.lax.scan(step, (data, jnp.bool_(False)), length=STEPS)
        return data.qpos, ~lost & jnp.isfinite(data.qpos).all()

    return jax.jit(jax.vmap(simulate)), model.nq


_made: dict[str, Any] = {}
"""Subjects that this process has made."""


def prepare(subject: str, name: str, folder: str, worlds: int) -> dict[str, Any]:
    """Compile a subject in this process; seconds of each stage by the clock and of the processor."""
    warnings.simplefilter("ignore")
    compute.start(mjx=subject.startswith("mjx"))
    jax.config.update("jax_compilation_cache_dir", tempfile.mkdtemp())
    found: dict[str, Any] = {}
    if subject.startswith("mjx"):
        program, nq = make_mjx(name, folder, worlds, subject.removeprefix("mjx-"))
    else:
        program, nq = make_tree(name, folder)
    robot = robot_of(name, folder)[0]
    devices, platform = jax.local_devices(), jax.default_backend()
    count = len(devices) * max(1, worlds // (BLOCK.get(platform, worlds) * len(devices)))
    block = worlds // count
    sizes = nq, robot.model.nv, robot.model.nu
    for device in devices:
        place = jax.sharding.SingleDeviceSharding(device)
        shapes = [jax.ShapeDtypeStruct((block, size), jnp.float32, sharding=place) for size in sizes]
        stage = program
        for key, arguments in (("trace", shapes), ("lower", ()), ("compile", ())):
            clock, processor = time.perf_counter(), time.process_time()
            stage = getattr(stage, key)(*arguments)
            found.setdefault(f"{key}_s", round(time.perf_counter() - clock, 1))
            found.setdefault(f"{key}_processor_s", round(time.process_time() - processor, 1))
        _made[str(device)] = stage
    return found


def load(subject: str, name: str, folder: str, states: tuple[np.ndarray, ...]) -> dict[str, Any]:
    """Give a subject its states, and call it once."""
    if subject.startswith("mujoco"):
        robot, published, servo = robot_of(name, folder)
        model = native_model(robot, published, servo, own=subject.endswith("published"))
        qpos, qvel, setpoint = states
        _made["call"] = call = native_rollout(model, qpos, qvel, STEPS, setpoint)
        return {"sound": float(np.isfinite(call()).all(axis=1).mean())}
    shares = on_all_devices(
        lambda *at: _made[str(at[0].device)](*at), states, BLOCK.get(jax.default_backend()) or len(states[0])
    )
    _made["call"] = lambda: jax.block_until_ready(shares())  # what it makes stays on the device, as in a training
    _made["wake"] = jax.default_backend() == "gpu"
    return {"sound": float(joined(shares())[1].mean())}


def timed() -> tuple[float, float]:
    """Seconds of a call by the clock, and of the processor.

    A GPU that waited while others were timed is slow to begin, so a call goes before; in a training it does not wait.
    """
    if _made.get("wake"):
        _made["call"]()
    clock, processor = time.perf_counter(), time.process_time()
    _made["call"]()
    return time.perf_counter() - clock, time.process_time() - processor


def measure(names: list[str], folder: str, worlds: int, native_worlds: int, within: float) -> dict[str, Any]:
    """Everything of these robots. Subjects that are not compiled `within` seconds are left out."""
    gpu = jax.default_backend() == "gpu"
    asked = ["tree", *(["mjx-jax"] + ["mjx-warp"] * (find_spec("warp") is not None) if gpu else [])]
    everyone = [(name, subject) for name in names for subject in (*asked, "mujoco", "mujoco as published")]
    rooms = {each: ProcessPoolExecutor(1, get_context("spawn")) for each in everyone}
    begun, compiling = time.perf_counter(), {}
    for name, subject in everyone:
        if not subject.startswith("mujoco"):
            compiling[name, subject] = rooms[name, subject].submit(prepare, subject, name, folder, worlds)
            if not gpu:
                wait([compiling[name, subject]])  # one after another, for the sake of their times
    states = {name: states_of(name, folder, worlds) for name in names}
    print(f"states after {time.perf_counter() - begun:.0f} s", flush=True)
    late = wait(compiling.values(), timeout=max(0.0, within - (time.perf_counter() - begun))).not_done
    for each in (each for each, future in compiling.items() if future in late):
        for process in rooms[each]._processes.values():
            process.kill()
    outcome = {each: _compiled(None if future in late else future, within) for each, future in compiling.items()}
    rows: dict[str, Any] = {name: {"states": states[name][1], "subjects": {}} for name in names}
    for name in names:
        subjects = [subject for who, subject in everyone if who == name]
        found = {subject: outcome.get((name, subject), {}) for subject in subjects}
        going = [subject for subject in subjects if "failed" not in found[subject]]
        batch = {subject: min(worlds, native_worlds if subject.startswith("mujoco") else worlds) for subject in going}
        seconds: dict[str, list[tuple[float, float]]] = {subject: [] for subject in going}
        for subject in list(going):
            rows_of = tuple(part[: batch[subject]] for part in states[name][0])
            try:
                found[subject] |= rooms[name, subject].submit(load, subject, name, folder, rows_of).result()
            except Exception as error:  # a subject that cannot is a result
                found[subject]["failed"] = f"{type(error).__name__}: {str(error)[:300]}"
                going.remove(subject)
        for _ in range(REPEATS):
            for subject in going:
                seconds[subject].append(rooms[name, subject].submit(timed).result())
        for subject in going:
            clock, processor = (statistics.median(part) for part in zip(*seconds[subject], strict=True))
            work = batch[subject] * STEPS
            found[subject] |= {"worlds": batch[subject], "steps/s": work / clock}
            found[subject] |= {"steps per processor second": work / processor} if not gpu else {}
        rows[name]["subjects"] = found
        print(json.dumps({name: rows[name]}), flush=True)
    for room in rooms.values():
        room.shutdown(wait=False, cancel_futures=True)
    return rows


def _compiled(future: "Future[dict[str, Any]] | None", within: float) -> dict[str, Any]:
    """Compile time of a subject, or the reason why there is none; without a future it was late."""
    if future is None:
        return {"failed": f"not compiled within {within:.0f} s"}
    error = future.exception()
    return {"failed": f"{type(error).__name__}: {str(error)[:300]}"} if error else future.result()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), help=f"some of {', '.join(ROBOTS)}")
    parser.add_argument("--models", type=Path, help="folder of plain files, as --write makes")
    parser.add_argument("--write", type=Path, help="write plain files there, and stop")
    parser.add_argument("--worlds", type=int, help="by default 2,048, on a GPU 8,192")
    parser.add_argument("--native-worlds", type=int, default=2048, help="at most, for native MuJoCo")
    parser.add_argument("--within", type=float, default=100.0, help="s, for all subjects on a GPU to compile in")
    parser.add_argument("--out", type=Path, help="the record; others of its robots are kept")
    asked = parser.parse_args()
    compute.start()
    published = [name for name in asked.robots if name in PUBLISHED]
    with tempfile.TemporaryDirectory() as temporary:
        folder = asked.write or asked.models or Path(temporary)
        if not asked.models:
            folder.mkdir(parents=True, exist_ok=True)
            for name in published:
                plain(name, folder)
        if asked.write:
            return
        gpu = jax.default_backend() == "gpu"
        made_by = compute.made_by() | {"command": " ".join(["python", "experiments/robot_speeds.py", *sys.argv[1:]])}
        out = asked.out or BENCH / f"robot_speeds_{'gpu' if gpu else 'cpu'}.json"
        worlds = asked.worlds or (8192 if gpu else 2048)
        rows = measure(asked.robots, str(folder.resolve()), worlds, asked.native_worlds, asked.within if gpu else 1e6)
        before = json.loads(out.read_text(encoding="utf-8"))["robots"] if out.is_file() else {}
        record = made_by | {"steps": STEPS, "repeats": REPEATS, "robots": before | rows}
        out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    sys.stdout.flush()
    for process in active_children():  # those that still compile would be waited for
        process.kill()
    os._exit(0)


if __name__ == "__main__":
    main()
