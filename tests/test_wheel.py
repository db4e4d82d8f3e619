"""The wheel, made of the source distribution and installed where the checkout cannot be seen: it finds its configs and
policies by name, trains, reports and plays."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """A function that runs Python where only the wheel and the packages it needs can be imported."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)  # the source distribution, and of that the wheel
    assert len(list(folder.glob("*.tar.gz"))) == 1
    (wheel,) = folder.glob("*.whl")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder / "venv")], check=True)
    python = folder / "venv/bin/python"
    packages = next((folder / "venv").glob("lib/python*/site-packages"))
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(packages)], check=True)
    # The packages that it needs come from this environment; a line of a .pth file adds their folder without reading
    # the .pth files in it, one of which may lead to the checkout.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    def run(*arguments):
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        return subprocess.run(
            [str(python), *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )

    run.built = [str(path) for path in folder.glob("*.whl")] + [str(path) for path in folder.glob("*.tar.gz")]
    where = run("-c", "import humanoid_mjx; print(humanoid_mjx.__file__)").stdout
    assert str(packages) in where, where
    return run


def test_registries_accept_both_files(clean):
    pytest.importorskip("twine")
    done = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", *clean.built], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and done.stdout.count("PASSED") == 2, done.stdout + done.stderr


SEVERAL = """
import sys
from humanoid_mjx.cli import app
for words in sys.argv[1:]:
    app(words.split(), standalone_mode=False)
"""
"""Commands in one process, each a word of several."""


def test_what_ships_is_found_by_name(clean):
    done = clean("-c", SEVERAL, "info", "reproduce --list", "info joint1")
    assert done.returncode == 0, done.stderr
    assert "300 points x 16 seeds" in done.stdout and "table-7.1" in done.stdout
    assert "posture_switch" in done.stdout.partition("policies")[2]


def test_what_ships_is_played(clean):
    done = clean("-m", "humanoid_mjx", "play", "posture_switch", "--out", "switch.png")
    assert done.returncode == 0 and "switch.png" in done.stdout, done.stderr


def test_a_sweep_runs(clean):
    changes = ["--set", "seeds=2", "--set", "episodes=20", "--set", "sweep.axes={learner.epsilon: [0.5]}"]
    done = clean("-m", "humanoid_mjx", "sweep", "joint5", *changes)
    assert done.returncode == 0, done.stderr
    assert "runs/joint5/results.parquet" in done.stdout
    done = clean("-m", "humanoid_mjx", "report", "runs/joint5")
    assert done.returncode == 0 and "runs/joint5/report.html" in done.stdout, done.stderr


def test_what_ships_measures(clean):
    done = clean("-m", "humanoid_mjx", "bench", "compare", "a.json", "b.json")
    assert done.returncode == 2 and "a.json: not a result of `bench --json`" in done.stderr, done.stderr
