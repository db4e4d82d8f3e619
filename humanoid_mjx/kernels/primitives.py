"""The primitives of jax that more than one reader of traced functions knows."""

ELEMENTWISE = frozenset(
    (
        *("abs", "add", "and", "ceil", "clamp", "convert_element_type", "div", "eq", "exp", "floor", "ge", "gt"),
        *("integer_pow", "is_finite", "le", "log", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "rem"),
        *("round", "select_n", "shift_left", "shift_right_arithmetic", "shift_right_logical", "sign", "sqrt", "square"),
        *("sub", "xor"),
    )
)
"""Primitives that act on each element alone; more than these are known to one reader or the other."""

CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}
CALLS |= {"custom_vmap_call": "call"}
"""Primitives that call a traced function, and the parameter that holds it."""
