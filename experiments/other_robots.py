# pyright: reportAttributeAccessIssue=false
"""Compare robots that others publish on `physics: tree` with native MuJoCo.

    pip install -q --no-deps --target others dm_control mjlab 'playground<1' mujoco-warp
    PYTHONPATH=others python experiments/other_robots.py       # adds to docs/bench/other_robots.json, in 10 minutes
    python experiments/other_robots.py gymnasium/ant my_robot.xml --out /tmp/found.json

For each model: all that keeps `physics: tree` from taking it, or else how much the two differ in double precision,
after one time step and after several. States are what MuJoCo makes of random postures within a second; in half of them
bodies touch each other, where states were found in which they do. Worlds that the tree flags as unsettled, as those
with more contacts between bodies than it has room for, are counted and not compared. MuJoCo's solver converges
(Newton's, 100 iterations, no tolerance). Motors are torques of their joints. Meshes are left out where a package lacks
their files.
"""

import argparse
import json
import os
import sys
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent.parent / "tests"))

import jax
import mujoco
import numpy as np
from tree_robots import converged, dropped, qacc_of  # pyright: ignore[reportMissingImports]

from humanoid_mjx import compute
from humanoid_mjx.mechanics.tree.folding import fold
from humanoid_mjx.mechanics.tree.reading import read_tree
from humanoid_mjx.mechanics.tree.refusing import faults
from humanoid_mjx.mechanics.tree.step import Values

RECORD = Path(__file__).parent.parent / "docs" / "bench" / "other_robots.json"
STEPS = 5
PLAIN_KERNELS = "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
"""They compile in a third of the time."""
ZOO = {
    "gymnasium": {
        name: f"envs/mujoco/assets/{name}.xml"
        for name in (
            *("ant", "half_cheetah", "hopper", "humanoid", "humanoidstandup", "inverted_double_pendulum", "pusher"),
            *("reacher", "swimmer", "walker2d"),
        )
    },
    "dm_control": {
        name: f"suite/{name}.xml"
        for name in (
            *("acrobot", "cheetah", "dog", "hopper", "humanoid", "humanoid_CMU", "quadruped", "swimmer", "walker"),
        )
    },
    "mujoco_playground": {
        name: f"_src/locomotion/{name.split()[0]}/xmls/scene_mjx_{scene}.xml"
        for name, scene in {
            "apollo": "feetonly_flat_terrain",
            "berkeley_humanoid": "feetonly_flat_terrain",
            "g1": "feetonly_flat_terrain",
            "go1": "flat_terrain",
            "go1 feet": "feetonly_flat_terrain",
            "go1 full": "fullcollisions_flat_terrain",
            "h1": "feetonly",
            "op3": "feetonly",
            "spot": "flat_terrain",
            "spot feet": "feetonly_flat_terrain",
            "t1": "feetonly_flat_terrain",
        }.items()
    },
    "mjlab": {name: f"asset_zoo/robots/unitree_{name}/xmls/{name}.xml" for name in ("g1", "go1")},
    "mujoco_warp": {"humanoid": "test_data/humanoid/humanoid.xml"},
}
"""MJCF files in packages, which are not imported. They are named as the package's own tasks and examples load them."""


def file_of(name: str) -> Path | None:
    """The MJCF of `PACKAGE/MODEL`, or a path; None where the package is not installed."""
    package, _, model = name.partition("/")
    if model not in ZOO.get(package, {}):
        return Path(name)
    spec = find_spec(package)
    return Path(str(spec.origin)).parent / ZOO[package][model] if spec else None


def read(file: Path) -> tuple[mujoco.MjModel, int]:
    """The compiled model, and how many meshes it lacks."""
    spec = mujoco.MjSpec.from_file(str(file))
    with warnings.catch_warnings(action="ignore"):
        try:
            return spec.compile(), 0
        except ValueError:
            return without_meshes(spec)


def without_meshes(spec: mujoco.MjSpec) -> tuple[mujoco.MjModel, int]:
    """Delete meshes, skins and looks; return the compiled model, and how many meshes it lacks.

    Raises:
      ValueError: a mesh touches something.
    """
    meshes = [geom for geom in spec.geoms if geom.type == mujoco.mjtGeom.mjGEOM_MESH]
    if touching := [geom.name for geom in meshes if geom.contype or geom.conaffinity]:
        raise ValueError(f"a mesh touches: {touching[0]}")
    for part in (*spec.geoms, *spec.sites):
        part.material = ""
    for part in (*meshes, *spec.meshes, *spec.skins, *spec.materials, *spec.textures):
        spec.delete(part)
    return spec.compile(), len(meshes)


