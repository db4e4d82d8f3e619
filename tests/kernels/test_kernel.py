# pyright: reportAttributeAccessIssue=false
"""A function of many worlds, written out for threads, computes what XLA makes of it: on a CPU, and in Pallas's
interpreter as on a GPU."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import scipy.special
from tree_robots import HOPPER, PLANAR, SHAPES, converged, states

from humanoid_mjx.kernels import cpu_kernel as kernels
from humanoid_mjx.kernels import worlds
from humanoid_mjx.kernels.cpu_kernel import cpu_kernel
from humanoid_mjx.kernels.elements import cosine, inverse_of_erf, sine
from humanoid_mjx.kernels.gpu_kernel import gpu_kernel
from humanoid_mjx.kernels.worlds import one_world
from humanoid_mjx.mechanics.terrain import Terrain
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.step import Values
from humanoid_mjx.physics import make_physics, tree
from humanoid_mjx.robot import Robot
from humanoid_mjx.robot.description import IMU

SENSORS = '<sensor><gyro name="gyroscope" site="imu"/><accelerometer name="accelerometer" site="imu"/></sensor>'

PENDULUM = f"""
<mujoco>
  <worldbody>
    <body>
      <site name="imu"/>
      <joint name="hip" axis="0 1 0" range="-90 90"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
      <body pos="0 0 -0.2">
        <joint name="knee" axis="0 1 0" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/><motor joint="knee"/></actuator>
  {SENSORS}
</mujoco>
"""

CROWD = f"""
<mujoco>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body pos="0 0 0.2">
      <freejoint/>
      <geom type="sphere" size="0.03" mass="0.3"/>
      {
    "".join(
        f'''<body euler="0 0 {72 * i}"><joint name="j{i}" axis="0 1 0" range="-170 170"/>
        <geom type="capsule" fromto="0.04 0 0 0.15 0 0.02" size="0.02" mass="0.1"/></body>'''
        for i in range(5)
    )
}
    </body>
  </worldbody>
  <actuator><motor joint="j0"/></actuator>
</mujoco>
"""
"""Five limbs that may touch each other."""

BIPED = f"""
<mujoco>
  <default>
    <joint damping="0.1" armature="0.002" limited="true"/>
    <geom contype="0" conaffinity="0"/>
    <default class="foot"><geom type="box" pos="0.02 0 -0.2" size="0.06 0.03 0.01" mass="0.1" contype="1"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1" conaffinity="1"/>
    <body pos="0 0 0.3">
      <freejoint/>
      <geom type="sphere" size="0.05" mass="1"/>
      <site name="imu"/>
      <body pos="0 0.06 0">
        <joint name="right" axis="0 1 0" range="-80 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
        <geom class="foot"/>
      </body>
      <body pos="0 -0.06 0">
        <joint name="left" axis="0 1 0" range="-80 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
        <geom class="foot"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="right"/><motor joint="left"/></actuator>
  {SENSORS}
</mujoco>
"""
"""Two legs of one build, each with four corners on the ground."""

BOXES = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/><joint damping="0.01" limited="true"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="1 1 1" pos="0 0 -1"/>
    <body pos="0 0.07 0">
      <joint axis="1 0 0" range="-30 70"/>
      <geom type="box" size="0.05 0.02 0.04" pos="0 0.02 0.1" euler="10 20 0" mass="0.2" contype="3"/>
      <geom type="box" size="0.03 0.02 0.04" pos="-0.1 0.02 0.1" euler="30 20 0" mass="0.2" contype="2"/>
      <geom type="box" size="0.03 0.02 0.04" pos="0.1 0.02 0.1" euler="20 20 0" mass="0.2" contype="2"/>
    </body>
    <body pos="0 -0.07 0">
      <joint name="arm" axis="1 0 0" range="-70 30"/><joint axis="0 1 0.2" range="-30 30"/>
      <geom type="capsule" size="0.02 0.05" pos="0 0 0.1" euler="0 40 0" mass="0.4" conaffinity="2"/>
      <geom type="capsule" size="0.01 0.05" pos="-0.1 0 0.1" euler="0 20 0" mass="0.4" conaffinity="2"/>
      <geom size="0.03" pos="0 0 0.15" mass="0.2" conaffinity="1" margin="0.001"/>
      <geom type="capsule" size="0.01 0.02" pos="0.02 0 0.15" mass="0.2" conaffinity="1" margin="0.001"/>
    </body>
  </worldbody>
  <actuator><motor joint="arm"/></actuator>
</mujoco>
"""
"""Capsules and a ball that may touch boxes: a few of one margin, and many of another."""

