"""Tasks and learners of a user's own, named by their import path."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import pytest
from command_line import told
from hop import Hop

import humanoid_mjx
from humanoid_mjx import FiniteTask, InputError, key, make_learner, make_task, spec, train
from humanoid_mjx.control import Law
from humanoid_mjx.learners.base import Outcome, StepLearner
from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.check import check_task
from humanoid_mjx.tasks.continuous import ContinuousTask

DATA = Path(__file__).parents[1] / "data"
LEARNER = {"name": "hop:BoldQ", "envs": 16, "rollout": 8, "discount": 0.9, "evaluations": 2, "learning_rate": 0.01}
CONFIG = {"name": "hop", "task": {"name": "hop:Hop"}, "learner": LEARNER, "total_steps": 1024, "record": 1, "seeds": 1}
SCRIPT = Path(sys.executable).parent / "humanoid-mjx"
TYPED = """
import contextlib, io, json, runpy, sys
from humanoid_mjx import compute
path, ends = list(sys.path), []
script, commands = sys.argv[1:]
for words in json.loads(commands):
    sys.argv[:], sys.path[:] = [script, *words], path
    sys.modules.pop("hop", None)
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = runpy.run_path(script, run_name="__main__")
        except SystemExit as ended:
            code = ended.code
    compute.start = lambda **_: None  # a process starts once
    ends.append((code, out.getvalue(), err.getvalue()))
print(json.dumps(ends))
"""


def typed(folder, *commands):
    """Commands typed in a folder: (exit code, output, errors) of each.

    One process runs the installed script for them all. Its Python does not know the modules of the tests, and each
    command finds the user's module by itself.
    """
    words = json.dumps([list(map(str, command)) for command in commands])
    program = [sys.executable, "-P", "-c", TYPED, str(SCRIPT), words]
    environment = os.environ | {"PYTHONPATH": str(Path(humanoid_mjx.__file__).parents[1])}
    done = subprocess.run(program, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


FEW = ("--episodes", 2)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder with a user's own module and config, and what commands typed there say, which make a run folder and a
    policy."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copy(DATA / "hop.py", folder / "hop.py")
    (folder / "my.yaml").write_text(json.dumps(CONFIG))
    return folder, typed(
        folder,
        ("sweep", "my.yaml", "--out", "run"),
        ("export", "run", "hop.npz"),
        ("evaluate", "hop.npz", *FEW),
        ("info", "hop:Hop", "--keys"),
    )


def test_what_they_learned_is_found_again_from_any_folder(own, tmp_path):
    """In one's own folder by itself; elsewhere where one says so."""
    folder, here = own
    assert [code for code, *_ in here] == [0] * 4, here
    assert "task.stride" in here[-1][1]
    run, policy, again = folder / "run", folder / "hop.npz", tmp_path / "again.npz"
    export, evaluate = ("export", run, again), ("evaluate", policy, *FEW)
    *refused, unknown, exported, evaluated, resumed = typed(
        tmp_path, export, evaluate, ("info", "hop:Hop", "--keys"), (*export, "--trust"), (*evaluate, "--trust"),
        ("sweep", folder / "my.yaml", "--resume", "--out", run),
    )  # fmt: skip
    assert all(code == 2 and "'hop:Hop' is code that is neither" in err for code, _, err in refused), refused
    assert unknown[0] == 2 and f"No module named 'hop' on Python's path or in {tmp_path}." in unknown[2], unknown
    assert [code for code, *_ in (exported, evaluated, resumed)] == [0] * 3, (exported, evaluated, resumed)