def touches(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """Contacts with what does not move, and between bodies."""
    fixed = (model.body_weldid[model.geom_bodyid[data.contact.geom]] == 0).any(axis=1) if data.ncon else np.zeros(0)
    return int(fixed.sum()), int(len(fixed) - fixed.sum())


def states(model: mujoco.MjModel, count: int) -> list[np.ndarray]:
    """Positions, velocities and controls; in half of them bodies touch each other where some were found to."""
    data, drawn = mujoco.MjData(model), [dropped(model, 2 * count, 0), dropped(model, 2 * count, 1, spread=2.0)]
    at = [np.concatenate(parts) for parts in zip(*drawn, strict=True)]
    tangled = []
    for data.qpos in at[0]:
        mujoco.mj_forward(model, data)
        tangled.append(touches(model, data)[1] > 0)
    rng = np.random.default_rng(0)
    some, others = (rng.permutation(np.flatnonzero(np.array(tangled) == flag)) for flag in (True, False))
    rows = np.r_[some[: count // 2], others][:count]
    return [part[rows] for part in at]


def difference(model: mujoco.MjModel, count: int = 32) -> dict[str, Any]:
    """By how much the tree and MuJoCo differ."""
    qpos, qvel, ctrl = states(model, count)
    model = converged(model)
    step = qacc_of(fold(read_tree(model)), 1)
    data = [mujoco.MjData(model) for _ in qpos]
    found: dict[str, Any] = {"worlds": len(qpos), "contacts": [0, 0]}
    sound, first = np.ones(len(qpos), bool), np.zeros(len(qpos))
    for world, *at in zip(data, qpos, qvel, ctrl, strict=True):
        world.qpos, world.qvel, world.ctrl = at
    for index in range(STEPS):
        for world in data:
            mujoco.mj_forward(model, world)
        qpos, qvel, qacc, settled = step(Values(), qpos, qvel, ctrl)
        expected = np.array([world.qacc for world in data])
        errors = np.linalg.norm(qacc - expected, axis=1) / (1.0 + np.linalg.norm(expected, axis=1))
        sound &= np.asarray(settled)
        if not index:
            found["contacts"] = [sum(pair) for pair in zip(*(touches(model, world) for world in data), strict=True)]
            first = errors
        for world in data:
            mujoco.mj_step(model, world)
    velocity = np.abs(qvel - [world.qvel for world in data])[sound].max(initial=0.0)
    worst = {"acceleration": float(first[sound].max(initial=0.0)), "velocity": float(velocity)}
    return found | {"unsettled": int((~sound).sum())} | worst


def rows(names: list[str]) -> Iterator[dict[str, Any]]:
    """Findings for each model."""
    for name in names:
        file = file_of(name)
        if file is None:
            print(f"{name}: its package is not installed")
            continue
        model, meshes = read(file)
        row = {"model": name, "degrees of freedom": model.nv} | ({"meshes left out": meshes} if meshes else {})
        if refused := [fault.what for fault in faults(model)]:
            row["refused"] = refused
        else:
            row |= difference(model)
            jax.clear_caches()
        print(json.dumps(row), flush=True)
        yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    everything = [f"{package}/{model}" for package, models in ZOO.items() for model in models]
    parser.add_argument("models", nargs="*", default=everything, help="PACKAGE/MODEL of those below, or MJCF files")
    parser.add_argument("--also", nargs="*", default=[], help="MJCF files, beside the models")
    parser.add_argument("--out", type=Path, default=RECORD, help="the record")
    asked = parser.parse_args()
    compute.start()
    os.environ["XLA_FLAGS"] += f" {PLAIN_KERNELS}"
    jax.config.update("jax_enable_x64", True)
    made_by = compute.made_by() | {"command": " ".join(["python", "experiments/other_robots.py", *sys.argv[1:]])}
    made_by["packages"] = {name: version for name in ZOO if (version := version_of(name))}
    before = json.loads(asked.out.read_text(encoding="utf-8"))["rows"] if asked.out.is_file() else []
    found = {row["model"]: row for row in before}
    for row in rows([*asked.models, *asked.also]):
        found[row["model"]] = row
        record = made_by | {"steps": STEPS, "rows": [found[name] for name in sorted(found, key=str.lower)]}
        asked.out.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def version_of(package: str) -> str | None:
    """The version of an installed package."""
    from importlib.metadata import packages_distributions, version

    names = packages_distributions().get(package)
    return version(names[0]) if names else None


if __name__ == "__main__":
    main()
