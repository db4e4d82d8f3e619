"""Where a kernel cannot be made XLA computes the same, one line says so, and the exit code is 0."""

import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from small_sweep import assert_same_tables, write_config

from humanoid_mjx import compute, sweep
from humanoid_mjx.compute import kept
from humanoid_mjx.compute.options import PASSES
from humanoid_mjx.kernels import cpu_kernel, fallback, threads, worlds
from humanoid_mjx.kernels.numbers import scalarised
from humanoid_mjx.training.programs import programs

X = np.linspace(-2.0, 2.0, 60, dtype=np.float32).reshape(20, 3)


def wave(x):
    return x[0] * jax.numpy.sin(x[1]) + x[2]


def missing_package(monkeypatch):
    for name in ("llvmlite", "llvmlite.binding"):
        monkeypatch.setitem(sys.modules, name, None)
    cpu_kernel._machine.cache_clear()


def unknown_operation(monkeypatch):
    monkeypatch.setattr(threads, "ARITHMETIC", {"add"})


def error_of_llvm(monkeypatch):
    def fail(name, code):
        raise RuntimeError("LLVM ERROR: cannot select\nsecond line")

    monkeypatch.setattr(cpu_kernel, "_compiled", fail)


def change_header(monkeypatch, old, new):
    header = (Path(jax.ffi.include_dir()) / "xla/ffi/api/c_api.h").read_text()
    assert old in header
    monkeypatch.setattr(Path, "read_text", lambda self, *_: header.replace(old, new))
    cpu_kernel._version.cache_clear()


def other_interface(monkeypatch):
    change_header(monkeypatch, "#define XLA_FFI_API_MAJOR 0", "#define XLA_FFI_API_MAJOR 1")


def other_layout(monkeypatch):
    change_header(monkeypatch, "XLA_FFI_Args args;", "int64_t more; XLA_FFI_Args args;")


def error_of_triton(monkeypatch):
    def fail(*_, **__):
        raise NotImplementedError("Unimplemented primitive in Pallas Triton lowering: foo")

    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(worlds, "gpu_kernel", fail)


FAULTS = {
    "ModuleNotFoundError": missing_package,
    "threads do no": unknown_operation,
    "LLVM ERROR: cannot select": error_of_llvm,
    "interface 1.": other_interface,
    "is not one that was tested": other_layout,
    "Pallas Triton lowering": error_of_triton,
}


@pytest.fixture(autouse=True)
def kernels_again():
    """Kernels are made anew before and after each test."""
    cpu_kernel.forget()
    worlds.one_kernel.cache_clear()
    programs.cache_clear()
    yield
    for cached in (cpu_kernel._version, cpu_kernel._machine, worlds.one_kernel, programs):
        cached.cache_clear()
    cpu_kernel.forget()
    fallback.reasons.clear()
    fallback.given_up.clear()


@pytest.mark.parametrize("words", FAULTS)
def test_xla_computes_what_a_kernel_would(words, monkeypatch, caplog):
    expected = jax.vmap(wave)(X)
    FAULTS[words](monkeypatch)
    function = jax.jit(jax.vmap(worlds.one_kernel(wave)))
    np.testing.assert_allclose(function(X), expected, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.vmap(worlds.one_kernel(wave)))(X[:7]), expected[:7], rtol=1e-6)
    assert PASSES not in compute.compiler_options("tree")  # with it XLA aborts
    (line,) = caplog.messages
    assert words in line and "XLA computes instead, which takes about" in line and "\n" not in line


def test_single_numbers_that_cannot_be_are_arrays(monkeypatch, caplog):
    unknown_operation(monkeypatch)
    function = jax.jit(jax.vmap(scalarised(wave)))
    np.testing.assert_allclose(function(X), jax.vmap(wave)(X), rtol=1e-6)
    (line,) = caplog.messages
    assert "threads do no" in line


def test_a_command_goes_on(monkeypatch, said, caplog):
    missing_package(monkeypatch)
    code, out, _ = said("info", "stand_cpu")
    assert code == 0 and "1 run" in out
    assert [line for line in caplog.messages if "No kernel can be made here" in line]


def failing_with_kernels(function, words="INTERNAL: Failed to compile Triton kernel"):
    """`function`, which fails as a compiler does until kernels are given up."""

    def call(*args):
        if not fallback.given_up:
            raise jax.errors.JaxRuntimeError(words)
        return function(*args)

    return call


def test_a_program_that_fails_to_compile_is_compiled_without_kernels(caplog):
    assert fallback.with_fallback(failing_with_kernels(lambda x: x))(3) == 3
    assert fallback.given_up[0] == "JaxRuntimeError: INTERNAL: Failed to compile Triton kernel"
    assert len(caplog.messages) == 1

    def fail():
        raise jax.errors.JaxRuntimeError("INTERNAL: ptxas failed")

    with pytest.raises(jax.errors.JaxRuntimeError):  # kernels were given up before: they are not the reason
        fallback.with_fallback(fail)()


EXACT = {
    "task": {"name": "joint_reach", "joint": 5, "action": 15.0, "states": 5},
    "learner": {"name": "tabular_q", "discount": 0.5},
    "sweep": {"axes": {"learner.epsilon": [0.25, 0.5], "learner.learning_rate": [0.25, 0.5]}},
}
"""Products of powers of two, which no compiler rounds. With users' settings both round alike (`as_shipped`)."""


@pytest.mark.parametrize("fault", [None, "ModuleNotFoundError", "LLVM ERROR: cannot select"])
def test_a_sweep_goes_on_without_kernels(fault, monkeypatch, caplog, tmp_path):
    config = write_config(tmp_path, **EXACT)
    expected = sweep(config, tmp_path / "expected", quiet=True)
    assert cpu_kernel._compiled_of.cache_info().currsize == 1  # a kernel trained it
    programs.cache_clear()
    if fault is None:
        monkeypatch.setattr(kept, "compile_program", failing_with_kernels(kept.compile_program))
    else:
        cpu_kernel.forget()
        FAULTS[fault](monkeypatch)
    sweep(config, tmp_path / "found", quiet=True)
    assert len(caplog.messages) == 1
    assert cpu_kernel._compiled_of.cache_info().currsize == (fault is None)
    assert_same_tables(expected.path, tmp_path / "found")


@pytest.mark.parametrize("error", [ValueError("reward has another shape"), MemoryError()])
def test_an_error_of_another_kind_is_not_taken_for_a_kernels(error, caplog):
    def function():
        raise error

    with pytest.raises(type(error)):
        fallback.with_fallback(function)()
    assert not caplog.messages and not fallback.given_up
