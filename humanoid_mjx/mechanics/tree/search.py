"""Newton's search for the minimum of MuJoCo's contact problem, over the facets that push.

The problem is quadratic as long as the same facets push. So a Newton step to the minimum for those that push now is
exact once they stay the same, and the search stops there: that minimum is the solution.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.scalars import Scalar
from humanoid_mjx.mechanics.tree.algebra import WORLD
from humanoid_mjx.mechanics.tree.bits import Bits
from humanoid_mjx.mechanics.tree.contacts import Touch
from humanoid_mjx.mechanics.tree.inertia import factor
from humanoid_mjx.mechanics.tree.line import lowest_share
from humanoid_mjx.mechanics.tree.pair_equations import with_pairs
from humanoid_mjx.mechanics.tree.pairs import Slots, close_pairs
from humanoid_mjx.mechanics.tree.problem import Active, Problem, active_at, normal_equations, one_by_one
from humanoid_mjx.mechanics.tree.structure import Tree

SAME = 200.0
"""Rounding errors by which two accelerations may differ, as shares of the largest, and count as the same. A facet whose
force is zero but for rounding may go on and off for ever, and moves nothing."""

PATIENCE, MORE = 10, 10.0
"""Steps after which they may differ by so many times as much. Worlds settle in about 6 steps; those that go on
alternate between two accelerations that differ by rounding, which stiff contacts of light limbs enlarge."""

WHOLE, WHOLE_DRY, SHARE = 4, 2, 0.7
"""Whole Newton steps before any is shortened, of trees without dry friction and with it; and what is made of a
shortened step without it.

