"""`humanoid-mjx demo` shows a robot that walks by itself until somebody steers it."""

import jax
from typer.testing import CliRunner

from humanoid_mjx.cli import app
from humanoid_mjx.report import live


def test_the_demo_walks(monkeypatch):
    shown = []
    monkeypatch.setattr(live, "serve", lambda robots, told, port, others: shown.append((robots, port, [*others])))
    assert CliRunner().invoke(app, ["demo", "--port", "8123"]).exit_code == 0
    ((robots, port, others),) = shown
    assert others[0] == "walk_sturdy" and {"walk", "walk_dog"} < {*others}
    assert robots.trained.name == "walk_sturdy" and port == 8123 and jax.default_backend() == "cpu"
    assert robots.told["forward, m/s"] == 0.3
    low, high = robots.ranges["forward, m/s"]
    assert low <= 0.3 <= high and not robots.task.push.impulse
