"""Step responses against scipy's integration of the same system."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from humanoid_mjx.control.response import step_response


@pytest.mark.parametrize("ratio", [0.05, 0.5, 0.97, 1.0, 1.0005, 1.02, 2.0, 5.0])
@pytest.mark.parametrize("omega", [1.0, 8.0, 40.0])
def test_step_response(omega, ratio):
    time = np.linspace(0.0, 5.0, 501)
    system = ([omega**2], [1.0, 2.0 * ratio * omega, omega**2])
    reference = lsim(system, np.ones_like(time), time)[1]
    np.testing.assert_allclose(step_response(jnp.array(time), omega, ratio), reference, rtol=0, atol=1e-10)
