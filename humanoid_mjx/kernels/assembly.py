"""Inline assembly in GPU kernels, for what Pallas does not have: shared memory, and conversions that saturate."""

from typing import Any

import jax
from jax.experimental.pallas import triton as gpu
from jaxtyping import Array


def assembly(code: str, constraints: str, dtype: Any, *args: Array) -> Array:
    """Run PTX `code` on each element of arrays of one shape, for an array of this type (LLVM's constraints)."""
    result = jax.ShapeDtypeStruct(args[0].shape, dtype)
    return gpu.elementwise_inline_asm(code, args=args, constraints=constraints, pack=1, result_shape_dtypes=[result])[0]
