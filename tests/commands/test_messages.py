"""Messages of the command line: what is typed wrongly gets one sentence, which ends with what to type instead."""

import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hop import BoldQ, Hop  # pyright: ignore[reportMissingImports] pytest's pythonpath has tests/data
from small_sweep import CONFIG

from humanoid_mjx import InputError, sweep
from humanoid_mjx.commands.evaluate import evaluation_table, words_on_returns
from humanoid_mjx.config import parse
from humanoid_mjx.evaluation.c_source import c_source
from humanoid_mjx.evaluation.policy import StoredPolicy
from humanoid_mjx.evaluation.replay import _culprit
from humanoid_mjx.files import meant
from humanoid_mjx.learners.base import Outcome, StepLearner
from humanoid_mjx.learners.deep import DeepQ
from humanoid_mjx.learners.normalisation import moments
from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.statistics import estimated
from humanoid_mjx.spec import known
from humanoid_mjx.training import pool
from humanoid_mjx.training.pool import Pool
from humanoid_mjx.training.program import Training
from humanoid_mjx.training.progress import Reporter

MJCF = """<mujoco><worldbody><geom type="plane" size="0 0 1"/><body name="trunk"><freejoint/><geom size=".1" mass="3"/>
<body name="foot"><joint name="a_swing"/><geom type="sphere" size=".1"/></body></body></worldbody></mujoco>"""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A working directory with a config, two models, a robot, a policy file and two run folders."""
    monkeypatch.chdir(tmp_path)
    for name in ("three", "lonely"):
        Path(f"{name}.xml").write_text(MJCF)
    Path("three.yaml").write_text("model: three.xml\nfeet: [foot]\n")
    Path("leg.urdf").write_text('<robot name="leg"><link name="trunk"/></robot>')
    Path("urdf.yaml").write_text("model: leg.urdf\nfeet: [foot]\n")
    Path("cart_pole.yaml").write_text(json.dumps(CONFIG))
    Path("mine.npz").write_bytes(b"")
    for name in ("joint1", "joint1-2"):
        Path(f"runs/{name}/figures").mkdir(parents=True)
        Path(f"runs/{name}/config.yaml").write_text(json.dumps(CONFIG))
        Path(f"runs/{name}/results.parquet").write_bytes(b"PAR1")
    return tmp_path


RESUME = "humanoid-mjx sweep runs/joint1/config.yaml --out runs/joint1 --resume completes it"
ROBOT = "humanoid-mjx info three.yaml shows it, humanoid-mjx sweep stand --set task.robot=three.yaml trains it"

TYPED = {
    "sweep cart_pole": ", but cart_pole.yaml is one",
    "sweep cart_pole --resume": ", but cart_pole.yaml is one",
    "sweep cart_pol": ", but cart_pole.yaml is one",
    "sweep cartpole.yaml": "there is no such file, but cart_pole.yaml is one",
    "info cart_pole": ", but cart_pole.yaml is one",
    "sweep three": f"; three.yaml is a robot: {ROBOT}",
    "sweep three.yaml": f"this is no config; it is a robot: {ROBOT}",
    "sweep three.xml": f"this is no config; three.yaml is a robot: {ROBOT}",
    "sweep lonely.xml": "it is an MJCF: humanoid-mjx info lonely.xml shows it, and a YAML beside it with the",
    "sweep mine.npz": "it is a policy: humanoid-mjx play mine.npz shows it",
    "sweep runs/joint1": RESUME,
    "sweep joint_1": "did you mean 'joint1'? known are joint1, joint5, joint4, ",
    "sweep stand --set task.robot=three": "unknown robot 'three', but three.yaml is one",
    "sweep stand --set task.robot=three.xml": "unknown robot 'three.xml', but three.yaml is one",
    "sweep stand --set task.robot=lonely.xml": "it is an MJCF: humanoid-mjx info lonely.xml",
    "sweep stand --set task.robot=thre.yaml": ", but three.yaml is one",
    "sweep stand --set task.robot=three.yaml": 'no limit for a_swing; write its N m as torque: {"a_swing": 20}',
    "sweep joint4 --set learner.start_from=joint1": ", but runs/joint1 is one",
    "play joint1": "neither a run folder nor a policy, but runs/joint1 is one",
    "evaluate joint1": "neither a run folder nor a policy, but runs/joint1 is one",
    "evaluate joint1 --point 1": "neither a run folder nor a policy, but runs/joint1 is one",
    "export joint1 x.npz": "neither a run folder nor a policy, but runs/joint1 is one",
    "report joint1": "there is no such folder, but runs/joint1 is one",
    "plot joint1": ", but runs/joint1 is one",
    "runs joint1": "there is no such folder, but runs/joint1 is one",
    "report runs": ", but runs/joint1 and runs/joint1-2 are",
    "evaluate runs": ", but runs/joint1 and runs/joint1-2 are",
    "evaluate runs/joint1/results.parquet": "this is no policy file, but runs/joint1 is one",
    "evaluate runs/joint1/figures": ", but runs/joint1 is one",
    "evaluate three.xml": f"this is no policy file; three.yaml is a robot: {ROBOT}",
    "evaluate lonely": "lonely.xml is an MJCF",
    "evaluate mine.nzp": ", but mine.npz is one",
    "evaluate mine.npz": "this is no policy file, or a truncated or damaged one",
    "evaluate stand_cpu": "it is a config: humanoid-mjx sweep stand_cpu trains it",
    "export three x.xml": "unknown robot 'three', but three.yaml is one",
    "info thre.xml": ", but three.xml and three.yaml are",
    "info dog.yaml": "but dog is one",
    "play walk --out cart_pole.yaml/y.gif": "cart_pole.yaml is a file and no folder",
    "sweep cart_pole.yaml --out cart_pole.yaml/y": "a file stands where a folder is wanted",
    "sweep leg.urdf": "it is a URDF: humanoid-mjx info leg.urdf says how it becomes an MJCF",
    "sweep stand --set task.robot=leg.urdf": "it is a URDF: humanoid-mjx info leg.urdf says",
    "play leg.urdf": "it is a URDF: humanoid-mjx info leg.urdf says",
    "info leg.urdf": "leg.urdf is a URDF, without a free joint and motors; docs/your_robot.md (From a URDF)",
    "info urdf.yaml": "urdf.yaml: model: leg.urdf is a URDF, without a free joint and motors; docs/your_robot.md",
    "info --time": "info --time: name a config, and leave --keys out",
    "info deep_q --set learner.epsilon=1": "info --set: name a config, and leave --keys out",
    "info joint1 --keys --set seeds=3": "info --set: name a config",
    "info three.xml --time": "info --time: name a config",
    "info dog --set task.robot=go1": "info --set: name a config",
    "info lower_bodx": "did you mean 'lower_body'?",
    # the pair of task and learner comes first, then the unit of the length; no number is converted
    "sweep stand --set learner.name=tabular_q": "stand: learner.name: tabular_q learns finite tasks, which stand is "
    "not; learners for it are brax_ppo, deep_q, linear_q",
    "sweep stand --set learner.name=tabular_q --set episodes=10": "tabular_q learns finite tasks, which stand is not",
    "sweep stand_cpu --set episodes=1000": "episodes: deep_q counts control steps of all environments; write "
    "total_steps in its place (in commands --set episodes=null --set total_steps=N)",
    "sweep joint1 --set learner.name=deep_q": "write total_steps in its place",
    "sweep stand --set learner.epsilom=1": "and 18 more: humanoid-mjx info deep_q --keys shows them",
    "sweep joint1 --set sweep.axes.learner.discount={linspace:[0,0.9,1000]}": "300,000 points are more than "
    "100,000; draw some of them: mode: random with points: 200",
    # words that typer does not take
    "play stand --robots 17": "--robots must be less than or equal to 16; humanoid-mjx play --help",
    "play stand --episode -1": "--episode must be greater than or equal to 0",
    "play stand --episode two": "--episode must be a valid integer",
    "play": "Missing argument 'RUN|POLICY'; humanoid-mjx play --help",
    "play stand --robotz 2": "No such option: --robotz",
    "sweeep joint1": "No such command 'sweeep'",
}


@pytest.mark.parametrize("typed", TYPED)
def test_one_sentence_says_what_to_type(desk, said, typed):
    code, _, err = said(*typed.split())
    assert code == 2 and err.startswith("error: ") and err.count("\n") == 1 and err.endswith(".\n"), err
    assert TYPED[typed] in err, err
    assert len(err) < 400


def test_without_a_command_the_help_is_shown(said):
    code, out, err = said()
    assert code == 2 and "Usage" in out + err


def test_names_that_no_file_can_have_mean_nothing(tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")  # "..": a folder without run folders
    for name in ("\x00", "a" * 5000, "", "/", "..", "[", "a/\x00"):
        assert meant(name, "robot") == ""


def test_a_short_list_of_names_is_whole_and_a_long_one_is_not():
    assert known("c", ["a", "bb"]) == "known are a, bb"
    words = known("name_1", [f"name_{i}" for i in range(100)], "info")
    assert words.startswith("did you mean 'name_1'? known are name_1, ") and words.count("name_") == 6
    assert words.endswith(" and 95 more: humanoid-mjx info shows them")


LEG = """<body name="{0}_thigh" pos="0 {1} 0"><joint name="{0}_hip" axis="1 0 0" range="-40 40"/><geom size=".03"/>
<geom name="{0}_foot" size=".03" pos="0 0 -.3"/></body>"""


def test_what_is_no_mirror_image_is_said(said, tmp_path):
    """Hips turn about x, so a leg's image is at the negative angle."""
    legs = LEG.format("r", -0.1) + LEG.format("l", 0.1)
    body = MJCF[: MJCF.index('<body name="foot"')] + legs + "</body></worldbody></mujoco>"
    (tmp_path / "two.xml").write_text(f"<!-- once <robot name='two'/> --> {body}")  # which makes it no URDF
    for home, words in (
        ({".*_hip": 10}, "mirror    home of r_hip is 10; by its image l_hip it would be -10"),
        ({"r.*": 10, "l.*": -10}, None),
    ):
        declared = {"model": "two.xml", "feet": ["r_foot", "l_foot"], "home": home, "torque": 20, "mirror": {"r": "l"}}
        (tmp_path / "two.yaml").write_text(json.dumps(declared))
        _, out, _ = said("info", str(tmp_path / "two.yaml"))
        assert words in out if words else "mirror    " not in out


