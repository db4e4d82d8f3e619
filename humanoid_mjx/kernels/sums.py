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


class _Sum(NamedTuple):
    terms: list[_Term]
    """The first is not subtracted."""
    parts: list[Var]
    """Sums in it that nothing else uses."""
    fused: int
    """Additions of a product."""


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
            found = _sum(eqn, single)
            seen |= set(found.parts)
            if found.fused < min(sum(term.product for term in found.terms), len(found.terms) - 1):
                changed |= {(part,): [] for part in found.parts} | {tuple(eqn.outvars): _fused(eqn, found)}
    return [new for eqn in jaxpr.eqns for new in changed.get(tuple(eqn.outvars), [eqn])]


def _adds(eqn: JaxprEqn) -> bool:
    """True for a sum or a difference of float32."""
    kind: Any = eqn.outvars[0].aval if eqn.primitive.name in ("add", "sub") else None
    return kind is not None and kind.dtype == jnp.float32


def _sum(eqn: JaxprEqn, single: dict[Var, JaxprEqn]) -> _Sum:
    """A sum with all sums in it; `single`: equations of what is used once."""
    terms: list[_Term] = []
    parts: list[Var] = []
    fused, product = 0, False
    for x, minus in zip(eqn.invars, (False, eqn.primitive.name == "sub"), strict=True):
        own = None if isinstance(x, Literal) or x.aval != eqn.outvars[0].aval else single.get(x)
        if own and _adds(own):
            inner = _sum(own, single)
            terms += [term._replace(minus=term.minus != minus) for term in inner.terms]
            parts += [*inner.parts, own.outvars[0]]
            fused += inner.fused
        else:
            terms.append(_Term(x, minus, bool(own) and own.primitive.name == "mul"))
            product |= terms[-1].product
    return _Sum(terms, parts, fused + product)


def _fused(eqn: JaxprEqn, found: _Sum) -> list[JaxprEqn]:
    """The equations of a sum that begins with what is no product."""
    start = min(found.terms, key=lambda term: (term.minus, term.product))
    others = sorted((term for term in found.terms if term is not start), key=lambda term: term.product)
    total, equations = start.value, []
    for term, after in zip(others, [*found.parts, eqn.outvars[0]], strict=True):
        primitive = sub_p if term.minus else add_p
        equations.append(eqn.replace(invars=[total, term.value], outvars=[after], primitive=primitive))
        total = after
    return equations
