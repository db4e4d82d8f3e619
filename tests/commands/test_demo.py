"""`humanoid-mjx demo` shows a robot that walks by itself until somebody steers it."""

import jax
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.report import live


def test_the_demo_walks(monkeypatch):
    shown = []
    monkeypatch.setattr(live, "serve", lambda robots, told, port: shown.append((robots, port)))
    assert CliRunner().invoke(app, ["demo", "--port", "8123"]).exit_code == 0
    ((robots, port),) = shown
    assert robots.trained.name == "walk_sturdy" and port == 8123 and jax.default_backend() == "cpu"
    assert robots.told["forward, m/s"] == 0.3
    low, high = robots.ranges["forward, m/s"]
    assert low <= 0.3 <= high and not robots.task.push.impulse
