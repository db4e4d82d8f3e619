"""What a compiled program costs by XLA's own count: operations, bytes, memory.

XLA's analysis counts the body of a loop once, however often the loop turns, and takes a kernel that changes a few
numbers of an array for one that reads and writes the whole of it. Here each loop is counted by itself, so that its body
counts as often as it turns and what stands outside of it once; and of such an array the numbers that change.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import jax


class Cost(NamedTuple):
    """What one run of a program does on one device."""

    operations: float | None
    """On numbers of any kind, comparisons and choices among them; a multiply-add is two. None: not known."""
    bytes: float | None
    """What all kernels together read and write, in caches or in memory. None: not known."""
    memory: float | None
    """Bytes of arguments, results and temporary arrays together. None: not known."""
    at_least: bool = False
    """Whether there is more: of a loop that turns until it is done one turn is counted, of a library's call nothing."""


KEYS = ("flops", "transcendentals", "bytes accessed")
"""Of XLA's analysis. Its `flops` are all elementwise operations but transcendental ones, of integers, too."""

TRIP_COUNT = re.compile(r'"known_trip_count":\{"n":"(\d+)"')
SHAPE = r"\w+\[[\d,]*\]"
LIBRARY = re.compile(r"lapack|cusolver|cublas|cudnn|cub\b")
"""Custom calls that solve, multiply or sort. Others are whole kernels, of which XLA knows nothing."""


def cost(compiled: jax.stages.Compiled, turns: int | None = None) -> Cost:
    """Count a compiled program; `turns` is how often its outermost loop turns, where the program does not know it."""
    held = memory_of(compiled)
    text = compiled.as_text() or ""
    targets = re.findall(r'custom_call_target="([^"]*)"', text)
    if not all(LIBRARY.search(target) for target in targets):
        return Cost(None, None, held)
    try:
        counted, open_ended = _Counter(compiled).count(turns)
    except (ImportError, AttributeError, LookupError, RuntimeError, TypeError, ValueError):
        # No public name leads to a loop's own cost, and those used here may go.
        return Cost(None, None, held)
    flops, transcendentals, moved = counted
    return Cost(flops + transcendentals, moved, held, open_ended or bool(targets))


def memory_of(compiled: jax.stages.Compiled) -> float | None:
    """Bytes of arguments, results and temporary arrays; a result in the place of an argument is none of its own."""
    found = compiled.memory_analysis()
    if found is None:
        return None
    held, shared = ("argument", "output", "temp"), found.alias_size_in_bytes
    return float(sum(getattr(found, f"{part}_size_in_bytes") for part in held) - shared)


class Programs:
    """A call of one jitted program on shares of the work: a thread for each device, one share after another.

    Its result is a list for each device, of what the program returns for each share.
    """

    def __init__(
        self, program: Callable[..., Any], by_device: Sequence[Sequence[Sequence[Any]]], turns: int | None = None
    ) -> None:
        """`by_device`: the arguments for each share. `turns`: of the outermost loop, where no program knows it."""
        self.program, self.by_device, self.turns = program, by_device, turns
        self.threads = ThreadPoolExecutor(len(by_device))

    def __call__(self) -> list[list[Any]]:
        return list(self.threads.map(self._work, self.by_device))

    def _work(self, shares: Sequence[Sequence[Any]]) -> list[Any]:
        return [jax.block_until_ready(self.program(*share)) for share in shares]

    @cached_property
    def cost(self) -> Cost:
        """Of a call, all shares together; memory is that of the shares that run at once.

        After a call this compiles nothing: jax finds what it has.
        """
        program: Any = self.program
        one = cost(program.lower(*self.by_device[0][0]).compile(), self.turns)
        shares, at_once = sum(map(len, self.by_device)), len(self.by_device)
        operations, moved = (None if x is None else shares * x for x in (one.operations, one.bytes))
        return Cost(operations, moved, None if one.memory is None else at_once * one.memory, one.at_least)


