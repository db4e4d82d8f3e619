"""Newton's search for the minimum of MuJoCo's contact problem, over the facets that push.

The problem is quadratic as long as the same facets push. So a Newton step to the minimum for those that push now is
exact once they stay the same, and the search stops there: that minimum is the solution. With elliptic cones each step
ends at the lowest point of its line, and the search stops where forces are those of the equations but for rounding.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from humanoid_mjx.mechanics.tree.bits import pack, unpack
from humanoid_mjx.mechanics.tree.cones import Cone
from humanoid_mjx.mechanics.tree.inertia import factor
from humanoid_mjx.mechanics.tree.line import lowest_share
from humanoid_mjx.mechanics.tree.pair_equations import with_pairs
from humanoid_mjx.mechanics.tree.pairs import close_pairs
from humanoid_mjx.mechanics.tree.problem import Active, Problem, active_at, normal_equations
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
    """The accelerations, searched from `start`, and where they are settled, from which on they stay.

    Worlds where bodies touch each other in more than `SLOTS` places do not settle.
    """
    more, problem = False, problem._replace(ground=[touch.without_flag() for touch in problem.ground])
    if problem.pairs:
        slots, more = close_pairs(tree, problem)
        problem = problem._replace(pairs=[], slots=slots)
    slots = problem.slots

    def step(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        before, flags, settled, count = carry
        active = unpacked(flags)
        x, pairs = _minimum(tree, problem, active)
        now = packed(active_at(tree, problem, x)._replace(pairs=pairs))
        x = [jnp.where(settled, old, new) for old, new in zip(before, x, strict=True)]
        errors = SAME * jnp.where(count < PATIENCE, 1.0, MORE)
        settled = settled | ~_differ(flags, now, cones, x, errors) | _same(before, x, errors)
        often = (count % 2 == 0) | (count >= PATIENCE)
        shorter = count >= (0 if cones else WHOLE_DRY) if problem.slips or cones else (count >= WHOLE) & often

        def shorten() -> tuple[list[Any], Any]:
            at = unpacked(now) if cones else active
            given = tree, problem, active, at, before, x, settled
            share = lowest_share(*given) if problem.slips or cones else SHARE
            part = [jnp.where(settled, new, old + share * (new - old)) for old, new in zip(before, x, strict=True)]
            there = active_at(tree, problem, part)._replace(pairs=slots.active(tree, part) if slots else None)
            each = there, active, at  # residuals are linear along the way
            return part, packed(jax.tree.map(lambda x, a, b: x if x.dtype == bool else a + share * (b - a), *each))

        x, now = jax.lax.cond(shorter & ~settled.all(), shorten, lambda: (x, now))
        return x, now, settled, count + 1

    def packed(active: Active) -> tuple[list[Any], Any]:
        # Flags of pairs are looked up one by one, so they stay as they are.
        return pack(active._replace(pairs=None)), active.pairs

    def unpacked(flags: tuple[list[Any], Any]) -> Active:
        return unpack(flags[0], like)._replace(pairs=flags[1])

    start = [jnp.broadcast_to(x, (tree.lanes if tree.laned(dof) else 1, 1)) for dof, x in enumerate(start)]
    like = active_at(tree, problem, start)
    touches = [*problem.ground, *([slots.touch] if slots else ())]
    cones = [touch.friction for touch in touches if isinstance(touch.friction, Cone)]
    active = like._replace(pairs=slots.guess(tree, start) if slots else None)
    ended = jnp.broadcast_to(jnp.asarray(problem.ended), (1,))
    carry = start, packed(active), ended, jnp.int32(0)
    found = jax.lax.while_loop(lambda carry: ~carry[2].all() & (carry[3] < MOST_STEPS), step, carry)
    return found[0], found[2] & ~jnp.asarray(more)


def _differ(one: Any, two: Any, cones: Sequence[Cone], x: Sequence[Any], errors: Any) -> Any:
    """Return whether flags, or words of flags, differ, or the pulls of these cones from those in the equations of
    `one`, by more than so many rounding errors of theirs and of the accelerations `x`."""
    each, left = zip(*map(jax.tree.leaves, (one, two)), strict=True), iter(cones)
    by = (_size(x), errors) if cones else ()
    return _in_any_lane(jnp.any, [next(left).bends(a, b, *by) if a.dtype.kind == "f" else a != b for a, b in each])


def _same(one: Sequence[Any], two: Sequence[Any], errors: Any) -> Any:
    """Return whether two accelerations are the same but for so many rounding errors."""
    change = _in_any_lane(jnp.max, [jnp.abs(a - b) for a, b in zip(one, two, strict=True)])
    size = _size(two)
    return change <= errors * jnp.finfo(change.dtype).eps * size


def _size(x: Sequence[Any]) -> Any:
    """The largest acceleration."""
    return _in_any_lane(jnp.max, [jnp.abs(part) for part in x])


def _in_any_lane(combined: Callable[..., Any], values: Sequence[Any]) -> Any:
    """A value of the world from those that may have axes of contacts and of lanes, which are combined last."""
    each = [value.reshape(-1, *value.shape[-2:]) for value in values]
    own = {lanes: jnp.concatenate([x for x in each if x.shape[1] == lanes]) for lanes in {x.shape[1] for x in each}}
    return combined(jnp.concatenate([combined(x, axis=0) for x in own.values()]), axis=0)


def _minimum(tree: Tree, problem: Problem, active: Active) -> tuple[list[Any], Any]:
    """The minimum while these constraints push and no others, and the facets of pairs that push there."""
    slots, (matrix, right) = problem.slots, normal_equations(tree, problem, active)
    factors = factor(tree, matrix)
    x = factors.solve(right)
    if slots is None:
        return x, None

    def together() -> tuple[list[Any], Any]:
        found = with_pairs(tree, slots, active.pairs, factors, x)
        return found, slots.active(tree, found)

    return jax.lax.cond(slots.count > 0, together, lambda: (x, jnp.zeros_like(active.pairs)))


MOST_STEPS = 24
"""Newton steps before a world is given up. From cold the worst of 10,000 random states of the lower body needs 8; at
friction 0.1 the worst of 160,000 time steps needs 21."""
