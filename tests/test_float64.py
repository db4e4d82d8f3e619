"""Runs the tests of tests/float64 in a process where jax computes in double precision from its start."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent


def test_in_double_precision():
    command = [sys.executable, "-m", "pytest", str(TESTS / "float64"), "--override-ini", "addopts=", "-q"]
    result = subprocess.run(
        command, cwd=TESTS.parent, env=os.environ | {"JAX_ENABLE_X64": "1"}, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
