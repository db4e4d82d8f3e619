"""Functions of small arrays as programs of single numbers."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.kernels.numbers import scalarised


def turned(angle, vectors):
    """Vectors after a turn about z, and their products with each other."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    turn = jnp.stack([jnp.stack([c, -s, 0.0 * c]), jnp.stack([s, c, 0.0 * s]), jnp.eye(3, dtype=c.dtype)[2]])
    found = turn @ vectors
    return {"turned": found, "products": found.T @ found, "third": found[2]}


def test_values_and_derivatives_are_those_of_the_arrays():
    rng = np.random.default_rng(0)
    angles, vectors = np.float32(rng.normal(size=20)), np.float32(rng.normal(size=(20, 3, 4)))
    for function in turned, lambda *args: jax.jacrev(turned, argnums=(0, 1))(*args):
        expected = jax.vmap(function)(angles, vectors)
        own = scalarised(turned) if function is turned else jax.jacrev(scalarised(turned), argnums=(0, 1))
        found = jax.jit(jax.vmap(own))(angles, vectors)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), found, expected)
    alone = scalarised(turned)(angles[0], vectors[0])  # nothing is traced
    np.testing.assert_array_equal(alone["third"], vectors[0, 2])


def test_known_elements_and_those_of_a_symmetric_matrix_cost_nothing():
    names: Counter[str] = Counter()

    def count(jaxpr):
        for eqn in jaxpr.eqns:
            names[eqn.primitive.name] += eqn.outvars[0].aval.shape == ()
            for inner in jax.tree.leaves(eqn.params, is_leaf=lambda x: hasattr(x, "jaxpr")):
                count(inner.jaxpr) if hasattr(inner, "jaxpr") else None

    count(jax.make_jaxpr(scalarised(turned))(jnp.float32(0.0), jnp.zeros((3, 4))).jaxpr)
    assert names["dot_general"] == 0
    assert names["mul"] == 4 * 4 + 10 * 3  # two rows of the turn have two elements; 10 of 16 products differ


def test_rows_and_scans_are_those_of_xla():
    """jax 0.11 has an operation of its own for the elements of a vector, and names a scan's parts anew."""

    def function(matrix, vector):
        def step(carry, row):
            a, b, c = row
            return (carry[0] + a * b, carry[1] - c), a - carry[1]

        first, *_, last = jnp.unstack(vector)
        (total, rest), each = jax.lax.scan(step, (first * last, vector.sum()), matrix, reverse=True)
        return total, rest, each

    rng = np.random.default_rng(1)
    args = np.float32(rng.normal(size=(10, 4, 3))), np.float32(rng.normal(size=(10, 5)))
    expected, found = jax.vmap(function)(*args), jax.jit(jax.vmap(scalarised(function)))(*args)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6), found, expected)
