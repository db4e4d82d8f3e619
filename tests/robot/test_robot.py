"""Descriptions of robots: what follows from a model, and what is no robot is refused."""

import numpy as np
import pytest

from humanoid_mjx.robot import make_robot
from humanoid_mjx.robot.lower_body import JOINTS, LowerBody
from humanoid_mjx.spec import InputError

BODY = LowerBody(ranges="human")


def test_the_lower_body_is_one():
    assert BODY.joints == JOINTS and BODY.points == 4 and BODY.foot_pairs.tolist() == [[0, 1]]
    assert BODY.model is BODY.model and make_robot("lower_body", ranges="human") == BODY
    np.testing.assert_array_equal(BODY.torque_limits, np.full(10, 2.0))
    np.testing.assert_array_equal(BODY.phases, [0.0, 0.5])
    order, signs = BODY.joint_images
    assert order.tolist() == [5, 6, 7, 8, 9, 0, 1, 2, 3, 4] and (signs == 1).all()
    assert BODY.start_height == 0.21
    assert BODY.leg_length == pytest.approx(0.19 * np.cos(np.radians(15)) + 0.025, abs=1e-9)


def test_it_is_written_as_it_was_chosen():
    assert BODY.model_dump(mode="json") == {"name": "lower_body", "ranges": "human"}


def test_an_unknown_robot_is_refused():
    with pytest.raises(InputError, match="unknown robot 'arm'; known are dog, humanoid, leg, legs, lower_body"):
        make_robot("arm")
