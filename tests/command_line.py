"""Commands in this process."""

from typer.testing import CliRunner

from humanoid_mjx.cli import app


def told(*words):
    """Return the output of a command, which must succeed; its InputError is raised."""
    done = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output
