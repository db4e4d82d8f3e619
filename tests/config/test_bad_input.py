"""Bad input without end: configs and run folders that are wrong in a drawn way are refused in one sentence."""

import copy
import random
import shutil
from functools import cache, reduce
from operator import getitem

import numpy as np
import pytest
import yaml
from fault_input import WAYS
from small_sweep import CONFIG

import humanoid_mjx
from humanoid_mjx import InputError
from humanoid_mjx.config import load
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.files import folder, names
from humanoid_mjx.runs.listing import list_runs
from humanoid_mjx.training.plan import make_plan

WORDS = ("many", "", "1e", "\x00\x1b[31m", "a" * 5000, "[/b]", "null ", "0x", "os:path")
JUNK = ([], [[1]], {}, {"": {}}, {"name": "nothing"}, float("nan"), float("inf"), 10**400, -(2**63), {"a": [{"b": 1}]})
TRIES = 150
REWARDS = ("bonus", "step_reward", "rewards")


@cache
def shipped(name):
    return yaml.safe_load((folder("configs") / f"{name}.yaml").read_text(encoding="utf-8"))


def leaves(data, path=()):
    """The path of every value within plain values, but for maps of characters and axes."""
    if isinstance(data, dict):
        for key, value in data.items():
            if key not in ("map", "sweep"):
                yield from leaves(value, (*path, key))
    elif not isinstance(data, list):
        yield path, data


def put(data, path, value):
    reduce(getitem, path[:-1], data)[path[-1]] = value


def near(draw, name):
    """A name with a letter doubled, dropped or exchanged."""
    at = draw.randrange(len(name))
    return draw.choice((name[:at] + name[at] + name[at:], name[:at] + name[at + 1 :], name[:at] + "q" + name[at + 1 :]))


def wrong(draw):
    """A shipped config with one fault, and the key that the sentence must name."""
    data = copy.deepcopy(shipped(draw.choice(names("configs", ".yaml"))))
    numbers = [path for path, value in leaves(data) if isinstance(value, (int, float)) and not isinstance(value, bool)]
    path = draw.choice(numbers)
    match draw.randrange(6):
        case 0:  # of another type
            put(data, path, draw.choice(WORDS))
        case 1:  # nested, not finite, or without end
            put(data, path, draw.choice(JUNK))
        case 2:  # of no value at all, where there must be one
            path = (draw.choice(("task", "learner")), "name")
            put(data, path, draw.choice((None, 3, True, [], {})))
        case 3:  # beyond its range: no key but a reward takes a negative number of this size
            path = draw.choice([path for path in numbers if not set(REWARDS) & set(path)])
            put(data, path, draw.choice((-(10**12), -1e30)))
        case 4:  # a name that is nearly one
            path = draw.choice([path for path, _ in leaves(data) if path[-1] != "name"])
            *parents, old = path
            part = reduce(getitem, parents, data)
            path = (*parents, near(draw, old))
            part[path[-1]] = part.pop(old)
        case _:  # a whole part
            path = (draw.choice(("task", "learner")),)
            put(data, path, draw.choice((None, 1, "x", [], [{}], {}, {"nam": "x"})))
    return data, path[-1]


@pytest.mark.parametrize("seed", range(TRIES))
def test_a_wrong_config_gets_one_sentence_that_names_the_key(seed, tmp_path):
    data, key = wrong(random.Random(seed))
    file = tmp_path / "wrong.yaml"
    file.write_text(yaml.safe_dump(data, allow_unicode=True))
    with pytest.raises(InputError) as caught:
        make_plan(load(file))
    message = str(caught.value)
    assert "\n" not in message.replace("\\n", "") and message.endswith("."), message
    # What is no YAML of ours, such as a number of 400 digits, has a line in the place of a key.
    assert str(key) in message or "in line" in message, f"{key}: {message}"
    assert len(message) < 3000


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run, and all that its readers say of it."""
    path = humanoid_mjx.sweep(CONFIG, tmp_path_factory.mktemp("bad") / "small").path
    return path, read(path)


def read(path):
    """All that readers say of a run folder: the list, its tables and the best policy."""
    run = humanoid_mjx.load_run(path)
    found, problems = list_runs(path)
    assert not problems
    (listed,) = found
    found = find_policy(str(path))
    policy = np.asarray(found.policy.q if hasattr(found.policy, "q") else found.policy)
    tables = {name: getattr(run, name) for name in ("results", "summary", "timing")}
    said = {f"{name}.{column}": values for name, table in tables.items() for column, values in table.items()}
    return said | {"policy": policy, "state": np.array([listed.state, str(listed.success)]), "best": str(run.best)}


READ = ("config.yaml", "results.parquet", "summary.parquet", "timing.parquet", "checkpoint/part-00000.npz")


def spoil(draw, file):
    """Damage a file in a drawn way."""
    match draw.randrange(5):
        case 0 | 1:
            file.write_bytes(draw.choice(list(WAYS.values()))(file.read_bytes(), draw))
        case 2:
            file.write_bytes(draw.randbytes(200))
        case 3:
            file.unlink()
        case _:
            file.unlink()
            file.mkdir()


@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_run_is_refused_or_says_what_it_said(whole, seed, tmp_path):
    path, before = whole
    draw = random.Random(seed)
    spoiled = shutil.copytree(path, tmp_path / path.name)
    spoil(draw, spoiled / draw.choice(READ))
    try:
        after = read(spoiled)
    except InputError as error:
        assert "\n" not in str(error) and str(tmp_path) in str(error)
        return
    except AssertionError:  # the list names it, and others do not read what is spoiled
        _, problems = list_runs(spoiled)
        assert len(problems) == 1 and str(tmp_path) in problems[0]
        return
    assert before.keys() == after.keys()
    for name, values in before.items():
        np.testing.assert_array_equal(after[name], values, name)
