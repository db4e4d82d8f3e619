"""Every verdict can turn: an experiment that is fed another printed value, or another result, judges otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim
from test_ground_experiments import carried

from humanoid_mjx.reproduction import (
    Finding,
    errata,
    gains,
    ground,
    ground_experiments,
    motor_sizing,
    postures,
    reproduce,
    robustness,
    tracking,
)
from humanoid_mjx.reproduction import decision_process as process
from humanoid_mjx.reproduction import joint_ways as ways
from humanoid_mjx.reproduction import workspace as space
from humanoid_mjx.reproduction.findings import Setting, as_text, unprinted
from humanoid_mjx.thesis import leg
from humanoid_mjx.thesis import q_learning as thesis


def verdicts(name, out, containing=""):
    return [finding.verdict for finding in reproduce([name], out) if containing in finding.quantity]


def changed(values, index, by):
    """`values` with `by` added to one of them."""
    return tuple(value + by if i == index else value for i, value in enumerate(values))


def table_with(joint, by):
    stay, move = thesis.TABLES[joint]
    return thesis.TABLES | {joint: (stay, changed(move, 4, by))}


FORCED = ["not_reproducible", "consistent", "reproduced", "consistent", "consistent"]
WALKING = leg.WORKSPACE | {"straight walking": ((-0.16, -0.2084, 0.0413), (-0.1194, -0.0405, 0.0412))}
TURN = leg.WORKSPACE | {"sudden turn": ((-0.17289, -0.20784, -0.12834), (-0.01698, 0.05331, 0.04222))}
START = leg.FIGURE_7_5 | {"start": changed(leg.FIGURE_7_5["start"], 4, 1e-7)}

WRONG = {
    "table-7.1": (thesis, "TABLES", table_with(1, 0.01), "", ["differs"]),
    "table-7.2": (thesis, "TABLES", table_with(4, 0.01), "", ["differs"]),
    "table-7.3": (thesis, "TABLES", table_with(5, 0.01), "", ["differs"]),
    "table-5.1": (leg, "KD", tuple(2 * np.sqrt(leg.KP)), "", ["reproduced"] * 5),
    "table-4.2": (leg, "STALL_TORQUES", (1.0, 0.0, -5.0, 0.0, 0.0), "", FORCED),
    "figure-7.1": (leg, "FIGURE_7_1", ((-0.8, 0.7875), *leg.FIGURE_7_1[1:]), "", ["differs", "differs"]),
    "workspace-7b": (leg, "WORKSPACE", WALKING, "straight walking,", ["differs", "recovered", "differs"]),
    "figure-7.3": (leg, "WORKSPACE", TURN, "from where", ["recovered"]),
    "figure-7.5": (leg, "FIGURE_7_5", START, "at the start", ["consistent"] * 4 + ["differs"]),
    "figure-7.11": (thesis, "FIGURE_MARKS", {1: (((4, 6), 40.0), ((45, 49), 75.0))}, "", ["differs", "recovered"]),
    "figure-7.13": (thesis, "FIGURE_MARKS", {4: (((7, 12), 25.0), ((54, 60), 10.0))}, "", ["recovered", "differs"]),
    "figure-7.15": (thesis, "FIGURE_MARKS", {5: (((4, 9), -10.0), ((16, 18), 40.0))}, "", ["recovered", "differs"]),
    "figure-7.12": (thesis, "AVERAGE_RANDOM_NUMBER", {1: 0.4}, "", ["differs"]),
    "figure-7.14": (thesis, "AVERAGE_RANDOM_NUMBER", {4: 0.6}, "", ["differs"]),
    "figure-7.16": (thesis, "AVERAGE_RANDOM_NUMBER", {5: 0.7}, "", ["differs"]),
    "finding-singularity": (space, "SINGULAR", 0.0, "", [*["reproduced"] * 3, "differs"]),
    "motor-sizing": (motor_sizing, "MOTORS", np.full(5, 10.0), "", ["reproduced", "consistent", *["reproduced"] * 4]),
    "figure-7.17": (thesis, "POSTURES", {"0": ((0.0,) * 3, (0.0,) * 3)}, "", ["reproduced"]),
}
"""By experiment: the module and the name of what is changed, the value put there, whose verdicts, and what they are."""


@pytest.mark.parametrize("name", WRONG)
def test_another_value_turns_the_verdict(name, monkeypatch, tmp_path):
    module, attribute, value, containing, expected = WRONG[name]
    before = verdicts(name, tmp_path, containing)
    monkeypatch.setattr(module, attribute, value)
    assert verdicts(name, tmp_path, containing) == expected
    if name != "figure-7.17":
        assert before != expected and len(before) == len(expected)


def test_the_maxima_of_a_model_that_was_tried_are_recovered(monkeypatch, tmp_path):
    from humanoid_mjx.reproduction import planned_torques

    trials = planned_torques._trials()
    monkeypatch.setattr(planned_torques, "_trials", lambda: trials)
    monkeypatch.setattr(leg, "MAX_TORQUES", tuple(trials[-1].maxima))
    assert verdicts("table-4.7", tmp_path, "joint ")[:5] == ["recovered"] * 5


def test_a_hemisphere_would_be_seen():
    points = np.random.default_rng(0).normal(size=(20_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    ball = points * [1, -np.sign(points[:, 1:2]).ravel()[0], 1]
    half = np.where(np.arange(3) == 1, -np.abs(ball), ball)
    lengths = space.LENGTHS["lengths"]
    assert space._hemisphere("all joints", half, lengths).verdict == "recovered"
    assert space._hemisphere("all joints", points, lengths).verdict == "differs"
    stretched = 0.1 * np.array([1.0, 1.5, 0.5]) * points
    assert space._ellipsoid("all joints", stretched, lengths).verdict == "recovered"
    assert space._ellipsoid("all joints", stretched[points[:, 0] > -0.5], lengths).verdict == "differs"


def test_a_straight_leg_locks_where_nothing_pushes_it_aside():
    assert space.judge_locking(0.0, 1.0).verdict == "reproduced"
    assert space.judge_locking(0.1, -1.0).verdict == "differs"
    hip, knee, ankle = leg.LINK_LENGTHS[1] + leg.LINK_LENGTHS[2], *leg.LINK_LENGTHS[3:]
    beyond = np.cumsum([ankle, knee, hip])[::-1]  # the height of the toe falls by this times half the square of a turn
    heights = beyond[np.maximum.outer(range(3), range(3))]
    assert space.straight_stiffness(1e4) == pytest.approx(-1e4 * np.linalg.eigvalsh(heights).max(), rel=1e-3)


def test_remedies_that_cure_are_reproduced():
    cured = [f.verdict for f in tracking.judge_remedies(*np.zeros((4, 5)))]
    assert cured == ["reproduced"] * 3 + ["finding"]
    assert [f.verdict for f in tracking.judge_remedies(*np.ones((4, 5)))] == ["differs"] * 3 + ["finding"]


def test_the_pooled_marks_tell_epsilon(tmp_path):
    pooled = ways._epsilon({1: 18, 4: 22, 5: 7}, {1: 45, 4: 54, 5: 16}, ways.CONFIG)
    assert pooled.verdict == "differs" and "2.5 standard deviations" in pooled.why
    fewer = ways._epsilon({1: 14, 4: 16, 5: 5}, {1: 45, 4: 54, 5: 16}, ways.CONFIG)
    assert fewer.verdict == "recovered", "the step of 5 degrees is not printed"
    assert reproduce(["epsilon-7e"], tmp_path, ["learner.epsilon=0.8"])[0].verdict == "recovered"
    assert ways._averages({1: 0.4, 4: 0.4}, {1: 50, 4: 50}).verdict == "differs"


@pytest.mark.parametrize(("share", "expected"), [(1.0, "reproduced"), (0.0, "differs")])
def test_waiting_turns_with_the_share_that_arrives(share, expected, monkeypatch, tmp_path):
    monkeypatch.setattr(process, "_greedy_success", lambda task, axes: np.full(len(axes["learner.discount"]), share))
    assert verdicts("finding-waiting", tmp_path) == [expected] * 3


def test_stepping_back_turns_with_the_share_that_does_not():
    costs = np.array(process.BACK_REWARDS) < 0
    assert process._stepping_back(np.where(costs, 0.0, 1.0)).verdict == "reproduced"
    assert process._stepping_back(np.where(np.arange(len(costs)) == len(costs) - 1, 0.0, 1.0)).verdict == "differs"


def test_a_printed_formula_that_is_right_is_reproduced():
    states = errata._states(errata.CIRCLE)
    entry = [each for each in errata.ENTRIES if each.fault == "none"][-1]
    assert errata._compare(replace(entry, printed=entry.right), states).verdict == "reproduced"
    assert errata._compare(replace(entry, printed=f"1.01 * ({entry.right})"), states).verdict == "differs"


def test_computed_torque_can_lose():
    shape = len(robustness.CYCLES), len(robustness.MODELS)
    even = dict.fromkeys(robustness.LAWS, np.full(shape, 0.1))
    lost = robustness.judge_errors(even | {"computed torque": np.full(shape, 0.2)})
    assert [f.verdict for f in lost] == ["differs"] * 3
    assert robustness.judge_cost({"servo": 30, "partitioned PD": 176, "computed torque": 170}).verdict == "differs"


def walk(yaw=0.0, speed=0.3):
    """A standing body that goes forwards for a second, without a fall, and turns by `yaw`, degrees."""
    return carried(np.radians(yaw), speed, 251)


def test_gaits_that_walk_and_turn_are_reproduced():
    straight, turned = walk(), walk(30.0)
    played = {
        trial: turned if trial.motion == "sudden_turn" and trial.same_yaw else straight
        for trial in ground_experiments.printed_trials()
    }
    level = {id(path): ground.balanced(path) for path in (straight, turned)}
    inside = {trial: level[id(path)] for trial, path in played.items()}
    found = [f for f in ground_experiments.on_tables(played, inside) if f.printed is not None]
    assert len(found) == 5 and {f.verdict for f in found} == {"reproduced"}
    fallen = {trial: path._replace(fell=True) for trial, path in played.items()}
    again = [f for f in ground_experiments.on_tables(fallen, inside) if f.printed is not None]
    assert [f.verdict for f in again] == ["differs", "reproduced", "differs", "reproduced", "differs"]


def test_going_back_is_no_walk():
    paths = walk(), walk(speed=-0.3), walk(30, 0.0)
    assert [ground_experiments.walks(path) for path in paths] == [True, False, False]


def test_dynamics_are_involved_unless_the_mass_changes_nothing():
    switch = postures.Switch(settling=1.0, overshoot=0.0, energy=1.0, peak=0.1)
    assert postures._involves_dynamics("7H", switch, switch).verdict == "reproduced"
    assert postures._involves_dynamics("7H", switch, switch._replace(settling=1.1)).verdict == "differs"


def test_the_sign_of_the_knee(monkeypatch):
    assert postures._sign().verdict == "recovered"
    start, (hip, knee, ankle) = thesis.POSTURES["7H"]
    monkeypatch.setattr(thesis, "POSTURES", {"7H": (start, (hip, -knee, ankle))})
    assert postures._sign().verdict == "differs"


def test_nothing_printed_is_no_verdict():
    assert unprinted("y", 1.0, "why").verdict == "finding"
    with pytest.raises(ValueError, match="'differs', but printed is None"):
        Finding("y", None, 1.0, None, "differs", "why")
    with pytest.raises(ValueError, match="'finding', but printed is 1"):
        Finding("y", 1.0, 1.0, None, "finding", "why")


def test_responses_are_those_of_scipy():
    times, ratios = np.linspace(0.0, 30.0, 1501), np.array([0.0, 0.05, 0.97, 1.0, 1.0005, 2.0, 3.0])
    found = gains._step_responses(times, ratios)
    for ratio, response in zip(ratios, found, strict=True):
        reference = lsim(([1.0], [1.0, 2.0 * ratio, 1.0]), np.ones_like(times), times)[1]
        np.testing.assert_allclose(response, reference, rtol=0, atol=1e-10)


def test_gains_of_table_5_1_are_twice_overdamped(tmp_path):
    ratios, critical = [1.985, 1.819, 2.003, 2.357, 2.032], [16.12, 16.49, 16.97, 16.12, 16.73]
    np.testing.assert_allclose(gains._damping_ratios(), ratios, atol=5e-4)
    for found, kd, pole in zip(
        gains.table(Setting({}, tmp_path)), critical, [-2.18, -2.47, -2.27, -1.80, -2.20], strict=True
    ):
        assert f"times the critical {kd:.2f}: the slow pole is {pole:.2f} /s" in found.why


def test_critical_damping_is_the_fastest_without_overshoot(monkeypatch):
    times = np.linspace(0.0, 30.0, 6001)
    right = gains._step_responses(times, gains.RATIOS)
    fastest, close, stable = (f.verdict for f in gains.judge_responses(times, right))
    assert (fastest, close, stable) == ("reproduced", "differs", "differs")
    shifted = gains._step_responses(times, gains.RATIOS + 0.1)
    fastest, close, _ = (f.verdict for f in gains.judge_responses(times, shifted))
    assert (fastest, close) == ("differs", "reproduced")
    monkeypatch.setattr(gains, "_slowest_decay", lambda ratios: 0.1)
    assert gains.judge_responses(times, right)[2].verdict == "reproduced"


def test_tracking_without_the_interaction_has_a_verdict_where_no_rotor_decides_it():
    good = np.zeros((len(robustness.ROTORS), len(robustness.HIGH)))
    assert robustness.judge_tracking(good).verdict == "reproduced"
    assert robustness.judge_tracking(good + 1.0).verdict == "differs"
    some = good + np.arange(len(robustness.HIGH))
    assert robustness.judge_tracking(some).verdict == "finding" and "4 track" in robustness.judge_tracking(some).why


def test_gains_against_their_bound():
    kp = np.array(leg.KP)
    for factor, verdicts_of in (
        (1.1, ["reproduced", "reproduced"]),
        (0.9, ["differs", "reproduced"]),
        (1e4, ["consistent", "differs"]),
    ):
        assert [f.verdict for f in gains.judge_gains(kp, factor * kp)] == verdicts_of


def test_values_are_written_to_all_printed_digits():
    assert as_text([0.272241706, 1e-5, 3, None]) == "0.272241706, 1e-05, 3, nothing"
    assert as_text({"largest": 0.1 + 0.2, "median": (1.0, True), "unit": ""}) == "largest: 0.3; median: 1, True"
