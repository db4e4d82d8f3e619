"""Fallback to XLA where a kernel cannot be made.

Whatever a kernel computes XLA can compute, too, only slower. llvmlite may not import, a new jax may name an operation
anew, LLVM or Triton may fail: then a warning says so, and the program goes on.
"""

import importlib
import logging
from collections.abc import Callable
from contextvars import ContextVar
from functools import wraps
from typing import Any

import jax

SLOWER = {"cpu": "about 100 times", "gpu": "about 6 times or more"}
"""Time that XLA takes in units of a kernel's, by backend: 65 for lower bodies that stand, 120 that move, on two cores
(`benchmarks/guard.py` with and without llvmlite); of a training of `walk` on one H200 by an earlier program of XLA
(`docs/bench/h200_one_kernel.json`)."""

WORDS = ("triton", "pallas", "ptx", "mosaic", "nvvm", "libnvjitlink", "humanoid_mjx_")
"""Words of errors, one of which names a kernel where XLA compiles the program around it."""

reasons: list[str] = []
"""Reasons why kernels were not made in this process; programs are then not kept for the next process."""

given_up: list[str] = []
"""The reason why this process makes no more kernels, the first of those listed; empty if it makes them."""


def why_none() -> str | None:
    """Return the reason why no kernels are made here; None if they are, on a CPU by llvmlite or on a GPU by Triton."""
    backend = jax.default_backend()
    if backend == "cpu" and not given_up:
        try:
            importlib.import_module("llvmlite.binding")
        except Exception as error:  # whatever it is, XLA does not need it
            given_up.append(warn(error))
    major = str(getattr(jax.local_devices()[0], "compute_capability", "")).partition(".")[0]
    if backend == "gpu" and not (major.isdigit() and int(major) >= 8):
        return "the GPU is not of NVIDIA's Ampere or later ones"
    if backend not in SLOWER:
        return f"kernels are made for CPUs and GPUs, not for {backend!r}"
    return given_up[0] if given_up else None


_again: ContextVar[bool] = ContextVar("_again", default=False)
"""True within a call that `with_fallback` would repeat."""


def _reason(error: BaseException) -> str:
    words = (str(error).strip() or "no message").splitlines()[0]
    return f"{type(error).__name__}: {words}"[:200]


def warn(error: BaseException) -> str:
    """Warn, once for each reason, that XLA computes what a kernel would; return the reason."""
    reason = _reason(error)
    if reason not in reasons:
        reasons.append(reason)
        logging.getLogger(__name__).warning(
            "No kernel can be made here (%s); XLA computes instead, which takes %s as long.",
            reason,
            SLOWER.get(jax.default_backend(), "several times"),
        )
    return reason


def by_xla_instead(error: Exception) -> None:
    """Warn that XLA computes what a kernel would, while it is traced, and make no more kernels in this process.

    Programs without kernels have other options of XLA, which are chosen before a program is traced.

    Raises:
      Exception: the error, where the program will be traced and compiled again, with these options.
    """
    reason = warn(error)
    if _again.get():
        raise error
    given_up.append(reason)


def with_fallback(function: Callable[..., Any], renew: Callable[[], object] = lambda: None) -> Callable[..., Any]:
    """Return a function that compiles, and compiles again without kernels if one of its kernels cannot be made.

    `renew`: called before the second attempt.
    """

    @wraps(function)
    def call(*args: Any) -> Any:
        without, before = bool(given_up), _again.set(not given_up)
        try:
            return function(*args)
        except Exception as error:
            said = f"{type(error).__name__} {error}".lower()
            if without or not (_reason(error) in reasons or any(word in said for word in WORDS)):
                raise
            given_up.append(warn(error))
        finally:
            _again.reset(before)
        jax.clear_caches()
        renew()
        return function(*args)

    return call
