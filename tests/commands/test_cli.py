"""The command line: fast to answer, and one compilation for sweeps that differ only in values."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from command_line import told
from compiling import counting_compiles
from small_sweep import CONFIG
from typer.testing import CliRunner

from humanoid_mjx import make_learner, make_task
from humanoid_mjx.cli import app
from humanoid_mjx.files import folder
from humanoid_mjx.spec import InputError

HEAVY = ("jax", "brax", "mujoco", "matplotlib", "flax", "optax", "pyarrow")


@pytest.mark.parametrize("how", ["import humanoid_mjx", "from humanoid_mjx.cli import app"])
def test_asking_for_help_imports_nothing_heavy(how):
    code = f"import sys; {how}; print([name for name in {HEAVY} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("JAX_PLATFORMS=cuda", "jax has no such device here; unset it, or set JAX_PLATFORMS=cpu."),
        ("JAX_PLATFORMS=cpu,foo", "jax has no such device here; unset it, or set JAX_PLATFORMS=cpu."),
        ("JAX_NUM_CPU_DEVICES=0", "jax cannot use this; unset it (Unable to initialize backend 'cpu'"),  # at first use
        ("JAX_ENABLE_X64=foo", "jax cannot use this; unset it (invalid truth value 'foo'"),  # where jax is imported
    ],
)
def test_a_setting_that_jax_cannot_use_gets_one_sentence(setting, words):
    name, _, value = setting.partition("=")
    environment = os.environ | {"JAX_PLATFORMS": "cpu", name: value, "CUDA_VISIBLE_DEVICES": ""}
    command = [sys.executable, "-m", "humanoid_mjx", "info"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    last = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and last.startswith(f"error: {setting}: {words}") and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("name", "value"), [("enable_x64", True), ("debug_nans", True), ("numpy_dtype_promotion", "strict")]
)
def test_settings_with_which_no_learner_trains_are_refused(name, value):
    task = make_task("joint_reach")
    with getattr(jax, name)(value), pytest.raises(InputError, match=f"jax_{name} is {value}: learners "):
        make_learner("tabular_q", task)
    make_learner("tabular_q", task, episodes=10)


def write_config(path, epsilons):
    axes = {"learner.epsilon": epsilons, "learner.learning_rate": [0.2, 0.4]}
    task = CONFIG["task"] | {"joint": 4, "states": 11}
    path.write_text(
        json.dumps(CONFIG | {"name": "two", "task": task, "sweep": {"axes": axes}, "seeds": 2, "episodes": 30})
    )
    return str(path)


def test_two_sweeps_that_differ_in_values_compile_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = write_config(tmp_path / "a.yaml", [0.1, 0.2]), write_config(tmp_path / "b.yaml", [0.5, 0.9])
    counts = []
    for path in (first, second):
        with counting_compiles() as programs:
            output = told("sweep", path, "--set", "seed=3")
        counts.append(len(programs))
    assert counts[0] > 0 and counts[1] == 0
    assert "greedy success" in output and "runs/two-2/figures/learning_curves.png" in output
    for name in ("learning_curves", "greedy_success", "greedy_steps"):
        assert (tmp_path / f"runs/two-2/figures/{name}.png").read_bytes().startswith(b"\x89PNG")


def test_info_shows_what_a_config_will_take():
    fine = told("info", "joint1_fine", "--set", "seeds=8")
    assert "1,000 points x 8 seeds = 8,000 runs in 1 compiled program;" in fine and "joint: 1," in fine
    alone = told("info", "joint1", "--set", "sweep=null", "--set", "seeds=1")
    assert "1 point x 1 seed = 1 run in 1 compiled program;" in alone
    nowhere = told("info", "joint1", "--set", "learner.start_from=runs/nope")
    assert "sweep refuses it here: learner.start_from: runs/nope" in nowhere
    assert "joint1_fine" in told("info")


ROBOT = """<mujoco><option {option}/><worldbody><geom type="plane" size="0 0 1"/>
<body name="trunk"><freejoint/><geom size=".1" mass="3" contype="0" conaffinity="0"/>
<body name="foot"><joint name="knee" range="-90 10" limited="true" axis="0 1 0"/>
<geom type="box" size=".1 .1 .1" mass="1"/>
</body></body></worldbody><actuator><motor name="drive" joint="knee"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("option", "refusal"),
    [
        ('integrator="RK4"', None),
        ('integrator="implicit"', 'the implicit integrator; to change: integrator="implicitfast"'),
        ('cone="elliptic"', None),
        ('/><default><geom condim="6"/></default><option', "and 'foot'; to change: condim=\"3\""),
    ],
)
def test_info_shows_a_robot_and_what_a_tree_cannot_take(option, refusal, tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT.format(option=option))
    done = CliRunner().invoke(app, ["info", str(path)])
    assert done.exit_code == (2 if refusal else 0), done.output
    words = "4 kg in 2 bodies, a free base", "joints  ", "knee: hinge, -90 to 10 degrees, drive", "feet          foot:"
    at = [done.output.index(each) for each in (*words, "contacts      1 of plane and box")]
    assert at == sorted(at)
    assert (refusal or "tree takes it as it is") in done.output
    assert ("with `contacts: feet`" in done.output) == ("condim" in option)
    assert "stand and walk need" not in done.output


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is no file"),
        ("", "MuJoCo cannot read"),
        ("<mujoco/>", "has no joint, so nothing in it moves"),
        ('<mujoco><include file="gone.xml"/></mujoco>', "Error opening file 'gone.xml'"),
    ],
)
def test_info_of_no_robot_is_a_sentence(text, words, tmp_path):
    path = tmp_path / "robot.xml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=words):
        told("info", path)


