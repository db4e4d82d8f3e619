"""Provenance of records: machine, versions, commit."""

import platform
import subprocess
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

from humanoid_mjx.compute.limits import cores

PACKAGES = ("humanoid-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "brax", "numpy")
"""Packages on whose versions a result depends, this one first."""


def made_by() -> dict[str, Any]:
    """Return the machine, the versions and the commit that make a record."""
    return {"machine": machine(), "versions": versions(), "commit": commit()}


def machine() -> dict[str, Any]:
    """Return the devices, the processor and the system that compute here."""
    devices, cpuinfo = jax.devices(), Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "device": devices[0].device_kind,
        "backend": jax.default_backend(),
        "device_count": len(devices),
        "cpu": names[0] if names else platform.processor(),
        "cpu_count": cores(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def versions() -> dict[str, str]:
    """Return the version of Python and of each of `PACKAGES` that is installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def commit() -> str | None:
    """Return the git commit of this package, followed by "-dirty" where files differ; None outside a checkout."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    described = ("git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    try:
        return subprocess.run(described, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