@pytest.mark.parametrize(
    ("name", "inside", "runs"),
    [
        ("humanoid_mjx.tasks.joint_reach:JointReach", "", True),
        ("mine:Task", "", True),
        ("pack.deep.mine:Task", "", True),
        ("mine:Task", "run", False),  # comes with the run folder
        ("antigravity:Task", "", False),
        ("numpy.testing:Task", "", False),
        ("os:Task", "", False),
        ("__main__:Task", "", False),
        ("nowhere:Task", "", True),  # and then cannot be imported
    ],
)
def test_only_ones_own_modules_are_run(name, inside, runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    place = tmp_path / inside / name.partition(":")[0].replace(".", "/")
    if name.startswith(("mine", "pack")):
        place.parent.mkdir(parents=True, exist_ok=True)
        place.with_suffix(".py").write_text("raise SystemExit('it ran')")
    (tmp_path / "run").mkdir(exist_ok=True)
    refused = "neither this package's nor below the working directory; add --trust"
    with spec.own_modules_only(tmp_path / "run"), spec.modules_in(str(tmp_path / inside)):
        with pytest.raises((InputError, SystemExit)) as caught:
            spec.find("task", {}, ContinuousTask, name)
        assert (refused in str(caught.value)) == (not runs)
        assert "antigravity" not in sys.modules
    sys.modules.pop("pack", None), sys.modules.pop("pack.deep", None)


def test_a_config_that_one_looks_at_runs_nothing_from_elsewhere(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    (tmp_path / "there/nasty.py").write_text("open('ran', 'w')")
    task = {"name": "nasty:Task"}
    (tmp_path / "there/x.yaml").write_text(json.dumps(CONFIG | {"task": task}))
    for words in (["info", "../there/x.yaml"], ["info", "../there/x.yaml", "--keys"]):
        with pytest.raises(InputError, match="add --trust"):
            told(*words)
    assert not Path("ran").exists()
    help_text = told("--help")
    assert "--trust" in help_text and "may name code" in help_text


class WrongSize(Hop):
    observation_size: ClassVar = 2


class NoState(Hop):
    def step(self, state, action, key):
        return state.data


class OtherDtype(Hop):
    def step(self, state, action, key):
        after = super().step(state, action, key)
        return after._replace(data=(after.data[0], after.data[1].astype(jnp.float32)))


class OtherTerms(Hop):
    def step(self, state, action, key):
        return super().step(state, action, key)._replace(metrics={})


def returning(of, **fields):
    """A class whose `reset` and `step` return a `State` with other fields."""

    class Returning(of):
        def reset(self, key):
            return super().reset(key)._replace(**fields)

        def step(self, state, action, key):
            return super().step(state, action, key)._replace(**fields)

    Returning.__name__ = next(iter(fields)).title()
    return Returning


class NoStep(Hop):
    step = Hop.__base__.step


class ShapedByAValue(Hop):
    hops: int = traced(3)

    def step(self, state, action, key):
        return super().step(state, action, key)._replace(reward=jnp.ones(self.hops).sum())


class BranchOnAValue(Hop):
    def step(self, state, action, key):
        if self.stride > 0.1:
            return super().step(state, action, key)
        return state


FAULTS = {
    ShapedByAValue: r"ShapedByAValue lets an array's shape or a Python branch depend on a traced value .* make that",
    BranchOnAValue: r"BranchOnAValue lets .* \(test_own_tasks.py, line \d+: if self.stride > 0.1:\)",
    WrongSize: r"WrongSize.reset must return obs of shape \(2,\), got \(1,\)",
    NoState: r"NoState.step must return a State, got a tuple",
    OtherDtype: r"OtherDtype.step must return data\[1\] as reset does, int32\[\], got float32\[\]",
    OtherTerms: r"OtherTerms.step must return a state of the structure that reset returns; metrics\['ahead'\] is",
    returning(Hop, metrics={"a": jnp.ones(2)}): r"metrics, a dict of scalars by name, got shapes \{'a': \(2,\)\}",
    returning(Hop, metrics={"a": {"b": 1.0}}): r"Metrics.reset must return metrics, a dict of scalars by name",
    returning(Hop, metrics=None): r"Metrics.reset must return metrics, a dict of scalars by name, got shapes None",
    **{
        returning(Hop, metrics={name: 1.0}): f"Metrics: every run has a curve or column '{name}'; rename this metric"
        for name in ("return", "steps", "success", "episodes", "point", "td_error", "greedy_return")
    },
    returning(Hop, executed=jnp.zeros(1)): "executed as an integer for each joint, or None",
    returning(Hop, obs=jnp.bool_([True])): "obs and final_obs as numbers",
    NoStep: r"NoStep must implement step",
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda cls: cls.__name__)
def test_a_task_that_breaks_the_protocol_gets_one_sentence(fault):
    check_task(Hop())
    with pytest.raises(InputError, match=FAULTS[fault]) as caught:
        check_task(fault())
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


@pytest.mark.parametrize("kind", [int, float])
def test_success_may_be_a_number(kind):
    """As the other flags may: 2 counts once."""

    class Counted(Hop):
        def step(self, state, action, key):
            after = super().step(state, action, key)
            return after._replace(success=jnp.asarray(2 * after.success, kind))

        def reset(self, key):
            return super().reset(key)._replace(success=jnp.zeros((), kind))

    values = {"total_steps": 512, "record": 1, "envs": 16, "rollout": 8}
    counted, plain = (train(make_learner("linear_q", cls(), **values), key(0)).curve for cls in (Counted, Hop))
    assert 0 < counted["success"] == plain["success"] <= 1


class HalfAsPrecise(Hop):
    stride: float = traced(0.25)

    def reset(self, key):
        state = super().reset(key)
        return state._replace(obs=state.obs.astype(jnp.float16))

    def step(self, state, action, key):
        return super().step(state, action, key)._replace(obs=state.obs + 0.0 * self.stride)


def test_types_are_those_of_a_training():
    """There a field is an array that decides the type of what is computed with it."""
    with pytest.raises(InputError, match=r"must return obs as reset does, float16\[1\], got float32\[1\]"):
        check_task(HalfAsPrecise())


def test_an_episode_begins_with_nothing_won():
    state = Hop().reset(jax.random.key(0))
    assert state.reward == state.metrics["ahead"] == 0.0 and not (state.terminated | state.truncated | state.success)


class OfTheirOwn(Hop):
    def step(self, state, action, key):
        return state.data[0] + None


class NotFinite(Hop):
    def step(self, state, action, key):
        return super().step(state, action, key)._replace(reward=jnp.float32(jnp.nan))


class Short(Law):
    def __call__(self, reference, state):
        return reference.qpos[:3]


class NoLaw(Law):
    pass


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (Short, r"control: Short must return torques of shape \(10,\), got \(3,\)"),
        (NoLaw, "task: NoLaw must implement __call__"),
    ],
)
def test_a_law_of_ones_own_on_a_task_that_ships_gets_one_sentence(law, says):
    task = make_task("stand", control=f"{__name__}:{law.__name__}")
    with pytest.raises(InputError, match=says):
        check_task(task)


