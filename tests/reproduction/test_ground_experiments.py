"""What is found on the ground: who stands, that no table of gaits walks; and the measures of a path."""

import numpy as np
import pytest
from test_leg_experiments import by_name

from humanoid_mjx.control import make_law
from humanoid_mjx.reproduction import ground, ground_experiments, load_experiments
from humanoid_mjx.reproduction.ground import (
    LASTS_S,
    PHASES,
    Path,
    Trial,
    _plan,
    _until_fall,
    balanced,
    laws_of,
    physics,
)
from humanoid_mjx.thesis import leg as thesis

NAMES = ("gaits-4.8", "ground-control")
SIGNS = ((1, 1, 1), (1, -1, -1))
"""As printed, and with knee and ankle reversed, where the soles stay nearly flat."""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:  # 18 bodies, and 24: two calls of one program
        patch.setattr(ground, "AT_ONCE", 24)
        for name, value in (("SIGNS", SIGNS), ("IMPULSES", (0.2, 0.4, 0.7)), ("PHASES", PHASES[:1]), ("SECONDS", 1.6)):
            patch.setattr(ground_experiments, name, value)
        return by_name(NAMES, tmp_path_factory.mktemp("ground"))


def test_computed_torque_stands_only_if_it_knows_the_contacts(found):
    blind, *pushes, roll = found[1]["ground-control"]
    assert {f.verdict for f in (blind, *pushes)} == {"finding"} and blind.reproduced < 1.5
    # A push that a body with ankles that do not roll stands, it stands as well with hips that do not.
    assert roll.verdict == "differs" and roll.reproduced[1] >= roll.reproduced[0] >= 0.3
    assert "within the contacts computed torque stands, and a servo of 6 N m/rad stands" in blind.why
    # Both are thrown over by a push that a rigid body on these feet would not stand either.
    assert all(0.1 <= taken <= 0.6 for push in pushes for taken in push.reproduced)


def test_rolls_that_help_against_pushes_from_the_side_would_be_found():
    def judged(free, held):
        taken = {("servo", "sideways"): free, (ground_experiments.ROLL_HELD, "sideways"): held}
        return ground_experiments.judge_roll(taken).verdict

    assert (judged(0.5, 0.3), judged(0.3, 0.3)) == ("reproduced", "differs")


def test_the_gaits_of_the_tables_fall_in_every_reading(found):
    out, findings = found
    assert {f.verdict for f in findings["gaits-4.8"]} == {"differs"}
    walk, turn = (f for f in findings["gaits-4.8"] if "seconds of 1.6" in f.quantity)
    assert all(f.verdict == "differs" and 0.6 < f.reproduced[0] < 1.6 for f in (walk, turn))
    rows = [[x.strip("| ") for x in row.split(" | ")] for row in (out / "gaits-4.8.md").read_text().splitlines()[2:]]
    assert len(rows) == 2 * 3 + 2 * 2 * 3, "signs, senses of the yaw, controllers"
    assert not [row for row in rows if "(all)" in row[3]]
    as_read = [row for row in rows if row[1].startswith("no sign reversed") and "left leg" not in row[1]]
    off = {(row[0], row[2]): float(row[6]) for row in as_read}
    for table in ("Table 4.5", "Table 4.6"):
        assert off[table, "computed torque"] < 0.7 * off[table, "servo"]


def test_the_experiments_use_the_gains_of_the_laws():
    for name in NAMES:
        laws = laws_of(load_experiments()[name].config)
        assert laws["servo"] == make_law("pd") and laws["computed torque"] == make_law("grounded")
        blind = laws["section 5.7"].gains
        np.testing.assert_allclose(blind, [2 * thesis.KP, 2 * thesis.KD], rtol=1e-6)


def carried(yaw, speed, steps=51):
    """A standing body that slides forwards over the ground at `speed` and turns by `yaw` at even rates."""
    times = physics().step_s * np.arange(steps)
    qpos = np.tile(physics().qpos0, (steps, 1))
    angle = yaw * times / times[-1]
    qpos[:, 0], qpos[:, 2] = speed * times, qpos[:, 2] - 1e-6
    qpos[:, 3], qpos[:, 6] = np.cos(angle / 2), np.sin(angle / 2)
    qvel = np.zeros((steps, 16))
    qvel[:, 0], qvel[:, 5] = speed, yaw / times[-1]
    return _until_fall(qpos, qvel, np.zeros((steps, 10)))


def test_measures_of_a_path():
    slides = carried(0.0, 0.3)
    assert not slides.fell and slides.touching.all() and slides.seconds == 0.2
    assert slides.distance == pytest.approx(0.06)
    turns = carried(-0.5, 0.0)
    assert turns.turned[-1] == pytest.approx(np.degrees(-0.5))
    assert turns.distance == pytest.approx(0.0, abs=2e-3)


def test_a_turn_that_goes_back_within_a_period_does_not_last():
    steps = 551
    path = carried(-0.5, 0.0, steps)
    assert path.lasting_turn == pytest.approx(np.degrees(-0.5) * (1 - LASTS_S / 2.2), rel=0.01)
    yaw = 0.5 * np.sin(2 * np.pi * np.arange(steps) / 200)  # a period of 0.8 s
    path.qpos[:, 3], path.qpos[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    assert abs(path.turned[-1]) > 5.0 and path.lasting_turn == 0.0


def test_the_left_leg_does_what_its_phase_says():
    plans = {phase: np.asarray(_plan(Trial("servo", "straight_walk", phase=phase), 1.6).qpos) for phase in PHASES}
    right = {phase: plan[:, :5] for phase, plan in plans.items()}
    assert all((right[phase] == right["equal"]).all() for phase in PHASES)
    np.testing.assert_array_equal(plans["equal"][:, 5:], right["equal"])
    np.testing.assert_array_equal(plans["opposite"][:, 5:], -right["equal"])
    late = plans["half a period later"][:, 5:]
    np.testing.assert_allclose(late[100:], right["equal"][:-100], atol=1e-5)


def test_a_body_that_moves_evenly_has_its_zero_moment_point_below_its_mass():
    inside = balanced(carried(0.0, 0.3))
    assert len(inside) == 50 and inside.all()
    # The feet reach 20 mm behind the ankles, the mass is a little before them: 30 mm further the point is outside.
    path = carried(0.0, 0.3)
    path.corners[..., 0] += 0.03
    assert not balanced(path).any()


def test_a_path_ends_with_the_fall():
    qpos = np.tile(physics().qpos0, (10, 1))
    qpos[6:, 3:7] = np.cos(0.6), np.sin(0.6), 0.0, 0.0
    path: Path = _until_fall(qpos, np.zeros((10, 16)), np.zeros((10, 10)))
    assert path.fell and len(path.qpos) == 6