@pytest.mark.parametrize(
    ("name", "words"), [("lower_body", "4 points each"), ("leg", "5 joints"), ("deep_q", "layers")]
)
def test_info_of_a_robot_in_python_and_of_a_learner(said, name, words):
    code, out, _ = said("info", name)
    assert code == 0 and words in out


def test_a_place_that_is_taken_is_said_in_the_words_of_python_and_of_the_command(desk, said):
    RunFolder.create(Path("run"), {"name": "x"}).close()
    with pytest.raises(
        InputError, match="already exists; resume it with resume=True, or choose another place with out=PATH"
    ):
        sweep(CONFIG, "run")
    assert (
        "already exists; resume it with --resume, or choose another place with --out."
        in said("sweep", "cart_pole.yaml", "--out", "run")[2]
    )


HOP = Path(__file__).parents[1] / "data" / "hop.py"
SLIPS = {
    (
        '{"ahead": ahead})',
        '{"ahead": ahead})._replace(rewrad=ahead)',
    ): "unexpected field names: ['rewrad']; did you mean 'reward'? ({0}.py, line 27: return State((place, hops)",
    ('"ahead": ahead})', '"ahead": ahead}, rewrad=0)'): "did you mean 'reward'? ({0}.py, line 27: return",
    (
        "hops + 1\n",
        "hops + plaec\n",
    ): "NameError: name 'plaec' is not defined; did you mean 'place'? ({0}.py, line 25: there,",
    (
        "self.stride",
        "self.strid",
    ): "has no attribute 'strid'; did you mean 'stride'? ({0}.py, line 24: place = place + self",
    (
        "jnp.clip",
        "jnp.zeros(3) + jnp.zeros(4) + jnp.clip",
    ): "incompatible shapes for broadcasting: (3,), (4,) ({0}.py, line 26:",
    (
        "layers: int = 1",
        "layers: int = 1\n\n    def q_values(self, value, obs):\n        return oops",
    ): "NameError: name 'oops' is not defined ({0}.py, line 35: return oops)",
    (
        ") - 1.0\n",
        ") - 1.0 + jnp.log(-1.0 - place[0])\n",
    ): "Hop has a reward that is not finite in step 1 of 8 times 64",
    (", there, place, {", ", there, place / 0, {"): "Hop has a final_obs that is not finite in step 1 of 8 times 64",
}


