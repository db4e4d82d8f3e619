"""Elliptic cones of friction: the nearest point of a cone, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.mechanics.tree.cones import Cone

SLOPES = (0.0, 0.1, 0.8)


def residuals():
    """In the cone, in its polar cone, between them, on the axis and at the tip; a cone of each slope for each."""
    rng = np.random.default_rng(0)
    some = np.concatenate([rng.normal(size=(200, 3)), [[1, 0, 0], [-1, 0, 0], [0, 0, 0], [0, 1e-30, 0]]])
    slopes, some = np.repeat(SLOPES, len(some)), np.tile(some, (len(SLOPES), 1))
    some[slopes == 0.0, 1:] = 0.0  # without friction the tangents are stretched to nothing
    return slopes.astype(np.float32), some.astype(np.float32)


def cone_of(slope):
    one = np.ones((1, 1), np.float32)
    return Cone(slope.reshape(1, 1), one, one)


def pull(slope, residual):
    rows = cone_of(slope).root(residual[:, None, None])[..., 0, 0]
    return rows.T @ rows @ residual


def test_the_pull_is_the_way_from_the_nearest_point():
    """Moreau: a residual is the sum of a point of the cone and one of its polar cone at right angles to each other."""
    slopes, some = residuals()
    pulled = np.asarray(jax.vmap(pull)(slopes, some), float)
    near = some - pulled
    length, other = (np.linalg.norm(v[:, 1:], axis=1) for v in (near, pulled))
    assert (near[:, 0] >= slopes * length - 1e-5).all()
    assert (slopes * pulled[:, 0] + other <= 1e-5).all() and (pulled[:, 0] <= 1e-5).all()
    np.testing.assert_allclose((near * pulled).sum(axis=1), 0.0, atol=1e-5)


def test_the_root_and_the_slopes_along_a_way_are_derivatives():
    slopes, some = residuals()
    apart = np.abs(some).max(axis=1) > 1e-3
    slopes, some = slopes[apart], some[apart]
    way = np.random.default_rng(1).normal(size=some.shape).astype(np.float32) * (some != 0.0)

    def of_one(slope, residual, way):
        cone, v, w = cone_of(slope), residual[:, None, None], way[:, None, None]
        rows = cone.root(v)[..., 0, 0]
        return rows.T @ rows, jnp.stack(cone.along(v, w))[:, 0, 0]

    stiffness, along = jax.vmap(of_one)(slopes, some, way)
    bend = jax.vmap(jax.jacfwd(pull, 1))(slopes, some)
    assert np.isfinite(bend).all()
    np.testing.assert_allclose(bend @ way[..., None], stiffness @ way[..., None], atol=1e-4)
    first = (jax.vmap(pull)(slopes, some) * way).sum(axis=1)
    second = np.einsum("wi,wij,wj->w", way, bend, way)
    np.testing.assert_allclose(along, np.stack([first, second], axis=1), atol=1e-4)


def test_impratio_stretches_the_tangents_and_flattens_the_cone():
    """MuJoCo: friction is `impratio` times as stiff as the normal, and `mu = friction / sqrt(impratio)`."""
    cone = Cone.of(np.full((1, 1), 0.8), np.full((1, 1), 0.4), 25.0)
    np.testing.assert_allclose([float(part[0, 0]) for part in cone], [0.16, 5.0, 2.5])
