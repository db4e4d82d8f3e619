"""The mirror image of a robot: names that change sides."""

import re
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Int

from humanoid_mjx.spec import InputError, known

WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+|.", re.DOTALL)
"""A part of a name, which ends at a change of case, between letters and digits, and at any other sign."""


def image(name: str, mirror: Sequence[tuple[str, str]], names: Collection[str]) -> str:
    """Return the name on the other side; a name in the middle is its own image.

    Whole parts of a name change sides (`r_` in `r_knee`, not in `roller_`), or else what gives one of `names`.
    """
    edges, whole, parts = {0, *(m.end() for m in WORD.finditer(name))}, [], []
    for old, new in (pair for both in mirror for pair in (both, both[::-1]) if all(both)):
        found = [m.span() for m in re.finditer(re.escape(old), name)]
        parts += [name[:begin] + new + name[end:] for begin, end in found]
        if spans := [span for span in found if edges >= set(span)]:
            ends = zip([0, *(end for _, end in spans)], [*(begin for begin, _ in spans), len(name)], strict=True)
            whole.append(new.join(name[end:begin] for end, begin in ends))
    return next((other for other in (*whole, *parts) if other in names), (whole or [name])[0])


def images(
    what: str, of: Sequence[str], mirror: Sequence[tuple[str, str]], names: Collection[str]
) -> Int[np.ndarray, " of"]:
    """Return the index of each name's image among `of`.

    Raises:
      InputError: a name has none, or is not the image of its image.
    """
    for name in of:
        if (other := image(name, mirror, names)) not in of:
            raise InputError(f"mirror: {name} has no image {other} among the {what}; {known(other, of)}")
        if (back := image(other, mirror, names)) != name:
            raise InputError(f"mirror: the image of {name} is {other}, but that of {other} is {back}")
    return np.array([of.index(image(name, mirror, names)) for name in of], int)
