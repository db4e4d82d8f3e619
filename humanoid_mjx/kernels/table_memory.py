"""The memory of a GPU kernel that trains tables: the tables of a block of agents, and their learning curves."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.experimental.pallas import triton as gpu
from jaxtyping import Array

from humanoid_mjx.kernels.memory import assembly


class DeviceMemory(NamedTuple):
    """Tables in the memory of the device: of any size, and in the interpreter too."""

    tables: Any
    """A reference to float (runs, num_states * num_actions)."""
    run: Array
    num_actions: int

    def row(self, token: Array, row: Array) -> tuple[Array, ...]:
        """The values of a row of each agent's table, after the write that gave this token."""
        cells = [row * self.num_actions + action for action in range(self.num_actions)]
        return tuple(gpu.load(self.tables.at[self.run, cell]) for cell in cells)

    def add(self, token: Array, row: Array, action: Array, change: Array, seen: tuple[Array, ...]) -> Array:
        """Add to one value of each table, after these values were read; a token of the write."""
        place = self.tables.at[self.run, row * self.num_actions + action]
        gpu.store(place, gpu.load(place) + change)
        return token


class SharedMemory(NamedTuple):
    """Tables in the memory that the threads of a block share, a column for each agent so that no two banks collide.

    Pallas has no such arrays for Triton. Its inline assembly can reach them, but may be moved unless something depends
    on it: hence a write takes what was read before it and gives a token, a number, which later reads take.
    """

    address: Array
    """Addresses of the first value of each agent's table, in bytes."""
    num_actions: int

    @classmethod
    def of(cls, num_states: int, num_actions: int, block: int) -> "SharedMemory":
        thread = jnp.arange(block, dtype=jnp.int32)
        code = f".shared .align 4 .b8 q_tables[{num_states * num_actions * block * 4}];"
        return cls(assembly(f"{code} mov.u32 $0, q_tables;", "=r,r", jnp.int32, thread) + 4 * thread, num_actions)

    def cell(self, number: Array) -> Array:
        return self.address + number * (4 * len(self.address))

    def read(self, token: Array, address: Array, beyond: int = 0) -> Array:
        return assembly(f"ld.shared.f32 $0, [$1+{beyond}];", "=f,r,r", jnp.float32, address, token)

    def write(self, token: Array, address: Array, value: Array, seen: tuple[Array, ...] = ()) -> Array:
        constraints = ",".join(["=r", "r", "f", "r", *("f" for _ in seen)])
        return assembly("st.shared.f32 [$1], $2; mov.b32 $0, $3;", constraints, jnp.int32, address, value, token, *seen)

    def row(self, token: Array, row: Array) -> tuple[Array, ...]:
        address, width = self.cell(row * self.num_actions), 4 * len(self.address)
        return tuple(self.read(token, address, width * action) for action in range(self.num_actions))

    def add(self, token: Array, row: Array, action: Array, change: Array, seen: tuple[Array, ...]) -> Array:
        address = self.cell(row * self.num_actions + action)
        return self.write(token, address, self.read(token, address) + change, seen)


class Record(NamedTuple):
    """The learning curves of a block of agents, in the memory of the device."""

    record: Any
    """A reference to float (runs, points, measures)."""
    run: Array

    def row(self, point: Array, others: list[Array], mask: Array) -> list[Array]:
        """The measures at a point of each curve, or those others where the mask is false."""
        return [gpu.load(self._entry(point, i), mask=mask, other=other) for i, other in enumerate(others)]

    def put(self, point: Array, values: list[Array], mask: Array) -> None:
        for measure, value in enumerate(values):
            gpu.store(self._entry(point, measure), value, mask=mask)

    def _entry(self, point: Array, measure: int) -> Any:
        return self.record.at[self.run, point, jnp.full(len(self.run), measure)]
