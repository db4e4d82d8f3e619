"""The commands `play` and `export`."""

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import jax

from humanoid_mjx.commands import console, start_for
from humanoid_mjx.files import write_text
from humanoid_mjx.spec import InputError, check_folder
from humanoid_mjx.training.progress import Bar


def run_play(
    name: str,
    point: int | None,
    overrides: Sequence[str],
    physics: str | None,
    episode: int,
    out: Path | None,
    size: str | None,
    fps: float | None,
    view: bool,
    port: int | None,
    robots: int,
) -> None:
    """`humanoid-mjx play`."""
    if view and (out or size or fps):
        raise InputError("play: --view shows the robot in the browser; --out, --size, --fps are of a file: choose one.")
    if view and physics not in (None, "mujoco"):
        raise InputError(f"--physics {physics}: --view moves the robot in native MuJoCo; leave this out.")
    if view and any(override.startswith("task.terrain") for override in overrides):
        raise InputError("--set task.terrain: --view has a slope to set and no other ground; --out shows a terrain.")
    if port is not None and not view:
        raise InputError("--port: only --view has a server.")
    if robots > 1 and not view:
        raise InputError("--robots: a film shows one robot; add --view.")
    pixels = _pixels(size) if size else None
    start_for(physics, overrides)
    if physics in (None, "mujoco"):
        jax.config.update("jax_platforms", "cpu")  # one robot in native MuJoCo gains nothing by a GPU
    from humanoid_mjx.report.rendering import FPS, check_file

    if out is not None:
        check_file(out)
    if view:
        from humanoid_mjx.evaluation.live import Live
        from humanoid_mjx.evaluation.policy import find_policy, in_world, on_plane
        from humanoid_mjx.report.live import serve

        with Bar(console) as bar:
            bar.phase("loading")
            trained = on_plane(in_world(find_policy(name, point), physics, overrides))
        with suppress(KeyboardInterrupt):
            serve(Live(trained, episode, robots), console.print, port=port or 0)
        return
    from humanoid_mjx.commands.notebook import film

    with Bar(console) as bar:
        bar.phase("loading")
        found = film(name, bar, point, episode, physics, overrides, out, fps=fps or FPS, size=pixels)
    console.print(found.words)
    console.print(f"{found.path}", soft_wrap=True)


def _pixels(size: str) -> tuple[int, int]:
    """Width and height of `--size`."""
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    width, height = (int(number) for number in found.groups()) if found else (0, 0)
    if not all(64 <= number <= 4096 and number % 2 == 0 for number in (width, height)):
        raise InputError(f"--size {size}: write WIDTHxHEIGHT, such as 640x480: even numbers from 64 to 4096.")
    return width, height


def run_export(what: str, file: Path, point: int | None) -> None:
    """`humanoid-mjx export`."""
    if file.suffix not in (".xml", ".npz", ".c", ".onnx"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz, .c or .onnx, for a policy.")
    check_folder(file)
    from humanoid_mjx.evaluation.deploy import check_place, contract_of, write_contract, write_onnx, write_robot
    from humanoid_mjx.evaluation.policy import find_policy, save_policy

    paths = [file]
    if file.suffix in (".onnx", ".c"):
        check_place(file)
    if file.suffix == ".npz":
        save_policy(find_policy(what, point), file)
    elif file.suffix == ".onnx":
        paths = write_onnx(find_policy(what, point), file)
    elif file.suffix == ".c":
        from humanoid_mjx.evaluation.c_source import c_source

        trained = find_policy(what, point)
        write_text(file, c_source(trained))
        paths.append(write_contract(contract_of(trained), file))
    else:
        write_robot(what, file, point)
    for path in paths:
        console.print(f"{path}", soft_wrap=True)
