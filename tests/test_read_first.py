"""The program of docs/read_first.md learns as the package's `tabular_q` does."""

from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from docs_reader import blocks

from humanoid_mjx import key, make_learner, make_task, train

PAGE = Path(__file__).parent.parent / "docs" / "read_first.md"
EPISODES, SEEDS, PARTS = 100, 600, 10


def test_the_program_has_the_distribution_of_the_package():
    """Means over seeds differ by less than 4.5 standard errors: 10 parts of training and 48 values of the table."""
    (text,) = (block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.title == "q_learning.py")
    assert "humanoid_mjx" not in text and len(text.splitlines()) < 70
    names = {"__name__": "q_learning"}
    exec(compile(text, "q_learning.py", "exec"), names)
    names["EPISODES"] = EPISODES
    program = SimpleNamespace(**names)
    keys = jax.random.split(jax.random.key(1), SEEDS)
    tables, steps = jax.jit(jax.vmap(program.train, (None, None, None, 0)))(0.6, 0.97, 0.5, keys)
    task = make_task("joint_reach", joint=1, max_episode_steps=100)
    values = {"epsilon": 0.6, "epsilon_decay": 0.97, "learning_rate": 0.5, "discount": 0.9}
    learner = make_learner("tabular_q", task, episodes=EPISODES, record=PARTS, **values)
    found = jax.vmap(train, (None, 0))(learner, jax.vmap(key)(jnp.arange(SEEDS)))
    pairs = [
        (np.asarray(steps).reshape(SEEDS, PARTS, -1).mean(axis=-1), found.curve["steps"]),
        (tables, found.policy.weights),
    ]
    for one, other in pairs:
        one, other = np.asarray(one, float), np.asarray(other, float)
        error = np.sqrt((one.var(axis=0) + other.var(axis=0)) / SEEDS)
        assert (np.abs(one.mean(axis=0) - other.mean(axis=0)) <= 4.5 * error + 1e-3).all()
    assert 23 <= np.asarray(steps)[:, -5:].mean() < 40