KERNELS = {
    "cpu": lambda function, *args, lanes=1: cpu_kernel(function, *args),
    "gpu": partial(gpu_kernel, interpret=True),
}

TABLE = np.array([[0.0, 1.0, -2.0], [0.5, 0.0, 1.0]], np.float32)[..., None]


def everything(x, flag):
    """Rows that are moved about, loops, a branch that some worlds need, sums, zeros and ones that are known."""
    rows = jnp.concatenate([x[1:], x[:1]]) * TABLE[0] + jnp.stack([x[0], x[2] - x[1], jnp.sqrt(jnp.abs(x[1]))])
    table = jnp.where(flag, rows[None] * TABLE, rows.swapaxes(0, 0)[None])

    def eliminate(k, table):
        pivot = table[k] / (1.0 + jnp.abs(table[k, k]))
        return jax.lax.dynamic_update_index_in_dim(table - 0.1 * table[:, k][:, None] * pivot[None], pivot, k, axis=0)

    table = jax.lax.fori_loop(0, 2, eliminate, table)
    halved, count = jax.lax.while_loop(
        lambda carry: ~(jnp.abs(carry[0]) < 1.0).all(),
        lambda carry: (jnp.where(jnp.abs(carry[0]) < 1.0, carry[0], 0.5 * carry[0]), carry[1] + 1),
        (8.0 * x[0], jnp.int32(0)),
    )
    far = jax.lax.cond(
        (x[2] > 1.0).any(), lambda: jnp.where(x[2] > 1.0, table.sum(axis=(0, 1)), 0.0), lambda: 0.0 * x[0]
    )
    of_nothing = {"sum": x[:0].sum(axis=0), "all": (x[:0] > 0.0).all(axis=0), "any": (x[:0] > 0.0).any(axis=0)}
    flag = (table > 0).all(axis=1) | flag
    place = 1 + (x > 1e9).any().astype(jnp.int32)  # 1 in all worlds, which is not known while tracing
    entry = jax.lax.dynamic_index_in_dim(rows, place, keepdims=False)
    put = jax.lax.dynamic_update_index_in_dim(rows, x[0], place, axis=0)

    def reverse(carry):
        """Swap the ends of a table, with a loop within that reads it, and a branch."""
        index, table, total = carry
        other = len(table) - 1 - index
        low, high = (jax.lax.dynamic_index_in_dim(table, at, keepdims=False) for at in (index, other))

        def below(at, sum):
            return sum + jax.lax.dynamic_index_in_dim(table, at, keepdims=False) * rows[0]

        sum = jax.lax.fori_loop(0, index + place, below, 0.0 * low)
        sum = jax.lax.cond((x[0] > 0.0).any(), lambda: sum + jnp.where(x[0] > 0.0, table[0], 0.0), lambda: sum)
        for at, new in ((index, high), (other, low)):
            table = jax.lax.dynamic_update_index_in_dim(table, new + 0.1 * sum, at, axis=0)
        return index + 1, table, total + sum

    start = jnp.int32(0), jnp.concatenate([rows, 2.0 * rows, x[:1]]), 0.0 * x[0]
    _, reversed, total = jax.lax.while_loop(lambda carry: carry[0] < 3 * place, reverse, start)

    def swap(carry):
        """Two tables change places, and an entry of one is new."""
        index, one, two = carry
        return index + 1, two, jax.lax.dynamic_update_index_in_dim(one, two[0] + x[0], index, axis=0)

    swapped = jax.lax.while_loop(lambda carry: carry[0] < 3 * place, swap, (jnp.int32(0), rows, 3.0 * rows + 1.0))[1:]
    looked_up = {"entry": entry, "put": put, "reversed": reversed, "total": total, "one": swapped[0], "two": swapped[1]}
    return of_nothing | looked_up | {"table": table, "halved": halved, "far": far, "flag": flag, "most": count < 20}


