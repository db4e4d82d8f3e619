"""Faults of the environment in words: settings that jax cannot use, errors of the system.

This module imports no jax, whose import may be what failed.
"""

import errno
import os
import re
import sys

OF_DEVICES = re.compile("DEVICE|CPU|BACKEND")

WRONG_KIND = {
    errno.EEXIST: "a file stands where a folder is wanted",
    errno.ENOTDIR: "a file stands where a folder is wanted",
    errno.EISDIR: "a folder stands where a file is wanted",
    errno.ELOOP: "this is a link that leads to itself",
}
"""Words for errors whose own message is misleading."""


def of_system(error: OSError) -> str:
    """Return the words of an error of the system."""
    return WRONG_KIND.get(error.errno or 0) or (os.strerror(error.errno) if error.errno else str(error))


def unusable(error: BaseException) -> str | None:
    """Return a sentence on the variables `JAX_...` for which jax cannot be imported, finds no device or raised `error`.

    None if the error comes of something else.
    """
    spec = sys.modules.get("humanoid_mjx.spec")
    if spec is not None and isinstance(error, spec.InputError):
        return None
    given = {name: value for name, value in os.environ.items() if name.startswith("JAX_")}
    words = " ".join(str(error).partition(" (")[0].split()).rstrip(".")  # jax adds its advice in brackets
    guilty = [name for name in given if name.lower() in words.lower().replace(".", "_")]
    if "jax" not in sys.modules and "jax._src" in sys.modules:  # its import failed
        guilty = guilty or [name for name, value in given.items() if repr(value) in words] or list(given)
    elif not guilty and _finds_no_device(error):
        if (platforms := given.pop("JAX_PLATFORMS", "")) not in ("", "cpu"):
            return f"JAX_PLATFORMS={platforms}: jax has no such device here; unset it, or set JAX_PLATFORMS=cpu."
        guilty = [name for name in given if OF_DEVICES.search(name)]
    if not guilty:
        return None
    settings, it = ", ".join(f"{name}={given[name]}" for name in guilty), "it" if len(guilty) == 1 else "one of them"
    return f"{settings}: jax cannot use this; unset {it} ({words})."


def _finds_no_device(error: BaseException) -> bool:
    jax = sys.modules.get("jax")
    if jax is None:
        return False
    try:
        return "Unable to initialize backend" in str(error) or not jax.devices()
    except (RuntimeError, ValueError, AssertionError):
        return True
