"""The command `demo`."""

from contextlib import suppress

import jax

from humanoid_mjx.commands import console, start_for
from humanoid_mjx.training.progress import Bar


def run_demo(port: int | None) -> None:
    """`humanoid-mjx demo`: the shipped policy `walk_sturdy` walks in the browser until somebody steers it."""
    start_for(None, ())
    jax.config.update("jax_platforms", "cpu")  # one robot in native MuJoCo gains nothing by a GPU
    from humanoid_mjx.evaluation.live import Live
    from humanoid_mjx.evaluation.policy import find_policy, on_plane
    from humanoid_mjx.report.live import serve

    with Bar(console) as bar:
        bar.phase("loading")
        live = Live(on_plane(find_policy("walk_sturdy")))
    live.told |= {"forward, m/s": 0.3}
    with suppress(KeyboardInterrupt):
        serve(live, console.print, port=port or 0)