@pytest.mark.parametrize(("worlds", "lanes"), [(1, 1), (5, 1), (64, 3), (70, 2)])
@pytest.mark.parametrize("kernel", KERNELS)
def test_loops_branches_and_indices_are_those_of_xla(kernel, worlds, lanes):
    """Rows of three and of two are lanes. Blocks of a CPU are 16 worlds: parts of one, four, and five that overlap."""
    x = np.random.default_rng(worlds).normal(size=(3, worlds)).astype(np.float32)
    flag = x[0] > 0.3
    expected = jax.jit(everything)(x, flag)
    found = jax.jit(lambda *args: KERNELS[kernel](everything, *args, lanes=lanes))(x, flag)
    for name, value in expected.items():
        assert found[name].dtype == value.dtype
        wanted = np.broadcast_to(value, found[name].shape)
        np.testing.assert_allclose(found[name], wanted, rtol=1e-5, atol=1e-6)  # contracted or not, a dozen operations


def test_sine_and_cosine_are_those_of_numpy():
    """An error of 1.2e-7 is one of the last digit of float32 near 1."""
    angles = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 10_000)) * np.array([[3.2], [100.0], [6000.0]])
    angles = np.append(angles.astype(np.float32).ravel(), np.float32([0.0, np.pi / 4, np.pi / 2, -np.pi]))
    for function, reference in ((sine, np.sin), (cosine, np.cos)):
        np.testing.assert_allclose(jax.jit(function)(angles), reference(np.float64(angles)), atol=1.2e-7, rtol=0)


def test_the_inverse_of_the_error_function_is_that_of_scipy():
    x = np.float32(np.concatenate([np.linspace(-1, 1, 20_001), 1.0 - np.logspace(-7, -1, 500), np.logspace(-30, -1)]))
    np.testing.assert_allclose(jax.jit(inverse_of_erf)(x), scipy.special.erfinv(np.float64(x)), rtol=4e-7)


NUMBERS = {
    "arithmetic": lambda x, y: (x + y, x - y, x * y, x / y, -x, abs(x), x**2, x**3, jnp.square(y)),
    "roots and powers": lambda x, y: (
        jnp.sqrt(abs(x)),
        jax.lax.rsqrt(abs(y)),
        jnp.exp(x),
        jnp.log(abs(y)),
        abs(x) ** y,
        jax.lax.erf_inv(x / (2.0 + 2.0 * abs(x))),
    ),
    "angles": lambda x, y: (jnp.sin(x), jnp.cos(x), jnp.tan(x), jnp.arctan2(x, y)),
    "order": lambda x, y: (x < y, x <= y, x > y, x >= y, x == y, x != y, jnp.maximum(x, y), jnp.minimum(x, y)),
    "steps": lambda x, y: (jnp.floor(x), jnp.ceil(x), jnp.sign(x), jnp.clip(x, -0.5, y), jnp.isfinite(x)),
    "integers": lambda x, y: _of_integers(x.astype(jnp.int32), (9.0 * y).astype(jnp.int32)),
    "words": lambda x, y: _of_words(abs(x).astype(jnp.uint32), abs(9.0 * y).astype(jnp.uint32)),
    "flags": lambda x, y: _of_flags(x > 0.0, y > 0.0),
}


