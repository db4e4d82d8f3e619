# pyright: reportAttributeAccessIssue=false
"""The clock of a gait, and its open-loop steps by MuJoCo's forward kinematics."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from humanoid_mjx import InputError, make_task
from humanoid_mjx.mechanics import gaits
from humanoid_mjx.mechanics.pattern_generator import mean_posture
from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.lower_body import SIDES, LowerBody
from humanoid_mjx.tasks.legged.gait import Clock, Gait, Steps
from humanoid_mjx.tasks.legged.thesis_gaits import FORTH, Oscillators, TableSteps

BODY = LowerBody(ranges="human")
STAND, ON_THE_SPOT = jnp.zeros(3), jnp.array([1e-6, 0.0, 0.0])


def test_the_clock_turns_while_the_body_is_to_move():
    gait = Steps(period=0.4, cadence=0.5, stance=0.75, lift=10.0, sway=4.0)
    phases = jnp.linspace(0.0, 1.0, 401)[:-1]
    swing = np.asarray(jax.jit(jax.vmap(lambda phase: gait.swing(phase, BODY)))(phases))
    np.testing.assert_allclose((swing > 1e-6).mean(axis=0), 0.25, atol=0.01)
    np.testing.assert_allclose(swing[:, 0], np.roll(swing[:, 1], 200), atol=1e-5)
    assert not (swing > 1e-6).all(axis=1).any() and swing.max() == pytest.approx(1.0, abs=1e-3)
    assert gait.after(Clock(0.9), ON_THE_SPOT, 0.08, BODY).phase == pytest.approx(0.1, abs=1e-6)
    assert gait.after(Clock(0.9), STAND, 0.08, BODY).phase == 0.0 and not np.any(
        gait.reference(Clock(0.3), STAND, BODY)
    )
    assert gait.cycle_time(jnp.array([0.6, -0.8, 0.5])) == pytest.approx(0.4 / 1.5)
    motion = jax.jit(jax.vmap(lambda phase: gait.reference(Clock(phase), ON_THE_SPOT, BODY)))(phases)
    motion = np.degrees(motion).reshape(-1, 2, 5)
    pitch, yaw, roll, knee, ankle = motion.transpose(2, 0, 1)
    np.testing.assert_allclose(ankle, pitch - knee, atol=1e-5)
    np.testing.assert_allclose(knee.max(axis=0), 20.0, atol=0.01)
    np.testing.assert_allclose(roll[:, 0], -roll[:, 1], atol=1e-5)
    np.testing.assert_allclose(yaw, 0.0, atol=1e-3)


def feet_by(gait, phase, command):
    """Positions and rotations of the feet by MuJoCo's forward kinematics, under a torso that does not move."""
    data = mujoco.MjData(make_task("walk").simulator.model)
    joints = BODY.posture + np.asarray(gait.reference(Clock(phase), jnp.array(command), BODY))
    data.qpos[:] = np.r_[0, 0, 0.5, 1, 0, 0, 0, joints]
    mujoco.mj_kinematics(data.model, data)
    return [np.array([getattr(data.body(f"{side}_foot"), name) for side in SIDES]) for name in ("xpos", "xmat")]


@pytest.mark.parametrize("robot", [BODY, make_robot("humanoid")])
def test_a_robot_may_rise_and_sway_farther(robot):
    command, far = jnp.array([0.3, 0.1, 0.5]), robot.model_copy(update={"steps": 2.5})
    for phase in (0.1, 0.4, 0.8):
        told = Steps(lift=10.0, sway=4.0).reference(Clock(phase), command, far)
        np.testing.assert_allclose(told, Steps(lift=25.0, sway=10.0).reference(Clock(phase), command, robot), atol=1e-6)


@pytest.mark.parametrize("phase", [0.1, 0.2, 0.6])
def test_a_lifted_foot_stays_level(phase):
    _, rotation = feet_by(Steps(lift=12.0, sway=0.0), phase, (0.3, 0.0, 0.0))
    np.testing.assert_allclose(rotation, np.tile(np.eye(3).ravel(), (2, 1)), atol=1e-6)  # the reference is float32


