"""The suite checks types and shapes at every call of the package, by `typecheck.py`."""

import jax.numpy as jnp
import pytest
import typecheck
from jaxtyping import Array, Float

from humanoid_mjx.config import dump_yaml
from humanoid_mjx.mechanics.rotations import product


def test_a_wrong_shape_or_type_is_an_error():
    one = jnp.array([1.0, 0.0, 0.0, 0.0])
    with pytest.raises(Exception, match="Type-check error"):
        product(one, one[:3])
    with pytest.raises(Exception, match=r"dump_yaml\(\) parameter .* violates type hint"):
        dump_yaml(3)


def test_dimensions_of_one_name_are_of_one_length_wherever_they_stand():
    @typecheck.jaxtyped(typechecker=typecheck.check)
    def both(one: Float[Array, " n"] | None, other: list[Float[Array, " n"]]) -> int:
        return len(other)

    assert both(jnp.zeros(3), [jnp.zeros(3)]) == 1
    with pytest.raises(Exception, match="Type-check error"):
        both(jnp.zeros(3), [jnp.zeros(4)])


def test_a_function_without_annotations_is_left_as_it_is():
    def plain(x):
        return x

    assert typecheck.jaxtyped(plain, typechecker=typecheck.check) is plain
