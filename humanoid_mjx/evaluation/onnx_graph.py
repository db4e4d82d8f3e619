"""JAX functions as ONNX graphs: elementwise arithmetic, products, reductions, and movement of numbers.

A function is traced to a jaxpr. Operations on constants alone are computed here. Operations that only move numbers,
such as slices, transposes and gathers at constant places, become one `Gather` from the flat array; the places follow
from the same operation on the numbers 0, 1, 2, ... Shapes are static: one state, no batch.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.spec import InputError, package

OPSET, IR_VERSION = 18, 9

SAME = {
    **{name: name.capitalize() for name in ("add", "sub", "mul", "div", "max", "min", "neg", "abs", "sign", "floor")},
    **{name: name.capitalize() for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "erf", "pow", "ceil")},
    **{name: name.capitalize() for name in ("asin", "acos", "atan", "and", "or", "not", "round")},
    "eq": "Equal",
    "lt": "Less",
    "le": "LessOrEqual",
    "gt": "Greater",
    "ge": "GreaterOrEqual",
    "logistic": "Sigmoid",
}
"""Elementwise operations of JAX and their names in ONNX."""

MOVES = (
    *("slice", "split", "unstack", "dynamic_slice", "gather", "transpose", "reshape", "squeeze", "expand_dims"),
    *("broadcast_in_dim", "tile", "rev", "copy", "copy_p", "stop_gradient"),
)
"""Operations that move numbers; only their first operand is not constant."""

COMPOSED: dict[str, Callable[..., str]] = {
    "clamp": lambda node, low, x, high, _: node("Min", [node("Max", [low, x]), high]),
    "square": lambda node, x, _: node("Mul", [x, x]),
    "rsqrt": lambda node, x, _: node("Reciprocal", [node("Sqrt", [x])]),
    "log1p": lambda node, x, one: node("Log", [node("Add", [x, one])]),
    "expm1": lambda node, x, one: node("Sub", [node("Exp", [x]), one]),
    "ne": lambda node, x, y, _: node("Not", [node("Equal", [x, y])]),
    "rem": lambda node, x, y, _: node("Mod", [x, y], fmod=1),
    "atan2": lambda node, y, x, one: node("Add", [node("Atan", [node("Div", [y, x])]), _half_turn(node, y, x, one)]),
}
"""Elementwise operations made of several in ONNX; the last argument is 1 in the type of the result."""

REDUCES = {"reduce_sum": "ReduceSum", "reduce_max": "ReduceMax", "reduce_min": "ReduceMin", "reduce_or": "ReduceMax"}


def to_onnx(
    function: Callable[..., Any],
    inputs: Mapping[str, jax.ShapeDtypeStruct],
    outputs: Sequence[str],
    metadata: Mapping[str, str],
) -> bytes:
    """Return a function of arrays of these shapes and types, by name, as an ONNX model that carries texts by key. The
    function returns a tuple of arrays, whose names are `outputs`.

    Raises:
      InputError: the package onnx is missing, or the function has an operation that is not translated.
    """
    onnx = package("onnx", "onnx", "an ONNX file")
    closed = jax.make_jaxpr(function)(*inputs.values())
    graph = _Graph(onnx)
    found = graph.run(closed.jaxpr, closed.consts, list(inputs))
    for name, value in zip(outputs, found, strict=True):
        graph.node("Identity", [value], name)
    info, kind = onnx.helper.make_tensor_value_info, onnx.helper.np_dtype_to_tensor_dtype
    head = [info(name, kind(np.dtype(x.dtype)), x.shape) for name, x in inputs.items()]
    tail = [info(name, kind(x.dtype), x.shape) for name, x in zip(outputs, closed.out_avals, strict=True)]
    whole = onnx.helper.make_graph(graph.nodes, "policy", head, tail, graph.constants)
    opset = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(whole, opset_imports=opset, ir_version=IR_VERSION, producer_name="humanoid_mjx")
    onnx.helper.set_model_props(model, dict(metadata))
    onnx.checker.check_model(model)
    return model.SerializeToString()


class _Graph:
    """Nodes and constants of a graph. A value is the name of a tensor, or a constant as an array."""

    def __init__(self, onnx: Any):
        self.onnx, self.nodes, self.constants = onnx, [], []

    def node(self, kind: str, values: Sequence[Any], name: str = "", **attributes: Any) -> str:
        """Add a node, and return the name of its only output."""
        name = name or f"t{len(self.nodes)}"
        self.nodes.append(self.onnx.helper.make_node(kind, [self.named(x) for x in values], [name], **attributes))
        return name

    def named(self, value: Any) -> str:
        if isinstance(value, str):
            return value
        self.constants.append(self.onnx.numpy_helper.from_array(np.asarray(value), f"c{len(self.constants)}"))
        return self.constants[-1].name

    def run(self, jaxpr: Any, consts: Sequence[Any], values: Sequence[Any]) -> list[Any]:
        """Add the operations of a jaxpr, and return its results."""
        known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *values], strict=True))

        def read(var: Any) -> Any:
            return np.asarray(var.val, var.aval.dtype) if hasattr(var, "val") else known[var]

        for eqn in _needed(jaxpr):
            found = self.equation(eqn, [read(var) for var in eqn.invars])
            known.update(zip(eqn.outvars, found, strict=True))
        return [read(var) for var in jaxpr.outvars]

    def equation(self, eqn: Any, values: list[Any]) -> Sequence[Any]:
        """Add one operation, and return its results."""
        name, params, out = eqn.primitive.name, eqn.params, eqn.outvars[0].aval
        if not any(isinstance(x, str) for x in values):
            found = eqn.primitive.bind(*map(jnp.asarray, values), **params)
            return found if eqn.primitive.multiple_results else [found]
        inner = next((params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in params), None)
        if inner is not None and name not in ("while", "scan", "cond"):
            inner, consts = getattr(inner, "jaxpr", inner), getattr(inner, "consts", ())
            return self.run(inner, consts, values)
        if name == "optimization_barrier":
            return values
        if name in MOVES and not any(isinstance(x, str) for x in values[1:]):
            shape = eqn.invars[0].aval.shape
            order = jnp.arange(np.prod(shape, dtype=int)).reshape(shape)
            places = eqn.primitive.bind(order, *map(jnp.asarray, values[1:]), **params)
            return [self.gathered(values[0], x) for x in (places if eqn.primitive.multiple_results else [places])]
        return [self.operation(eqn, name, params, values, out)]

    def operation(self, eqn: Any, name: str, params: Any, values: list[Any], out: Any) -> str:
        """Add one operation with one result."""
        if name in SAME:
            return self.node(SAME[name], values)
        if name in COMPOSED:
            return COMPOSED[name](self.node, *values, np.asarray(1, out.dtype))
        if name == "scatter" and not isinstance(values[1], str):
            shape, updates = eqn.invars[0].aval.shape, eqn.invars[2].aval.shape
            order = jnp.arange(np.prod(updates, dtype=int)).reshape(updates)
            place = eqn.primitive.bind(jnp.full(shape, -1), jnp.asarray(values[1]), order, **params)
            return self.node("Where", [np.asarray(place) < 0, values[0], self.gathered(values[2], place.clip(0))])
        if name in ("concatenate", "stack"):
            axis = params.get("dimension", params.get("axis"))
            rows = [self.node("Unsqueeze", [x, np.array([axis])]) for x in values] if name == "stack" else values
            return self.node("Concat", rows, axis=axis)
        if name == "convert_element_type":
            return self.cast(values[0], out)
        if name == "select_n" and len(values) == 3 and eqn.invars[0].aval.dtype == bool:
            return self.node("Where", [values[0], values[2], values[1]])
        if name == "integer_pow":
            return self.node("Pow", [values[0], np.asarray(params["y"], out.dtype)])
        if name == "argmax":
            return self.cast(self.node("ArgMax", values, axis=params["axes"][0], keepdims=0), out)
        if name in REDUCES:
            number = self.cast(values[0], jnp.int32(0)) if out.dtype == bool else values[0]
            reduced = self.node(REDUCES[name], [number, np.array(params["axes"])], keepdims=0)
            return self.cast(reduced, out) if out.dtype == bool else reduced
        if name == "dot_general":
            return self.node("Einsum", values, equation=_equation(params, *(x.aval.ndim for x in eqn.invars)))
        raise InputError(f"an ONNX file cannot hold the operation {name} of this policy; write an .npz.")

    def cast(self, value: Any, like: Any) -> str:
        """Return a value in the type of another."""
        return self.node("Cast", [value], to=self.onnx.helper.np_dtype_to_tensor_dtype(np.dtype(like.dtype)))

    def gathered(self, value: Any, places: Any) -> str:
        """Return the numbers of a value at these places of its flat array."""
        return self.node("Gather", [self.node("Reshape", [value, np.array([-1])]), np.asarray(places, np.int64)])


def _half_turn(node: Callable[..., str], y: Any, x: Any, one: Any) -> str:
    """Return the angle that `atan2` adds to the arc tangent of y / x: half a turn where x is negative."""
    turn = node("Where", [node("Less", [y, 0 * one]), -np.pi * one, np.pi * one])
    return node("Where", [node("Less", [x, 0 * one]), turn, 0 * one])


def _needed(jaxpr: Any) -> list[Any]:
    needed, found = {var for var in jaxpr.outvars if not hasattr(var, "val")}, []
    for eqn in reversed(jaxpr.eqns):
        if needed.intersection(eqn.outvars):
            found.insert(0, eqn)
            needed.update(var for var in eqn.invars if not hasattr(var, "val"))
    return found


def _equation(params: Any, left: int, right: int) -> str:
    """Return the equation of `Einsum` for a `dot_general` of arrays of so many axes."""
    letters = iter("abcdefghijklmnopqrstuvwxyz")
    (contract_one, contract_two), (batch_one, batch_two) = params["dimension_numbers"]
    one, two = [next(letters) for _ in range(left)], [""] * right
    for a, b in zip((*contract_one, *batch_one), (*contract_two, *batch_two), strict=True):
        two[b] = one[a]
    two = [letter or next(letters) for letter in two]
    rest = [x for i, x in enumerate(one) if i not in (*contract_one, *batch_one)]
    rest += [x for i, x in enumerate(two) if i not in (*contract_two, *batch_two)]
    return f"{''.join(one)},{''.join(two)}->{''.join([*(one[a] for a in batch_one), *rest])}"