def _of_integers(x, y):
    divided = jax.lax.div(x, jnp.int32(3)), jax.lax.rem(x, jnp.int32(3))
    shifts = jnp.left_shift, jnp.right_shift, jax.lax.shift_right_logical
    shifted = [shift(x, by) for shift in shifts for by in (y & 63, jnp.int32(40), jnp.int32(5))]
    return *divided, *shifted, x & y, x | y, x ^ y, ~x, x + y, x * y, -x, abs(x), jnp.maximum(x, y), x < y, x + 0.5


def _of_words(x, y):
    top = y + jnp.uint32(2**31)
    return (
        jnp.sign(x),
        x << y,
        x + top,
        x < top,
        jnp.minimum(x, top),
        jnp.maximum(x, top),
        top.astype(jnp.float32),
        top.astype(jnp.int32),
    )


def _of_flags(x, y):
    return x & y, x | y, x ^ y, ~x, x == y, x < y, x.astype(jnp.int32), x.astype(jnp.float32), jnp.where(x, y, ~y)


@pytest.mark.parametrize("case", NUMBERS)
def test_arithmetic_of_a_cpu_is_that_of_xla(case):
    """Numbers of all sizes, zeros of both signs, and what is not finite; one world alone, to the bit."""
    x = np.random.default_rng(3).normal(size=(2, 200)).astype(np.float32) * 10.0 ** np.arange(-3, 5).repeat(25)
    x = np.float32(np.concatenate([x, [[0.0, -0.0, 0.0, 1.0], [1.0, 2.0, -0.0, 1.0]]], axis=1))
    if case in ("arithmetic", "order", "steps"):
        infinite = [[np.inf, -np.inf, np.nan, 1.0, np.inf], [1.0, np.inf, 1.0, np.nan, np.inf]]
        x = np.float32(np.concatenate([x, infinite], axis=1))
    if case == "angles":
        x = np.clip(x, -1000.0, 1000.0)

    def function(x):
        return NUMBERS[case](x[0], x[1])

    assert worlds.why_not(function, (x.T,), (True,)) is None
    of_one = jax.jit(jax.vmap(worlds.kernel(function), in_axes=-1))
    jax.tree.map(np.testing.assert_array_equal, of_one(x[:, 5:6]), tuple(found[5:6] for found in of_one(x)))
    for wanted, got in zip(jax.jit(function)(x), jax.jit(partial(cpu_kernel, function))(x), strict=True):
        assert got.dtype == wanted.dtype
        # Functions of two libraries, some of them series; integers and flags are exact.
        real = got.dtype == np.float32
        np.testing.assert_allclose(got, wanted, rtol=5e-6 * real, atol=1e-6 * (case == "angles"))


def test_a_world_does_not_depend_on_others():
    """To the bit: alone, among few and among many, at any place."""
    x = np.random.default_rng(5).normal(size=(3, 50)).astype(np.float32)
    kernel = jax.jit(partial(cpu_kernel, everything))
    whole = kernel(x, x[0] > 0.3)
    for some in (slice(7, 8), slice(3, 20), slice(10, 42)):
        part = kernel(x[:, some], x[0, some] > 0.3)
        for name, value in whole.items():
            np.testing.assert_array_equal(part[name], value[..., some], err_msg=name)


def compared(x):
    """A table of which each entry is changed in turn, and what it was is read afterwards."""

    def change(carry):
        place, table = carry
        return place + 1, jax.lax.dynamic_update_index_in_dim(table, x[0], place, axis=0) - table

    return jax.lax.while_loop(lambda carry: carry[0] < x.sum(), change, (jnp.int32(0), x))[1]


def changed_twice(x):
    """Two tables, each of which is another with a changed entry."""

    def change(carry):
        place, table = carry
        one, two = (jax.lax.dynamic_update_index_in_dim(table, new, place, axis=0) for new in (x[0], x[1]))
        return place + 1, one + two

    return jax.lax.while_loop(lambda carry: carry[0] < x.sum(), change, (jnp.int32(0), x))[1]


