"""How a contact between bodies changes the solution, in float32 beside the dense formula in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from humanoid_mjx.mechanics.tree import pair_equations
from humanoid_mjx.mechanics.tree.contacts import Touch


@pytest.mark.parametrize("friction", [1.0, 0.1, 0.01, 1e-5])
def test_stiffness_is_right_whatever_the_friction(friction):
    """MuJoCo's weight of a facet grows without bound as friction vanishes, and the facets become one."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(500, 3, 3))
    compliance = root @ root.swapaxes(1, 2) + 0.05 * np.eye(3)
    flags = rng.random((500, 4)) < 0.6
    weight = 1e3 / (2.0 * friction**2 * (1.0 + friction**2))

    facets = np.array([[1.0, friction, 0.0], [1.0, -friction, 0.0], [1.0, 0.0, friction], [1.0, 0.0, -friction]])
    stiffness = weight * np.einsum("wf,fi,fj->wij", flags, facets, facets)
    expected = np.linalg.solve(np.eye(3) + stiffness @ compliance, stiffness)

    def inner(compliance, flags):
        touch = Touch((), (), (), (), jnp.full((1, 1), weight), (), (friction, friction))
        return pair_equations._inner(touch, flags[:, None, None], compliance[..., None, None])[..., 0, 0]

    found = np.array(jax.jit(jax.vmap(inner))(np.float32(compliance), flags))
    error = np.linalg.norm((found - expected) @ compliance, axis=(1, 2))
    assert error.max() < 1e-3  # of shares of a force; the compliances' condition is up to a thousand