With dry friction, steps often go round in circles: each after the whole ones ends at the lowest point of its line.
Without, some do on slippery ground: every second one is shortened, from `PATIENCE` on each. So all of 1,024 lower
bodies that were thrown about for 400 steps settled at friction 0.3, and all but 2 at 0.1. There a share of 0.6 lost 1
and one of 0.8 lost 5; to shorten each from the fifth on lost 1 and took a tenth more steps; every second one for ever
lost 32."""


def search(tree: Tree, problem: Problem, start: list[Any]) -> tuple[list[Any], Any]:
    """The accelerations, searched from `start`, and where they are settled.

    Worlds where bodies touch each other in more than `SLOTS` places do not settle.
    """
    pairs, problem, slots, more = problem.pairs, problem._replace(pairs=[]), None, False
    if pairs:
        slots, more = close_pairs(tree, problem, pairs)
    problem = problem._replace(ground=[touch.without_flag() for touch in problem.ground])
    found, settled = _search(tree, problem, slots, start)
    return found, settled & ~jnp.asarray(more)


def _search(tree: Tree, problem: Problem, slots: Slots | None, start: list[Any]) -> tuple[list[Any], Any]:
    """The accelerations, and where they are settled, from which on they stay; `problem`: all but the pairs."""

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        before, flags, settled, count = carry
        active = unpacked(flags)
        x, pairs = _minimum(tree, problem, points, slots, active)
        now = packed(active_at(tree, problem, x)._replace(pairs=pairs))
        values = [jnp.where(settled, old, v.value) for old, v in zip(before, x, strict=True)]
        errors = SAME * jnp.where(count < PATIENCE, 1.0, MORE)
        settled = settled | ~_differ(flags, now) | _same(before, values, errors)
        often = (count % 2 == 0) | (count >= PATIENCE)
        shorter = count >= WHOLE_DRY if problem.slips else (count >= WHOLE) & often

        def shorten() -> tuple[list[Any], Any]:
            found, there = _shortened(tree, problem, slots, before, values, active, settled)
            return found, packed(there)

        values, now = jax.lax.cond(shorter & ~settled.all(), shorten, lambda: (values, now))
        return values, now, settled, count + 1

    def packed(active: Active) -> tuple[list[Any], list[Any]]:
        # Flags of pairs are looked up one by one, so they stay as they are.
        return bits.pack(active._replace(pairs=[])), active.pairs

    def unpacked(flags: tuple[list[Any], list[Any]]) -> Active:
        return bits.unpack(flags[0])._replace(pairs=flags[1])

    def going(carry: tuple[Any, ...]) -> Any:
        return ~carry[2].all() & (carry[3] < MOST_STEPS)

    points = one_by_one(tree, problem.ground)
    start = [jnp.broadcast_to(value, (*jnp.shape(value)[:-1], *WORLD)) for value in start]
    active = active_at(tree, problem, [Scalar(value) for value in start])
    bits = Bits.of(active)
    active = active._replace(pairs=slots.all_close() if slots else [])  # a guess
    ended = jnp.broadcast_to(jnp.asarray(problem.ended), WORLD)
    x, _, settled, _ = jax.lax.while_loop(going, step, (start, packed(active), ended, jnp.int32(0)))
    return x, settled


def _shortened(
    tree: Tree, problem: Problem, slots: Slots | None, before: Any, values: Any, active: Active, settled: Any
) -> Any:
    """The accelerations after a part of the way from `before` to `values`, where the facets that push in `active` lead,
    and which facets push there; a settled world stays."""
    one, two = ([Scalar(value) for value in x] for x in (before, values))
    share = lowest_share(tree, problem, slots, active, one, two, settled) if problem.slips else SHARE
    values = [jnp.where(settled, new, old + share * (new - old)) for old, new in zip(before, values, strict=True)]
    found = [Scalar(value) for value in values]
    return values, active_at(tree, problem, found)._replace(pairs=slots.active(tree, found) if slots else [])


def _differ(one: Any, two: Any) -> Any:
    """Whether flags, or words of flags, differ."""
    return _in_any_lane(jnp.logical_or, [a != b for a, b in zip(*map(jax.tree.leaves, (one, two)), strict=True)])


def _same(one: Sequence[Any], two: Sequence[Any], errors: Any) -> Any:
    """Whether two accelerations are the same but for so many rounding errors."""
    change = _in_any_lane(jnp.maximum, [jnp.abs(a - b) for a, b in zip(one, two, strict=True)])
    size = _in_any_lane(jnp.maximum, [jnp.abs(b) for b in two])
    return change <= errors * jnp.finfo(change.dtype).eps * size


def _in_any_lane(combine: Callable[[Any, Any], Any], values: Sequence[Any]) -> Any:
    """A value of the world from those that may have axes of contacts and of lanes, which are combined last."""
    found = dict[tuple[int, ...], Any]()
    for value in values:
        while value.ndim > 2:
            value = functools.reduce(combine, value)
        found[value.shape] = combine(found[value.shape], value) if value.shape in found else value
    each = [part for value in found.values() for part in (value if value.ndim > 1 else [value])]
    return functools.reduce(combine, each)


def _minimum(
    tree: Tree, problem: Problem, points: list[list[Touch]], slots: Slots | None, active: Active
) -> tuple[list[Scalar], list[Any]]:
    """If these facets and stops push and no others, and which facets of pairs push there."""
    matrix, right = normal_equations(tree, problem, points, active)
    factors = factor(tree, matrix)
    x = factors.solve(right)
    if slots is None:
        return x, active.pairs

    def whole(found: Sequence[Scalar]) -> list[Any]:
        return [jnp.broadcast_to(v.value, jnp.broadcast_shapes(jnp.shape(v.value), WORLD)) for v in found]

    def together() -> tuple[list[Any], list[Any]]:
        found = with_pairs(tree, slots, active.pairs, factors, x)
        return whole(found), slots.active(tree, found)

    def alone() -> tuple[list[Any], list[Any]]:
        return whole(x), jax.tree.map(jnp.zeros_like, active.pairs)

    values, pairs = jax.lax.cond(slots.count > 0, together, alone)
    return [Scalar(value) for value in values], pairs


MOST_STEPS = 24
"""Newton steps before a world is given up. From cold the worst of 10,000 random states of the lower body needs 8; at
friction 0.1 the worst of 160,000 time steps needs 21."""