class Alone(StepLearner):
    """The same action, as it is told; breaks the protocol where it is told to."""

    wrong: str = ""

    def init(self, key, policy=None):
        return jnp.zeros(2), jnp.float32(0)

    def train_step(self, carry):
        none = jnp.float32(0)
        totals = {"steps": none, "success": none, "return": none}
        outcome = Outcome(carry[1], none, totals if self.wrong != "totals" else {"steps": none}, {})
        after = carry[0], (carry[1] + 1 if self.wrong != "state" else jnp.int32(1))
        return after if self.wrong == "tuple" else (after, outcome)

    def progress(self, carry):
        return carry[1] / self.total_steps

    def policy(self, carry):
        return "none" if self.wrong == "policy" else carry[0]

    def act(self, policy, observation, key):
        if self.wrong == "act":
            return policy + "a"
        return jnp.full((2,) if self.wrong == "shape" else (1,), -1 if self.wrong == "range" else 0, jnp.int32)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("tuple", r"learner: Alone.train_step must return a tuple \(training state, Outcome\)"),
        ("totals", "an Outcome whose totals have return, success, too"),
        ("state", r"Alone.train_step must return \[1\] as init does, float32\[\], got int32\[\]"),
        ("policy", "Alone.policy must return a pytree of arrays"),
        ("shape", r"Alone.act must return an action of shape \(1,\), got \(2,\)"),
        ("act", r"learner: Alone cannot be used: TypeError: .* \(test_own_tasks.py, line \d+: return policy . .a.\)"),
    ],
)
def test_a_learner_that_breaks_the_protocol_gets_one_sentence(wrong, says):
    values = {"total_steps": 5, "record": 1}
    train(make_learner(f"{__name__}:Alone", Hop(), **values), key(0))
    with pytest.raises(InputError, match=says):
        train(make_learner(f"{__name__}:Alone", Hop(), wrong=wrong, **values), key(0))