@pytest.mark.parametrize(
    "command", [(0.3, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.15, 0.0), (0.0, 0.0, 1.0), (0.2, 0.1, 0.5)]
)
def test_a_standing_foot_goes_back_as_the_ground_does(command):
    """In mid-stance, and there and back in one period; the ground turns, too, under a body that does."""
    gait, seconds = Steps(), 1e-2
    period = float(gait.cycle_time(jnp.array(command)))
    for foot, middle in enumerate((0.69, 0.19)):
        (before, turned_before), (after, turned_after) = (
            [part[foot] for part in feet_by(gait, middle + side * seconds / period / 2, command)] for side in (-1, 1)
        )
        place = (before + after) / 2
        ground = -np.array([command[0] - command[2] * place[1], command[1] + command[2] * place[0]])
        # Legs are links that turn, so their feet's ways bend, and headings turn about leaning axes: a step of 10 ms
        # averages over some of it, 3 % of the fastest command.
        np.testing.assert_allclose((after - before)[:2] / seconds, ground, atol=0.01)
        turn = (turned_after.reshape(3, 3) @ turned_before.reshape(3, 3).T)[1, 0] / seconds
        assert turn == pytest.approx(-command[2], abs=0.03)
    ways = np.array([feet_by(gait, phase, command)[0] for phase in np.linspace(0.0, 1.0, 41)])
    # A cubic comes back: no jump from the last to the first, and none on the way.
    np.testing.assert_allclose(ways[0], ways[-1], atol=1e-6)
    assert np.abs(np.diff(ways, axis=0)).max() < 0.03


def test_a_foot_leaves_the_ground_and_lands_as_fast_as_the_ground_goes():
    gait, small = Steps(stance=0.6), 2e-3
    for end in (float(BODY.phases[0]), float(BODY.phases[0]) + 0.4):
        for side in (-1.5, 0.5):  # before and after
            ends = [gait.sweep(jnp.float32(end + (side + step) * small), BODY)[0] for step in (0.0, 1.0)]
            # The cubic bends: within 0.002 of a period its speed changes by 0.25 of 3.3.
            assert (ends[1] - ends[0]) / small == pytest.approx(-2.0 / 0.6, rel=0.1)


def motion_of(gait, command, seconds, start=0.0, dt=0.02):
    """(decisions, joints) The reference under a command that stays, and the phases."""
    clock, angles, phases = gait.start(jnp.float32(start), BODY), [], []
    after, reference = jax.jit(gait.after), jax.jit(gait.reference)
    for _ in range(round(seconds / dt)):
        clock = after(clock, jnp.array(command), dt, BODY)
        angles.append(reference(clock, jnp.array(command), BODY))
        phases.append(clock.phase)
    return np.array(angles), np.array(phases)


def test_a_table_is_played_about_its_mean_as_fast_as_the_body_is_to_go():
    """A hip swings back as far as the body goes meanwhile, and comes forth in the foot's turn to swing."""
    gait, command = TableSteps(period=0.8, cadence=0.0), jnp.array([0.1, 0.0, 0.0])
    printed = gaits.gait("straight_walk")
    times = np.array([0.0, 0.1333, 0.2667, 0.4, 0.5333, 0.6667])
    size = float(gait.amplitude(command, BODY))
    for time in times:
        expected = size * (printed.at(time).position - mean_posture(printed))
        angles = gait.reference(Clock(time / 0.8 - FORTH), command, BODY)
        np.testing.assert_allclose(angles[:5], expected, atol=1e-5)  # float32
        np.testing.assert_allclose(
            gait.reference(Clock(time / 0.8 - FORTH + 0.5), command, BODY)[5:], expected, atol=1e-5
        )
    pitch = size * np.radians(15.0 - -15.0)
    # From the table's foremost hip, at 0.5333 s, to its rearmost, at 0.2667 s of the next period.
    assert BODY.build.reach * pitch == pytest.approx(0.1 * (0.8 - 0.5333 + 0.2667), rel=1e-3)
    assert not np.any(gait.reference(Clock(0.3), STAND, BODY)) and not np.any(
        gait.reference(Clock(0.3), command * 0, BODY)
    )


def test_oscillators_walk_as_their_table_once_they_have_settled():
    command = (0.2, 0.0, 0.0)
    angles, phases = motion_of(Oscillators(), command, 4.0)
    table = TableSteps()
    settled = np.array([table.reference(Clock(phase), jnp.array(command), BODY) for phase in phases[-24:]])
    np.testing.assert_allclose(angles[-24:], settled, atol=2e-3)  # e^(-8 * 3.5) is left of the start, float32 of phases
    assert np.abs(angles[0]).max() < 0.2 * np.abs(settled).max()  # it begins in the posture
    still, _ = motion_of(Oscillators(), (0.0, 0.0, 0.0), 0.2)
    assert not still.any()


def test_a_gait_is_chosen_by_name():
    assert isinstance(make_task("walk").gait, Steps)
    assert isinstance(make_task("walk", gait={"stride": 0.5}).gait, Steps)
    assert make_task("walk", gait={"name": "table", "table": "sudden_turn", "period": 0.6}).gait.table == "sudden_turn"
    clock = make_task("walk", gait="clock").gait
    assert type(clock) is Gait and not np.any(clock.reference(Clock(0.3), ON_THE_SPOT, BODY))
    with pytest.raises(InputError, match=r"gait.name: unknown gait 'tables'; did you mean 'table'\?"):
        make_task("walk", gait="tables")
