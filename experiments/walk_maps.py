"""Map in which worlds policies of the lower body walk: shares upright after 20 s at 0.3 m/s, by two values at a time.

    python experiments/walk_maps.py walk runs/walk_sturdy --json docs/bench/walk_maps.json --out docs/walk_maps.png

    python experiments/walk_maps.py --json docs/bench/walk_maps.json --out docs/walk_maps.png    # draws a record

A run folder stands for all training seeds of its best point; the figure has a column for each policy or run folder.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chapter_8 import pushed_from
from jaxtyping import Float
from walk_worlds import PLAIN

import humanoid_mjx
from humanoid_mjx import compute
from humanoid_mjx.evaluation.evaluate import held_out_keys
from humanoid_mjx.evaluation.gait.scenarios import settings_of, trained_seeds
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, in_world
from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.rollout import greedy, rollout
from humanoid_mjx.report.style import SEQUENTIAL, figure
from humanoid_mjx.tasks.legged.walk import SENSORS

AHEAD = "{forward: [0.3, 0.3], sideways: [0.0, 0.0], turn: [0.0, 0.0], standing: 0.0, zero: 0.0, sudden: 0.0}"


def _noisy(cycles: float, factor: float) -> list[str]:
    noises = {name: value for name, value in SENSORS if name.endswith(("noise", "bias"))}
    return [f"sensors.delay={cycles}", *(f"sensors.{name}={factor * value}" for name, value in noises.items())]


def _uphill(degrees: float, speed: float) -> list[str]:
    return [f"terrain={{slope: {degrees}}}", f"command={AHEAD.replace('0.3', str(speed))}"]


class Map(NamedTuple):
    """Two values that worlds differ in."""

    down: tuple[str, tuple[float, ...]]
    across: tuple[str, tuple[float, ...]]
    changes: Callable[[float, float], list[str]] | None
    """Values of the task for one of each; None where the two are a push's."""


MAPS = {
    "pushes": Map(
        ("direction, degrees", (0, 45, 90, 135, 180)), ("impulse, N s", (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)), None
    ),
    "ground and payload": Map(
        ("factor on the mass", (0.7, 0.85, 1.0, 1.15, 1.3, 1.6)),
        ("factor on the friction", (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2)),
        lambda mass, friction: [f"mass={mass}", f"friction={friction}"],
    ),
    "sensors": Map(("late, control cycles", (0, 1, 2, 3, 4)), ("factor on the noise", (0, 1, 2, 4, 8)), _noisy),
    "control period": Map(
        ("late, control cycles", (0, 1, 2, 3)),
        ("control period, ms", (8, 12, 20, 28, 40)),
        lambda cycles, period: [f"sensors.delay={cycles}", f"period={period / 1000}"],
    ),
    "motors": Map(
        ("voltage, V", (3, 4.5, 6, 9, 12)),
        ("gear ratio", (20, 30, 50, 70, 100, 130)),
        lambda volts, gear: [f"actuator={{name: dc_motor, voltage: {volts}, gear: {gear}}}"],
    ),
    "slope and speed": Map(("slope, degrees", (0, 2, 4, 6, 8)), ("command, m/s", (0.0, 0.15, 0.3, 0.5)), _uphill),
}
"""The maps by name: rows and columns. Friction 1 is rubber on a dry floor; noise 1 is that of `walk`."""


@cache
def _upright(arithmetic: Any, program: Any) -> Callable[..., jax.Array]:
    """(learners, policies, keys) -> (worlds, seeds, episodes) whether the bodies stay up."""

    def one(learner: Learner, policy: Any, key: jax.Array) -> jax.Array:
        return rollout(learner.env, greedy(learner, policy), key)[0].success

    for axes in ((None, None, 0), (None, 0, None), (0, None, None)):
        one = jax.vmap(one, in_axes=axes)
    return jax.jit(one, compiler_options=compute.compiler_options(arithmetic, program))