def test_a_function_is_compiled_once_unless_it_is_forgotten(monkeypatch):
    made, compile_it = [], kernels._compiled
    monkeypatch.setattr(kernels, "_compiled", lambda name, code: made.append(name) or compile_it(name, code))
    double = jax.jit(lambda x: x + x)
    for count in (1, 1, 2):
        if count > 1:
            kernels.forget()
        np.testing.assert_array_equal(cpu_kernel(double, np.ones(20, np.float32)), np.full(20, 2.0))
        assert len(made) == count


def test_what_a_cpu_cannot_do_is_refused():
    with pytest.raises(NotImplementedError, match="kernels of a CPU do no 'div'"):
        cpu_kernel(lambda x: jax.lax.div(jnp.int32(2), x.astype(jnp.int32)), jnp.zeros(8))
    for kind in (jnp.int8, jnp.int16):
        with pytest.raises(NotImplementedError, match="kernels know no int"):
            cpu_kernel(lambda x, kind=kind: x.astype(kind), jnp.zeros(8))


REFUSED = {
    "no array any more after an entry": changed_twice,
    "after an entry of it has changed": compared,
    "threads do no 'sort'": lambda x: jnp.sort(x, axis=0),
    "known while tracing": lambda x: jax.lax.dynamic_slice_in_dim(x, jnp.int32(x[0, 0]), 2),
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_threads_cannot_do_is_refused(words):
    with pytest.raises(NotImplementedError, match=words):
        jax.eval_shape(lambda x: gpu_kernel(REFUSED[words], x), jnp.zeros((3, 8)))


MODELS = {
    "a hopper": mujoco.MjModel.from_xml_string(HOPPER),
    "ten pairs": mujoco.MjModel.from_xml_string(CROWD),
    "shapes on boxes": mujoco.MjModel.from_xml_string(BOXES),
    "two legs, a thread each": mujoco.MjModel.from_xml_string(BIPED),
}


EMITTERS = {"xla_cpu_use_fusion_emitters": True} if jax.__version_info__ < (0, 11) else {}
"""XLA's options for the longest program, that of ten pairs in Pallas's interpreter: with the emitters that all other
tests have (`conftest.py`) it takes LLVM twice as long."""


@pytest.mark.parametrize("case", MODELS)
def test_a_time_step_is_that_of_xla(case):
    """Ground, pairs and limits in states that need one to eight Newton steps."""
    model = converged(MODELS[case])
    robot = fold(
        read_tree(model, [name for name in IMU if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name) >= 0])
    )
    qpos, qvel, control = (np.float32(x.T) for x in states(model, 100))
    world = qpos, qvel, np.zeros_like(qvel), np.zeros(100, bool)
    last = np.ones(100, bool)

    def step(robot, world, control, last):
        return tree._advance_sensed(robot, Values(), world, control, last)

    expected = jax.jit(jax.vmap(one_world(step, robot), -1, -1))(world, control, last)
    assert not expected[0][-1].any()
    for name, kernel in KERNELS.items():
        options = EMITTERS if (case, name) == ("ten pairs", "gpu") else {}
        found = jax.jit(partial(kernel, partial(step, robot), lanes=robot.lanes), compiler_options=options)(
            world, control, last
        )
        for wanted, got in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
            size = np.abs(np.float64(wanted)).max() if wanted.size else 0.0
            # Rounding in another order, made larger by the stiffness of the contacts.
            np.testing.assert_allclose(got, np.broadcast_to(wanted, got.shape), atol=1e-4 * size + 1e-6)


@pytest.mark.parametrize("xml", [PLANAR.replace("<option", '<option integrator="RK4"'), SHAPES])
def test_what_trees_may_have_is_what_threads_can_do(xml):
    """Dry friction, its line search, four stages of a step, corners and rims, waves and stairs; traced alone."""
    model = mujoco.MjModel.from_xml_string(xml)
    robot = tree.on_stairs(fold(read_tree(model)))
    terrain = jax.tree.map(lambda value: jnp.full(40, value), Terrain(rough=0.01, stairs=0.01))
    qpos, qvel, control = (jnp.zeros((count, 40)) for count in (model.nq, model.nv, model.nu))

    def step(robot, terrain, world, control, last):
        return tree._advance_sensed(robot, Values(terrain=terrain), world, control, last)

    given = terrain, (qpos, qvel, qvel, jnp.zeros(40, bool)), control, jnp.ones(40, bool)
    cpu, gpu = (jax.eval_shape(partial(kernel, partial(step, robot)), *given) for kernel in KERNELS.values())
    assert cpu == gpu