class _Counter:
    """The computations of a program, each of which XLA can be asked about as if it were a program."""

    def __init__(self, compiled: jax.stages.Compiled) -> None:
        from jaxlib import _hlo, _jax  # pyright: ignore[reportAttributeAccessIssue]

        executable: Any = compiled.runtime_executable()
        (module,) = executable.hlo_modules()
        options = _hlo.HloPrintOptions()
        options.print_metadata = False
        blocks = re.findall(r"^(?:ENTRY )?%[^\n]* \{$.*?^\}$", module.to_string(options), re.MULTILINE | re.DOTALL)
        (self.entry,) = (_name(block) for block in blocks if block.startswith("ENTRY "))
        self.blocks: Mapping[str, str] = {_name(block): block.removeprefix("ENTRY ") for block in blocks}
        self.counted: dict[str, list[float]] = {}
        self.parse = _hlo.hlo_module_from_text
        self.analysis = lambda part: _jax.hlo_module_cost_analysis(executable.client, part)

    def count(self, turns: int | None) -> tuple[list[float], bool]:
        """Of the whole: the analysis by `KEYS`, and whether a loop in it turns so often as nobody knows."""
        return self._count(self.entry, turns)

    def _count(self, name: str, turns: int | None) -> tuple[list[float], bool]:
        total, open_ended = [*self._once(name)], False
        total[KEYS.index("bytes accessed")] -= self._untouched(name)
        for line in self._loops(name):
            known = TRIP_COUNT.search(line)
            number = int(known[1]) if known else turns
            open_ended |= number is None
            for part in re.findall(r"(?:body|condition)=%([\w.\-]+)", line):
                inside, more = self._count(part, None)
                open_ended |= more
                once = self._once(part)
                total = [t - o + (number or 1) * i for t, o, i in zip(total, once, inside, strict=True)]
        return total, open_ended

    def _once(self, name: str) -> list[float]:
        """What XLA counts: one turn of a loop, the dearest of branches."""
        if name not in self.counted:
            blocks = (("ENTRY " if other == name else "") + block for other, block in self.blocks.items())
            found = self.analysis(self.parse("\n\n".join(["HloModule part", *blocks])))
            self.counted[name] = [float(found.get(key, 0.0)) for key in KEYS]
        return self.counted[name]

    def _loops(self, name: str) -> list[str]:
        """The loops of a computation and of those that it calls, but not those within its loops."""
        found: list[str] = []
        for line in self.blocks[name].splitlines()[1:]:
            if " while(" in line:
                found.append(line)
            else:
                found += [
                    loop for part in re.findall(r"(?:calls|to_apply)=%([\w.\-]+)", line) for loop in self._loops(part)
                ]
        return found

    def _untouched(self, name: str) -> float:
        """Bytes that XLA counts in a computation, but that its kernels do not touch: they scatter into large arrays."""
        total = 0.0
        for line in self.blocks[name].splitlines()[1:]:
            for part in re.findall(r"(?:calls|to_apply)=%([\w.\-]+)", line):
                total += _around_scatter(self.blocks[part]) if " fusion(" in line else self._untouched(part)
        return total


def _around_scatter(kernel: str) -> float:
    """Bytes of the arrays that a kernel scatters into, read and written, but for those that it changes."""
    total = 0.0
    for whole, updates in re.findall(rf"= ({SHAPE})\S* scatter\(%\S+, %\S+, %(\S+)\)", kernel):
        if shape := re.search(rf"%{re.escape(updates)} = ({SHAPE})", kernel):
            total += 2.0 * (_bytes(whole) - _bytes(shape[1]))
    return total


def _bytes(shape: str) -> int:
    """Of an array such as f32[512,24,2]."""
    kind, _, sizes = shape.rstrip("]").partition("[")
    bits = re.search(r"\d+", kind)
    return (int(bits[0]) if bits else 8) * math.prod(map(int, filter(None, sizes.split(",")))) // 8


def _name(block: str) -> str:
    found = re.match(r"(?:ENTRY )?%([\w.\-]+)", block)
    assert found
    return found[1]