def mapped(policies: list[StoredPolicy], of: Map, episodes: int) -> Float[np.ndarray, "down across seeds"]:
    """Shares of upright bodies."""

    def stacked(trees: Sequence[Any]) -> Any:
        return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *trees)

    def learner(down: float, across: float) -> Learner:
        if of.changes is None:
            return pushed_from(there(policies[0], []), down, across).learner
        return there(policies[0], of.changes(down, across)).learner

    learned, keys = stacked([policy.policy for policy in policies]), held_out_keys(episodes)
    # The control period is not traced: its columns are programs of their own, longer to compile than to play.
    apart = "control period, ms" in of.across
    upright = _upright(policies[0].learner.env.arithmetic, "single" if apart else "simulation")
    rows = ([learner(down, across) for across in of.across[1]] for down in of.down[1])
    rows = ([stacked([one]) for one in row] if apart else [stacked(row)] for row in rows)
    found = [np.concatenate([upright(part, learned, keys) for part in row]) for row in rows]
    return np.stack(found).mean(axis=-1)


def there(policy: StoredPolicy, changes: Sequence[str]) -> StoredPolicy:
    """The policy told to go ahead, if it takes commands, in a plain world but for these values of the task."""
    task: Any = policy.learner.task
    plain = PLAIN | ({"command": AHEAD} if task.command else {})
    plain |= dict(change.split("=", 1) for change in changes)
    return in_world(policy, None, settings_of([f"task.{key}={value}" for key, value in plain.items()]))


def draw(rows: list[dict[str, Any]], target: Path) -> None:
    """A column of maps for each policy, with shares in %."""
    names, maps = (list(dict.fromkeys(row[key] for row in rows)) for key in ("policy", "map"))
    maps.sort(key=list(MAPS).index)
    with figure(target, len(maps), len(names), size=(3.6, 2.2)) as (_, axes):
        for row in rows:
            of, panel = MAPS[row["map"]], axes[maps.index(row["map"]), names.index(row["policy"])]
            shares = np.mean(row["upright"], axis=-1)
            panel.imshow(shares, cmap=SEQUENTIAL, vmin=0.0, vmax=1.0, aspect="auto", origin="lower")
            for (y, x), share in np.ndenumerate(shares):
                panel.text(
                    x, y, f"{share:.0%}"[:-1], ha="center", va="center", color="wk"[int(share > 0.6)], fontsize=6
                )
            panel.set(xlabel=of.across[0], ylabel=of.down[0], title=f"{row['policy']}: {row['map']}")
            panel.set_xticks(range(len(of.across[1])), [f"{value:g}" for value in of.across[1]])
            panel.set_yticks(range(len(of.down[1])), [f"{value:g}" for value in of.down[1]])
            panel.grid(visible=False)


def main(arguments: Sequence[str] | None = None) -> None:
    """Play all policies on all maps, write the record and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="RUN|POLICY", help="none: draw what the record holds")
    parser.add_argument("--episodes", type=int, default=128, help="of each seed in each world")
    parser.add_argument("--maps", nargs="+", choices=MAPS, default=list(MAPS))
    parser.add_argument("--json", type=Path, required=True, metavar="FILE")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png")
    given = parser.parse_args(arguments)
    if not given.names:
        return draw(json.loads(given.json.read_text())["rows"], given.out)
    humanoid_mjx.start()
    rows = []
    for name in given.names:
        policies = [find_policy("stand")] if name == "stand" else trained_seeds([name])
        for name in given.maps:
            found = mapped(policies, MAPS[name], given.episodes)
            rows.append({"policy": policies[0].name, "map": name, "upright": found.tolist()})
            print(f"{policies[0].name}, {name}: upright {found.mean():.0%}", flush=True)
    axes = {name: {"down": MAPS[name].down, "across": MAPS[name].across} for name in given.maps}
    record = compute.made_by() | {"episodes": given.episodes, "axes": axes, "rows": rows}
    given.json.write_text(json.dumps(record) + "\n")
    return draw(rows, given.out)


if __name__ == "__main__":
    main()
