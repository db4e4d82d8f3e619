"""The commands `play` and `demo`."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Option

from humanoid_mjx.commands import Physics, Point, Policy, Trust, Unmodified, World, console, start_for, trusting
from humanoid_mjx.training.progress import Bar


def play(
    policy: Policy,
    point: Point = None,
    set_: World = None,
    physics: Physics = None,
    unmodified: Unmodified = False,
    episode: Annotated[int, Option(metavar="N", min=0, max=10**6, help="Number of the held-out episode.")] = 0,
    out: Annotated[
        Path | None, Option(metavar="FILE", help=".gif, .mp4, .webm, .png; by default RUN/figures/play.gif")
    ] = None,
    size: Annotated[str | None, Option(metavar="WxH", help="Pixels of each picture, 480x360.")] = None,
    fps: Annotated[float | None, Option(metavar="N", min=1, max=100, help="Pictures a second, 25.")] = None,
    view: Annotated[bool, Option("--view", help="Steer the robot in this machine's browser.")] = False,
    port: Annotated[int | None, Option(min=1, max=65535, help="Port of --view; by default any free one.")] = None,
    robots: Annotated[int, Option(metavar="N", min=1, max=16, help="Robots in --view, each in its own episode.")] = 1,
    trust: Trust = False,
) -> None:
    """Show a policy as a video or picture of the robot, or steer the robot in the browser."""
    from humanoid_mjx.spec import InputError

    set_ = set_ or []
    if view and (out or size or fps):
        raise InputError("play: --view shows the robot in the browser; --out, --size, --fps are of a file: choose one.")
    if view and physics not in (None, "mujoco"):
        raise InputError(f"--physics {physics}: --view moves the robot in native MuJoCo; leave this out.")
    if view and any(override.startswith("task.terrain") for override in set_):
        raise InputError("--set task.terrain: --view has a slope to set and no other ground; --out shows a terrain.")
    if unmodified and physics not in (None, "mujoco"):
        raise InputError(f"--physics {physics}: --unmodified plays in native MuJoCo; leave one of them out.")
    physics = "unmodified" if unmodified else physics
    if port is not None and not view:
        raise InputError("--port: only --view has a server.")
    if robots > 1 and not view:
        raise InputError("--robots: a film shows one robot; add --view.")
    pixels = _pixels(size) if size else None
    if view:
        with trusting(trust, policy):
            _show(policy, point, set_, physics, episode, robots, port)
        return
    _start(physics, set_)
    from humanoid_mjx.api import film
    from humanoid_mjx.report.rendering import FPS, check_file

    if out is not None:
        check_file(out)
    with trusting(trust, policy), Bar(console) as bar:
        bar.phase("loading")
        found = film(policy, bar, point, episode, physics, set_, out, fps=fps or FPS, size=pixels)
    console.print(found.words)
    console.print(f"{found.path}", soft_wrap=True)


def demo(
    port: Annotated[int | None, Option(min=1, max=65535, help="Port of the page; by default any free one.")] = None,
) -> None:
    """Show a walking robot in the browser, to be steered and pushed."""
    _show("walk_sturdy", port=port, told={"forward, m/s": 0.3})


def _start(physics: str | None, changes: Sequence[str]) -> None:
    """Prepare this process for one robot, which gains nothing by a GPU in native MuJoCo."""
    start_for(physics, changes)
    import jax

    if physics in (None, "mujoco", "unmodified"):
        jax.config.update("jax_platforms", "cpu")


def _show(
    policy: str,
    point: int | None = None,
    changes: Sequence[str] = (),
    physics: str | None = None,
    episode: int = 0,
    robots: int = 1,
    port: int | None = None,
    told: Mapping[str, float] = {},
) -> None:
    """Serve the page of a policy's robots until Ctrl-C; `told`: parts of the command that they follow at first."""
    _start(physics, changes)
    from humanoid_mjx.evaluation.live import Live
    from humanoid_mjx.evaluation.policy import find_policy, in_worlds, played_by
    from humanoid_mjx.files import names
    from humanoid_mjx.report.live import serve

    def made(name: str, point: int | None = None) -> Live:
        found = in_worlds([find_policy(name, point, changes)], [physics], changes)
        for words in played_by(found):
            console.print(words)
        return Live(found[0], episode, robots)

    with Bar(console) as bar:
        bar.phase("loading")
        live = made(policy, point)
    live.told |= told
    others = {name: partial(made, name) for name in names("policies", ".npz")}
    with suppress(KeyboardInterrupt):
        serve(live, console.print, port=port or 0, others={policy: partial(made, policy, point), **others})


def _pixels(size: str) -> tuple[int, int]:
    from humanoid_mjx.spec import InputError

    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    width, height = (int(number) for number in found.groups()) if found else (0, 0)
    if not all(64 <= number <= 4096 and number % 2 == 0 for number in (width, height)):
        raise InputError(f"--size {size}: write WIDTHxHEIGHT, such as 640x480: even numbers from 64 to 4096.")
    return width, height