@pytest.mark.parametrize("number", range(len(SLIPS)))
def test_a_slip_in_a_users_class_names_their_file_line_and_text(number, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (old, new), words = list(SLIPS.items())[number]
    name, text = f"slip_{number}", HOP.read_text()
    assert old in text
    Path(f"{name}.py").write_text(text.replace(old, new))
    learner = {"name": f"{name}:BoldQ", "envs": 4, "rollout": 2}
    config = {"name": "slip", "task": {"name": f"{name}:Hop"}, "learner": learner, "total_steps": 8}
    Path("slip.yaml").write_text(json.dumps(config))
    code, _, err = said("sweep", "slip.yaml")
    assert code == 2 and err.count("\n") == 1 and words.format(name) in err, err


CORRIDOR = """
import jax.numpy as jnp

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.finite import FiniteTask


class Corridor(FiniteTask):
    num_actions = property(lambda self: 2)
    num_states = property(lambda self: 4)
    bonus: float = traced(1.0)

    def reset(self, key):
        return jnp.int32(0)

    def step(self, state, action, key):
        state = jnp.clip(state + 2 * action - 1, 0, 3)
        return state, jnp.where(state == 3, jnp.log(self.bonus), -0.1), state == 3
"""


def test_a_sweep_names_the_number_that_stopped_a_run_and_ends_with_the_next_command(said, tmp_path, monkeypatch):
    """Only the second point has a reward that is not finite, and so the check of the task does not see it."""
    monkeypatch.chdir(tmp_path)
    Path("corridor_of_mine.py").write_text(CORRIDOR)
    config = {"name": "mine", "task": {"name": "corridor_of_mine:Corridor"}, "learner": {"name": "tabular_q"}}
    config |= {"sweep": {"axes": {"task.bonus": [1.0, -1.0]}}, "episodes": 20, "record": 5}
    Path("mine.yaml").write_text(json.dumps(config))
    code, out, err = said("sweep", "mine.yaml")
    words = "1 run stopped at numbers that were not finite; the summary marks them. Point 1 with seed 0 stopped after "
    words += "episode 0; not finite: the reward. In Python, humanoid_mjx.evaluation.replay.replay('runs/mine', 1, 0) "
    assert code == 0 and words in out, err
    assert out.endswith("\nnext: humanoid-mjx report runs/mine\n")
    assert said("report", "runs/mine")[0] == 0
    assert "not finite: the reward" in Path("runs/mine/report.html").read_text()


class Seen(NamedTuple):
    moments: Any
    final_obs: Any
    value: Any


class Breaks(StepLearner):
    """The part of its state or outcome that is named becomes infinite."""

    part: str

    def train_step(self, carry):
        parts = {"step": carry.moments.mean} | {name: jnp.float32(0) for name in ("slip", "error", "value", "obs")}
        parts = {name: x + jnp.inf * (name == self.part) if name == self.part else x for name, x in parts.items()}
        after = Seen(carry.moments._replace(mean=parts["step"]), parts["obs"], parts["value"])
        return after, Outcome(0.0, 0.0, {"return": parts["slip"], "slip": parts["slip"]}, {"td_error": parts["error"]})

    def progress(self, carry):
        return jnp.float32(0.25)


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("obs", "an observation"),
        ("step", "an observation"),
        ("slip", "the reward slip"),
        ("error", "the loss (try a smaller learner.learning_rate)"),
        ("value", "a weight (try a smaller learner.learning_rate)"),
    ],
)
def test_the_number_that_is_not_finite_is_named(part, words):
    zero = jnp.float32(0)
    training = Training(Seen(moments(2), zero, zero), zero, None, True)
    assert _culprit(Breaks.model_validate({"task": Hop(), "part": part}), training) == (words, 0.25)


