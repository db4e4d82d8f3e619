"""Limits of the machine: cores and memory."""

import os
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import jax


def cores() -> int:
    """Return the number of CPU cores that this process may use.

    That is its affinity, or the quota of its control group where the quota is less.
    """
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for group in _control_groups("cpu"):
        if (group / "cpu.max").is_file():
            quota, period = (group / "cpu.max").read_text().split()
        elif (group / "cpu.cfs_quota_us").is_file():
            quota, period = ((group / f"cpu.cfs_{name}_us").read_text().strip() for name in ("quota", "period"))
        else:
            continue
        if quota.isdigit():  # without a quota it is "max" or -1
            found = min(found, max(1, -(-int(quota) // int(period))))
    return found


def available_memory() -> int:
    """Return the bytes that this process can still take without swapping.

    Where the system does not say it, half of the machine's memory, or 4 GiB.
    """
    meminfo = Path("/proc/meminfo")
    known = re.search(r"^MemAvailable: *(\d+) kB$", meminfo.read_text(), re.M) if meminfo.is_file() else None
    pages = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 8 << 30
    found = int(known[1]) << 10 if known else pages // 2
    for group in _control_groups("memory"):
        for limit, usage in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            if (group / limit).is_file() and (most := (group / limit).read_text().strip()).isdigit():
                cached = re.search(r"^(?:total_)?inactive_file (\d+)$", (group / "memory.stat").read_text(), re.M)
                used = int((group / usage).read_text()) - (int(cached[1]) if cached else 0)
                found = min(found, max(0, int(most) - used))
    return found


def _control_groups(kind: str, root: Path = Path("/")) -> Iterator[Path]:
    """Yield the folders of this process's control groups, of version 1 or 2, that limit its `kind`: cpu or memory."""
    file = root / "proc/self/cgroup"
    for line in file.read_text().splitlines() if file.is_file() else ():
        _, kinds, path = line.split(":", 2)
        if kinds == "" or kind in kinds.split(","):
            mount = root / "sys/fs/cgroup" / (kinds and kind)
            inside = mount / path.lstrip("/")
            yield from (folder for folder in (inside, *inside.parents) if folder.is_relative_to(mount))


def reserve_memory() -> None:
    """Let each GPU reserve its memory in a thread of its own.

    The first transfer to a GPU reserves its memory, which takes 1.5 s on an H200. The caller goes on meanwhile.
    """
    if jax.default_backend() == "gpu":
        for device in jax.local_devices():
            threading.Thread(target=jax.device_put, args=(0.0, device), daemon=True).start()


def out_of_memory(error: BaseException) -> bool:
    """Return whether an error says that the memory of a device or of the machine does not suffice."""
    exhausted = isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" in str(error)
    return exhausted or isinstance(error, MemoryError)