def test_an_action_outside_its_range_scores_nothing():
    """In the evaluation of a training; the index -1 is the last action else."""
    right, wrong = (
        train(make_learner(f"{__name__}:Alone", Hop(), wrong=name, total_steps=5, record=1), key(0)).scores
        for name in ("", "range")
    )
    assert jnp.isfinite(right["greedy_return"]) and jnp.isnan(wrong["greedy_return"])
    assert wrong["greedy_success"] == 0


class Row(FiniteTask):
    """Moves to the right without an end; its table has three rows."""

    num_states: ClassVar = 3
    num_actions: ClassVar = 2

    def reset(self, key):
        return jnp.int32(0)

    def step(self, state, action, key):
        return state + action, 1.0, jnp.bool_(False)


class FloatRow(Row):
    def reset(self, key):
        return 0.0

    def state_index(self, state):  # without the types that tests check
        return state


class Ring(Row):
    def step(self, state, action, key):
        return (state + action) % 3, 0.5, jnp.bool_(False)


class Bandit(Row):
    num_states: ClassVar = 1

    def step(self, state, action, key):
        return state, jnp.float32(action), jnp.bool_(True)


def test_a_bandit_has_one_state():
    check_task(Bandit())
    trained = train(make_learner("tabular_q", Bandit(), episodes=50, learning_rate=1.0), key(0))
    assert trained.policy.weights.tolist() == [[0.0, 1.0]]


class Paid(Bandit):
    bonus: float = traced(1.0)

    def step(self, state, action, key):
        return state, self.bonus * action, jnp.bool_(True)


def test_a_value_of_a_task_may_be_mapped():
    """The trial's rewards then are no numbers, while its ends are."""
    learner = make_learner("tabular_q", Paid(), episodes=50, learning_rate=1.0)
    mapped = jax.vmap(lambda bonus: train(learner.replace(task=learner.task.replace(bonus=bonus)), key(0)))
    assert mapped(jnp.array([1.0, 3.0])).policy.weights[:, 0, 1].tolist() == [1.0, 3.0]


class Counts(Row):
    def step(self, state, action, key):
        return (state + action) % 3, 0.5, state // 2


@pytest.mark.parametrize(
    ("fault", "says"),
    {
        OfTheirOwn: r"OfTheirOwn cannot be used: TypeError: .* \(test_own_tasks.py, line \d+: return state.* None\)\.",
        NoStep: FAULTS[NoStep],
        NotFinite: r"NotFinite has a reward that is not finite in step 1 of 8 times 64 random actions\.",
        Row: r"Row has a state whose row is outside 0 to 2 in step \d+ of",
        Counts: r"Counts.step must return terminated as a bool, got int32; write terminated > 0\.",
        FloatRow: r"FloatRow: the row of a state must be an integer, got float32\[\]",
    }.items(),
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_train_and_check_task_say_the_same(fault, says):
    learner = make_learner("tabular_q" if issubclass(fault, Row) else "deep_q", fault())
    seeds = jax.vmap(key)(jnp.arange(2))
    for start in (
        lambda: check_task(fault()),
        lambda: train(learner, key(0)),
        lambda: jax.vmap(train, (None, 0))(learner, seeds),
    ):
        with pytest.raises(InputError, match=says) as caught:
            start()
        assert "\n" not in str(caught.value)


def test_a_trial_says_whether_episodes_end():
    assert check_task(Ring()) == "Ring: in 8 times 64 random actions no episode ended, with rewards from 0.5 to 0.5."
    assert " episodes ended, with rewards from " in check_task(Hop())
    assert check_task(make_task("joint_reach")) == ""