class OtherNetwork(DeepQ):
    def q_values(self, value, obs):
        return super().q_values(value, obs) * 2.0


class NoNorm(DeepQ):
    def network(self):
        from flax import linen as nn

        return nn.Sequential([nn.Dense(2), lambda q: q[..., None, :]])


@pytest.mark.parametrize(("kind", "written"), [(BoldQ, True), (OtherNetwork, False), (NoNorm, False)])
def test_only_the_shipped_network_becomes_c(kind, written):
    learner = kind(task=Hop(), total_steps=8, width=4, layers=1)
    policy = jax.eval_shape(lambda: learner.policy(learner.init(jax.random.key(0))))
    policy = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), policy)
    config = {"name": "c", "task": {"name": "hop:Hop"}, "learner": {"name": "hop:BoldQ"}}
    trained = StoredPolicy(learner, policy, 0, 0, "mine", parse(config), {})
    if written:
        assert "void act(" in c_source(trained)
        return
    with pytest.raises(InputError, match="mine: a network of one's own cannot be written as C"):
        c_source(trained)


def row(policy, agent, success, total, discounted):
    episodes = {"success": np.arange(100) < success, "return": np.full(100, total), "steps": np.ones(100)}
    return estimated(policy, agent, episodes | {"discounted_return": np.full(100, discounted)})


