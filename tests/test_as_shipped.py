"""Runs the tests of the kernels that users have, in a process where XLA makes these: the others have plain ones."""

import os
import subprocess
import sys
from pathlib import Path

from conftest import AS_SHIPPED

TESTS = Path(__file__).parent


def test_with_the_kernels_that_ship():
    files = [str(TESTS / name) for name in AS_SHIPPED]
    command = [sys.executable, "-m", "pytest", *files, "--override-ini", "addopts=", "-q"]
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    result = subprocess.run(command, cwd=TESTS.parent, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