class Pendulum(Robot):
    """Two links, which compile in seconds."""

    def spec(self, timestep=None):
        return mujoco.MjSpec.from_string(PENDULUM)


CONTROLLERS = {
    "a servo": (True, lambda stages: -0.5 * stages.qpos - 0.1 * stages.qvel),
    "a model": (False, lambda stages: stages.torque_for(-20.0 * stages.qpos - 5.0 * stages.qvel, 1.0)),
}


@pytest.mark.parametrize("case", CONTROLLERS)
def test_loops_of_a_gpu_are_those_of_a_cpu(case, monkeypatch):
    """Steps are written out there, and the state is carried as a whole; here of XLA's kernels."""
    little, controller = CONTROLLERS[case]
    pendulum = make_physics("tree", robot=Pendulum(name="pendulum"))
    qpos, qvel, _ = (np.float32(x) for x in states(pendulum.model, 20))

    def run(qpos, qvel):
        world = pendulum.start(qpos, qvel)
        return pendulum.run(world, controller, 14), *pendulum.run_sensed(world, controller, 3)

    expected = jax.jit(jax.vmap(run))(qpos, qvel)
    monkeypatch.setattr(tree, "_kernels_run", lambda: True)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(tree, "one_kernel", lambda function, *static, **_: one_world(function, *static))
    assert pendulum._unroll(controller, 14) == (tree.UNROLL if little else 1)
    assert pendulum._unroll(controller, 3) == (3 if little else 1)
    found = jax.jit(jax.vmap(lambda *at: run(*at)))(qpos, qvel)
    for wanted, got in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        size = np.abs(np.float64(wanted)).max() if wanted.size else 0.0
        np.testing.assert_allclose(got, wanted, atol=1e-4 * size + 1e-6)  # as a time step's


CONTEXTS = {
    "cleared caches": jax.clear_caches,
    "another precision": lambda: jax.config.update("jax_default_matmul_precision", "bfloat16"),
}


@pytest.mark.parametrize("context", CONTEXTS)
@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_is_traced_again(kernel, context):
    """Nothing of the first trace is left in the second."""
    x = np.random.default_rng(2).normal(size=(3, 40)).astype(np.float32)
    function = jax.jit(lambda *args: KERNELS[kernel](everything, *args, lanes=3))
    first, precision = function(x, x[0] > 0.3), jax.config.jax_default_matmul_precision
    try:
        CONTEXTS[context]()
        second = function(x, x[0] > 0.3)
    finally:
        jax.config.update("jax_default_matmul_precision", precision)
    jax.tree.map(np.testing.assert_array_equal, first, second)


def test_a_short_loop_of_many_operations_is_not_unrolled():
    def function(steps, x):
        def step(x, _):
            for number in range(40):
                x = jnp.sin(x) + number
            return x, None

        return jax.lax.scan(step, x, length=steps)[0]

    few, many = (
        kernels.written(worlds.signature_of_one(partial(function, steps), (X[0],), (True,)), 16)[0].count("\n")
        for steps in (14, 16)
    )
    assert many == few
    found, expected = (jax.jit(jax.vmap(of(partial(function, 14))))(X[0]) for of in (worlds.kernel, lambda f: f))
    np.testing.assert_allclose(found, expected, atol=1e-4)  # 560 sines in turn, each with an error of 1.2e-7


