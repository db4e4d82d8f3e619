"""Double precision, chosen before anything computes, here and in processes that tests start."""

import os

import jax

os.environ["JAX_ENABLE_X64"] = "1"
jax.config.update("jax_enable_x64", True)