def test_info_says_what_a_legged_task_needs_of_a_robot(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text('<mujoco><worldbody><body><joint type="ball"/><geom size=".1"/></body></worldbody></mujoco>')
    done = CliRunner().invoke(app, ["info", str(path)])
    assert "stand and walk need one body with a <freejoint/> and hinges that have names" in done.output
    assert "  ball joints; to change: three hinges in their place" in done.output


@pytest.mark.parametrize(("robot", "config"), [("humanoid", "walk_humanoid"), ("dog", "walk")])
def test_info_names_the_config_that_trains_a_robot(robot, config):
    assert f"training  humanoid-mjx sweep {config} --set task.robot={robot}\n" in told("info", robot)


@pytest.mark.parametrize(
    ("more", "gravcomp", "changes"),
    [
        ("mirror: {FR: FL, RR: RL}\nturns: [0, 0.5, 0.5, 0]", 0, ""),
        ("", 0, " --set task.symmetric=false"),
        ("", 1, " --set task.physics=mujoco --set task.symmetric=false"),
    ],
)
def test_the_command_that_info_names_is_taken(more, gravcomp, changes, tmp_path):
    """Without a mirror or turns, and where the tree refuses the robot."""
    text = (folder("robots") / "dog.xml").read_text()
    (tmp_path / "my dog.xml").write_text(
        text.replace('<body name="FL_calf"', f'<body gravcomp="{gravcomp}" name="FL_calf"')
    )
    feet = "[FR_foot, FL_foot, RR_foot, RL_foot]"
    path = tmp_path / "my dog.yaml"
    path.write_text(f'model: my dog.xml\nfeet: {feet}\nhome: {{".*thigh": 45, ".*calf": -90}}\n{more}\n')
    (line,) = (line for line in told("info", path).splitlines() if line.startswith("training"))
    assert line == f"training  humanoid-mjx sweep walk --set 'task.robot={path}'{changes}"
    told("info", *shlex.split(line)[3:])


def test_a_sweep_whose_reader_has_gone_trains_on(tmp_path):
    command = [sys.executable, "-m", "humanoid_mjx", "sweep", write_config(tmp_path / "a.yaml", [0.1]), "--out", "run"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b"" and process.wait() == 0
    assert (tmp_path / "run/figures/learning_curves.png").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no full device")
def test_output_that_cannot_be_written_gets_one_sentence():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "humanoid_mjx", "info"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 2
    assert done.stderr == "error: standard output: No space left on device.\n"