def test_loops_of_a_world_go_by_its_own_numbers():
    """Whether any of a world's numbers is large is not the same in all worlds."""

    def halved(row):
        return jax.lax.while_loop(lambda row: (abs(row) > 1.0).any(), lambda row: 0.5 * row, row)

    def seen(row, count):
        def step(_, carry):
            side = jax.lax.cond(carry[1][0] > 0.0, lambda: jnp.int32(1), lambda: jnp.int32(2))
            return carry[0] | (carry[1] > 1.0).any(), 0.5 * carry[1], side

        nothing = jax.lax.scan(lambda x, _: (x, x), row, length=0)
        return *jax.lax.fori_loop(0, count, step, (jnp.bool_(False), row, jnp.int32(0))), *nothing

    assert "ends earlier in one world" in str(worlds.why_not(halved, (X[0],), (True,)))
    assert worlds.why_not(seen, (X[0], jnp.int32(2)), (True, False)) is None
    found, expected = (jax.jit(jax.vmap(each, (0, None)))(X[0], 2) for each in (worlds.kernel(seen), seen))
    jax.tree.map(np.testing.assert_array_equal, found, expected)


MAPS = {
    "once": lambda f: jax.vmap(f, (0, None, None))(X[0], Y[0], 3),
    "nested": lambda f: jax.vmap(jax.vmap(f, (0, None, None)), (0, 0, None))(X, Y, jnp.int32(3)),
    "crossed": lambda f: jax.vmap(jax.vmap(f, (None, 0, None)), (0, None, None))(X[:, 0], Y, 3),
    "derived": lambda f: jax.grad(lambda x: jax.vmap(lambda x, y: f(x, y, 3)["sum"])(x, Y).sum())(X[:, 0]),
    "derived each": lambda f: jax.vmap(jax.grad(lambda x, y: f(x, y, 3)["sum"]))(X[:, 0], Y),
}
X, Y = (jnp.asarray(np.random.default_rng(6).normal(size=size), jnp.float32) for size in ((3, 5, 4), 3))


@pytest.mark.parametrize("case", MAPS)
def test_maps_and_derivatives_of_a_kernel(case, monkeypatch):
    """Runs of worlds are one kernel; derivatives are XLA's."""
    calls = []

    def counted(known, leaves, worlds, call=kernels.call):
        calls.append(worlds)
        return call(known, leaves, worlds)

    def function(x, y, count):
        return {"sum": jnp.sin(x).sum() * y, "row": jax.lax.fori_loop(0, count, lambda _, row: 0.5 * row + y, x)}

    monkeypatch.setitem(worlds.BACK_ENDS, "cpu", (kernels.together, counted, kernels.written))
    found, expected = MAPS[case](worlds.kernel(function)), MAPS[case](function)
    jax.tree.map(partial(np.testing.assert_allclose, rtol=2e-6, atol=1e-6), found, expected)
    assert set(calls) == ({16} if "derived" not in case else set())


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_kernel_is_that_of_one_device_on_two(kernel):
    """Traced alone, under a mesh, and alone again."""
    x = np.random.default_rng(4).normal(size=(3, 64)).astype(np.float32)
    worlds = jax.sharding.PartitionSpec(None, "worlds")
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:2]), ("worlds",))
    assert mesh.size == 2

    def function(x):
        return KERNELS[kernel](compared_once, x, lanes=1)

    shared = jax.shard_map(function, mesh=mesh, in_specs=worlds, out_specs=worlds, check_vma=False)
    alone, both, again = (jax.jit(each)(x) for each in (function, shared, lambda x: function(x) + 0.0))
    np.testing.assert_array_equal(both, alone)
    np.testing.assert_array_equal(again, alone)


def compared_once(x):
    """A table in memory, changed in a loop of unknown length."""

    def change(carry):
        place, table = carry
        old = jax.lax.dynamic_index_in_dim(table, place, axis=0, keepdims=False)
        return place + 1, jax.lax.dynamic_update_index_in_dim(table, 2.0 * old + x[0], place, axis=0)

    return jax.lax.while_loop(lambda carry: carry[0] < jnp.abs(x[0]).sum(), change, (jnp.int32(0), x))[1]