def test_an_untrained_policy_is_not_said_to_lose_by_others_that_wait():
    config = parse({"name": "still", "task": {"name": "stand"}, "learner": {"name": "deep_q"}})
    nothing: Any = None
    still = StoredPolicy(nothing, None, 0, 0, "still", config, {})
    rows = [
        row("still", "greedy", 0, 3.0, 2.0),
        row("stand", "zero", 100, 9.0, 5.0),
        row("stand", "random", 0, 4.0, 1.0),
    ]
    assert words_on_returns([still], rows) == []
    assert words_on_returns([still], [row("still", "greedy", 2, 3.0, 2.0), *rows[1:]]) == []
    (words,) = words_on_returns([still], [row("still", "greedy", 100, 3.0, 6.0), *rows[1:]])
    assert "waiting adds up" in words
    names = evaluation_table("", rows).columns[0]
    assert list(names.cells) == ["still (greedy)", "zero agent", "random agent"]
    names = evaluation_table("", [*rows, row("other", "zero", 0, 0.0, 0.0)]).columns[0]
    assert list(names.cells)[-1] == "zero agent in the task of other"


def test_the_success_that_a_bar_shows_does_not_fall_where_other_points_begin(tmp_path, monkeypatch):
    """The second block of runs never learns."""
    seen, phases, train = [], [], Pool.train
    monkeypatch.setattr(pool, "MAX_STEPS", 20_000)
    monkeypatch.setattr(Pool, "train", lambda self: (train(self), time.sleep(0.15)))  # so long that the bar looks

    class Keeps(Reporter):
        def update(self, state):
            seen.append((state.done / state.total, state.success))

        def phase(self, text):
            phases.append(text)

    axes = {"learner.learning_rate": [0.7, 1e-6]}
    sweep(
        CONFIG | {"sweep": {"axes": axes}, "seeds": 4, "episodes": 4000},
        tmp_path / "run",
        pool_size=2,
        reporter=Keeps(),
    )
    late = [success for share, success in seen if share > 0.5]
    assert late and min(late) > 0.95
    assert not {"training", "evaluating"} & set(phases[phases.index("training and evaluating") :])
