"""Sums of products, in an order in which each product and its addition are one instruction.

`a + (b c + d e)` takes a multiplication, a fused multiply-add and an addition, `(a + b c) + d e` two fused
multiply-adds. Compilers leave the order of a sum as it is, since another one rounds otherwise.
"""

from collections import Counter
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var
from jax.extend.core.primitives import add_p, sub_p


class _Term(NamedTuple):
    value: Any
    """A variable or a literal."""
    minus: bool
    product: bool
    """True for a product that nothing else uses."""


def fused(closed: ClosedJaxpr) -> ClosedJaxpr:
    """A traced function of numbers, with sums in another order in it and in its loops and branches."""

    def inside(value: Any) -> Any:
        if isinstance(value, tuple) and value and isinstance(value[0], ClosedJaxpr):
            return tuple(map(fused, value))
        return fused(value) if isinstance(value, ClosedJaxpr) else value

    jaxpr = closed.jaxpr
    used, equations = {x for x in jaxpr.outvars if not isinstance(x, Literal)}, []
    for eqn in reversed(jaxpr.eqns):
        if eqn.effects or not used.isdisjoint(eqn.outvars):
            used |= {x for x in eqn.invars if not isinstance(x, Literal)}
            equations.append(eqn.replace(params={key: inside(value) for key, value in eqn.params.items()}))
    jaxpr = jaxpr.replace(eqns=equations[::-1])
    return closed.replace(jaxpr=jaxpr.replace(eqns=with_fused_sums(jaxpr)))


def with_fused_sums(jaxpr: Jaxpr) -> list[JaxprEqn]:
    """The equations of a traced function, with sums of float32 in another order where that saves instructions."""
    used = Counter(x for eqn in jaxpr.eqns for x in eqn.invars if not isinstance(x, Literal))
    used.update(x for x in jaxpr.outvars if not isinstance(x, Literal))
    single = {x: eqn for eqn in jaxpr.eqns for x in eqn.outvars if used[x] == 1}
    changed: dict[tuple[Var, ...], list[JaxprEqn]] = {}
    seen: set[Var] = set()
    for eqn in reversed(jaxpr.eqns):
        if _adds(eqn) and eqn.outvars[0] not in seen:
            terms, parts, count = _sum(eqn, single)
            seen |= set(parts)
            if count < min(sum(term.product for term in terms), len(terms) - 1):
                changed |= {(part,): [] for part in parts} | {tuple(eqn.outvars): _fused(eqn, terms, parts)}
    return [new for eqn in jaxpr.eqns for new in changed.get(tuple(eqn.outvars), [eqn])]


def _adds(eqn: JaxprEqn) -> bool:
    """True for a sum or a difference of float32."""
    kind: Any = eqn.outvars[0].aval if eqn.primitive.name in ("add", "sub") else None
    return kind is not None and kind.dtype == jnp.float32


def _sum(eqn: JaxprEqn, single: dict[Var, JaxprEqn]) -> tuple[list[_Term], list[Var], int]:
    """Terms of a sum, of which the first is not subtracted; the sums in it that nothing else uses; and its additions of
    a product. `single`: equations of what is used once."""
    terms, parts, count, product = list[_Term](), list[Var](), 0, False
    for x, minus in zip(eqn.invars, (False, eqn.primitive.name == "sub"), strict=True):
        own = None if isinstance(x, Literal) or x.aval != eqn.outvars[0].aval else single.get(x)
        if own and _adds(own):
            inner, others, more = _sum(own, single)
            terms += [term._replace(minus=term.minus != minus) for term in inner]
            parts, count = [*parts, *others, own.outvars[0]], count + more
        else:
            terms.append(_Term(x, minus, bool(own) and own.primitive.name == "mul"))
            product |= terms[-1].product
    return terms, parts, count + product


def _fused(eqn: JaxprEqn, terms: list[_Term], parts: list[Var]) -> list[JaxprEqn]:
    """The equations of a sum that begins with what is no product."""
    start = min(terms, key=lambda term: (term.minus, term.product))
    others = sorted((term for term in terms if term is not start), key=lambda term: term.product)
    total, equations = start.value, []
    for term, after in zip(others, [*parts, eqn.outvars[0]], strict=True):
        primitive = sub_p if term.minus else add_p
        equations.append(eqn.replace(invars=[total, term.value], outvars=[after], primitive=primitive))
        total = after
    return equations
