"""A policy as C: the same values to rounding, the same actions where no two choices are as good."""

import numpy as np
import pytest
from c_policy import answers

from humanoid_mjx import InputError
from humanoid_mjx.commands.play import run_export


@pytest.mark.parametrize("name", ["walk", "stand"])
def test_a_shipped_policy_acts_the_same(tmp_path, name):
    q, found, actions, _ = answers(name, tmp_path)
    # Sums of up to 256 products in another order, through four layers, in single precision.
    tolerance = 2e-4 * q.std()
    np.testing.assert_allclose(found, q, atol=tolerance)
    first, second = np.sort(q, axis=-1)[..., :-3:-1].transpose(2, 0, 1)
    clear = first - second > 2 * tolerance
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(actions[clear], q.argmax(axis=-1)[clear])


def test_only_networks_become_c(tmp_path):
    with pytest.raises(InputError, match="posture_switch: only policies of deep_q can be written as C"):
        run_export("posture_switch", tmp_path / "policy.c", None)
