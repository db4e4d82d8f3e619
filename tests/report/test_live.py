"""A robot that a person drives: what hands do to it, what is seen of it, and who may reach the server."""

import contextlib
import http.client
import json
import os
import re
import signal
import threading
import time
import urllib.error
import urllib.request
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from browser import CHROMIUM, browser

from humanoid_mjx.config import parse
from humanoid_mjx.control import at_rest
from humanoid_mjx.control.laws import ServoLaw
from humanoid_mjx.evaluation.live import SPEEDS, Grab, Live, LiveMujoco, LiveUnmodified, Stage
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, in_world
from humanoid_mjx.files import folder
from humanoid_mjx.physics import make_physics
from humanoid_mjx.report.live import Window, _scales, make_server, serve
from humanoid_mjx.robot import make_robot
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.plan import make_plan

ROBOT = make_robot("lower_body", ranges="human")
MODEL = ROBOT.model
MASS = float(MODEL.body_mass.sum())
FAST = 1000.0
"""Seconds of the robot a second: nobody waits."""


@pytest.mark.parametrize(("name", "live"), [("mujoco", LiveMujoco), ("unmodified", LiveUnmodified)])
def test_without_hands_it_is_native_mujoco(name, live):
    """The same bits after thirty steps of a body that falls from a bent posture."""
    law = ServoLaw(stiffness=20.0, damping=0.4).follow(at_rest(jnp.asarray(ROBOT.posture)))
    ends = []
    for physics in (make_physics(name, robot=ROBOT, timestep=0.004), live(robot=ROBOT, timestep=0.004)):
        if isinstance(physics, LiveMujoco):
            physics.stage.hands.pace = FAST
        world = physics.start(jnp.asarray(MODEL.qpos0).at[8].add(0.4), jnp.zeros(MODEL.nv))
        ends.append(jax.jit(lambda world, physics=physics: physics.run(world, law, 30))(world))
    assert float(jnp.abs(ends[0].qvel).max()) > 0.1
    for one, other in zip(*(jax.tree.leaves(end) for end in ends), strict=True):
        np.testing.assert_array_equal(one, other)


def test_jax_drops_no_step_and_repeats_none():
    """Two robots take two steps whose results nobody reads."""
    physics = LiveMujoco(robot=ROBOT, timestep=0.005)
    physics.stage.hands.pace = FAST
    physics.stage.fill(2)
    law = ServoLaw(stiffness=20.0, damping=0.4).follow(at_rest(jnp.asarray(ROBOT.posture)))
    world = physics.start(jnp.asarray(MODEL.qpos0), jnp.zeros(MODEL.nv))
    before = physics.stage.time
    worlds = jax.tree.map(lambda x: jnp.stack([x, x]), world)
    jax.jit(jax.vmap(lambda world: (physics.run(world, law, 2), world)[1]))(worlds)
    jax.effects_barrier()
    assert physics.stage.time - before == pytest.approx(2 * 0.005)
    assert [body.time for body in physics.stage.bodies] == pytest.approx([physics.stage.time, 2 * 0.005])


def stand(stage, seconds, qpos=None):
    """Let stiff servos hold the posture."""
    qpos = standing() if qpos is None else qpos
    qvel, warmstart, bent = np.zeros(MODEL.nv), np.zeros(MODEL.nv), ROBOT.posture
    for _ in range(round(seconds / MODEL.opt.timestep)):
        torque = 20.0 * (bent - qpos[7:]) - 0.45 * qvel[6:]
        control = np.concatenate([torque, np.zeros(MODEL.nv)])
        (qpos,), (qvel,), (warmstart,), _ = stage.advance(qpos[None], qvel[None], warmstart[None], control[None])
        model = stage.bodies[0].model
        model.pair_friction[:] = MODEL.pair_friction
        model.body_mass[:], model.body_subtreemass[:] = MODEL.body_mass, MODEL.body_subtreemass
    return qpos


def standing():
    qpos = MODEL.qpos0.copy()
    qpos[2], qpos[7:] = ROBOT.start_height, ROBOT.posture
    return qpos


@pytest.fixture
def stage():
    stage = Stage(MODEL)
    stage.hands.pace = FAST
    return stage


@pytest.mark.parametrize("pace", [0.25, 1.0, 4.0])
def test_the_pace_is_seconds_of_the_robot_a_second(pace):
    stage = Stage(MODEL)
    stage.hands.pace, began = pace, time.monotonic()
    for _ in range(round(0.5 * pace / 0.004)):
        stage.wait(0.004)
    assert time.monotonic() - began == pytest.approx(0.5, abs=0.05)


def test_the_ground_carries_robot_and_payload_on_a_slope(stage):
    """What presses the feet is the weight: straight up, whatever the ground's slope; heights count from the ground."""
    level = stand(stage, 0.5)
    stage.hands.slope, stage.hands.payload = 2.0, 0.2
    (body,), means = stage.bodies, []
    stage.shown = lambda: means.append(sum(force for _, force in body.pressing().values()))
    qpos = stand(stage, 1.5, level)
    np.testing.assert_allclose(body.ground[1:], [np.tan(np.radians(2.0)), 0.0], atol=0.01)  # it looks along x
    np.testing.assert_allclose(np.mean(means[-20:], axis=0), [0.0, 0.0, 9.81 * (MASS + 0.2)], atol=0.2)
    assert qpos[2] == pytest.approx(level[2], abs=0.01)
    body.forget()
    assert not body.ground.any() and not body.model.geom_pos[body.planes].any()


def test_a_shove_is_an_impulse_and_a_pull_draws_its_point(stage):
    """In the air: momentum per mass; and the torso goes to where it is drawn."""
    (body,) = stage.bodies
    body.model.opt.gravity[:] = 0.0
    high = standing()
    high[2] += 1.0
    body.shoves.append(np.array([0.0, 0.3, 0.0]))
    assert body.shoved is None
    stand(stage, 0.2, high)
    np.testing.assert_allclose(body.shoved, [0.0, 0.3, 0.0])  # it is seen for longer than it lasts
    mujoco.mj_subtreeVel(body.model, body.data)  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(body.data.subtree_linvel[0] * MASS, [0.0, 0.3, 0.0], atol=0.01)
    body.model.opt.gravity[:] = MODEL.opt.gravity
    body.grab = Grab(1, np.zeros(3), np.array([0.0, 0.0, standing()[2] + 0.1]))
    hangs = standing()[2] + 0.1 - 0.2 * MODEL.stat.extent  # a spring that its weight draws out by a fifth of the extent
    assert stand(stage, 1.0)[2] == pytest.approx(hangs, abs=0.01)


class Running:
    """A live robot and its server, each in a thread."""

    def __init__(self, live):
        self.live, self.server = live, make_server(live)
        self.port = self.server.server_address[1]
        self.threads = [threading.Thread(target=run, daemon=True) for run in (live.run, self.server.serve_forever)]
        for thread in self.threads:
            thread.start()

    def ask(self, method, path, body=None, **headers):
        """Status and content of one answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=300)
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        text = body if body is None or isinstance(body, bytes) else json.dumps(body)
        connection.request(method, path, text, given)
        answer = connection.getresponse()
        content = answer.readline() if path == "/frames" and answer.status == 200 else answer.read()
        connection.close()
        return answer.status, content

    def tell(self, message):
        return self.ask("POST", "/hands", message, Content_Type="application/json")[0]

    def state(self):
        """What messages can change."""
        live, hands = self.live, self.live.stage.hands
        grabs = [body.grab for body in live.stage.bodies]
        return dict(live.told), replace(hands), grabs, live.going.is_set(), live.episodes.tolist()

    def until(self, true):
        latest = time.monotonic() + 600
        while not true():
            assert time.monotonic() < latest, "it did not come"
            time.sleep(0.02)

    def end(self):
        self.live.stop()
        self.threads[0].join(60)
        self.server.shutdown()
        self.server.server_close()


def rests(read):
    """True if what is read is the same 0.2 s later."""
    before = read()
    time.sleep(0.2)
    return read() == before


@pytest.fixture(scope="module")
def walking():
    running = Running(Live(find_policy("walk")))
    running.until(lambda: running.server.shown.frame["charts"]["reward of a decision"])  # a decision was shown
    yield running
    running.end()


def test_it_walks_as_the_browser_says(walking):
    live = walking.live
    assert walking.tell({"pace": 0.5}) == 204 and live.stage.hands.pace == 0.5
    live.stage.hands.pace = 10.0
    assert walking.tell({"told": {"forward, m/s": 0.4}, "friction": 9.0, "payload": 0.1}) == 204
    assert (live.stage.hands.friction, live.stage.hands.payload) == (2.0, 0.1)  # within the slider's range
    walking.until(lambda: live.stage.bodies[0].speeds[0] > 0.25)
    assert walking.tell({"told": dict.fromkeys(SPEEDS, 0.0), "friction": 1.0, "payload": 0.0}) == 204
    walking.until(lambda: abs(live.stage.bodies[0].speeds[0]) < 0.1)
    assert walking.tell({"told": {"forward, m/s": 99.0}}) == 204 and live.told["forward, m/s"] == pytest.approx(0.8)
    before = live.episodes[0]
    assert walking.tell({"told": {"forward, m/s": 0.0}, "episode": 3}) == 204
    walking.until(lambda: live.episodes[0] >= before + 3 and not live.again.is_set())  # one may end meanwhile
    assert walking.tell({"paused": True}) == 204
    walking.until(lambda: rests(lambda: live.stage.time))
    before = live.stage.time
    assert walking.tell({"paused": False}) == 204
    walking.until(lambda: live.stage.time > before)
    live.stage.hands.pace = 1.0


@pytest.mark.parametrize("name", ["stand", "walk", "walk_sturdy", "walk_dog", "walk_humanoid"])
def test_the_first_push_is_one_of_the_training(name):
    live = Live(find_policy(name))
    push, task = _scales(live)["push"], live.trained.learner.task
    largest = float(task.push.impulse) * task.robot.momentum
    least = float(task.push.least) * largest
    assert least * 0.97 <= push.now <= 1.03 * (largest + least) / 2 and largest <= 1.03 * push.high


def test_a_policy_that_was_trained_without_pushes_gets_a_gentle_one():
    live = Live(in_world(find_policy("walk"), None, ["task.push.impulse=0"]))
    assert 0.0 < _scales(live)["push"].now < 0.1


@pytest.fixture
def beside():
    """Make robots side by side, at ten times real time: dogs, as the lower body has a stage, where it walks alone."""
    made = []

    def make(robots, **more):
        made.append(Running(Live(find_policy("walk_dog"), robots=robots, **more)))
        made[0].live.stage.hands.pace = 10.0
        made[0].until(lambda: not made[0].live.words)
        return made[0]

    yield make
    made[0].end()


def test_several_robots_stand_side_by_side(beside):
    """Each in an episode of its own, under one command, on one slope: pushed together and pulled alone."""
    running = beside(3, episode=2)
    bodies, window = running.live.stage.bodies, Window(running.live)
    assert running.tell({"told": {"forward, m/s": 0.6}, "slope": 1.0}) == 204
    running.until(lambda: min(body.speeds[0] for body in bodies) > 0.3)
    frame, count = window._frame(), len(window.geoms)
    assert frame["episodes"] == [2, 3, 4] and len(frame["shapes"]) == 3 * count and len(frame["torsos"]) == 3
    assert set(frame["charts"]["forward, m/s"]) == {"commanded", "robot 1", "robot 2", "robot 3"}
    assert len({body.speeds[0] for body in bodies}) == 3
    running.end()
    frame, views = window._frame(), window.views()
    for body, view, centre in zip(bodies, views, frame["centres"], strict=True):
        masses = body.model.body_mass
        np.testing.assert_allclose(view.back(np.array(centre)), masses @ body.data.xipos / masses.sum(), atol=2e-4)
    for body, view, torso in zip(bodies, views, frame["torsos"], strict=True):
        np.testing.assert_allclose(view.back(np.array(torso)), body.data.xpos[1], atol=2e-4)
        np.testing.assert_allclose(view.turn[:2, :2] @ body.heading, [1.0, 0.0], atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(body.ground[1:]), np.tan(np.radians(1.0)), rtol=1e-3)
        above = torso[2] - np.array(frame["ground"]) @ [1.0, *torso[:2]]
        assert above == pytest.approx(body.data.xpos[1][2] - body.height(body.data.xpos[1]), abs=1e-3)
    assert np.ptp([torso[0] for torso in frame["torsos"]]) < 0.3  # they go side by side
    window.take({"push": 0.3})
    assert [len(body.shoves) for body in bodies] == [1, 1, 1]
    at = window._frame()["shapes"][count][:3]  # of the second torso
    window.take({"grab": {"shape": count, "point": at, "to": at}})
    assert [body.grab is None for body in bodies] == [True, False, True]
    point = bodies[1].data.xmat[1].reshape(3, 3) @ bodies[1].grab.point + bodies[1].data.xpos[1]
    np.testing.assert_allclose(views[1].at(point), at, atol=1e-3)
    np.testing.assert_allclose(bodies[1].grab.to, point, atol=1e-3)


def test_a_robot_that_fell_rests_while_the_others_go_on(beside):
    running = beside(3)  # as in the test before: one program
    live, (first, second, _) = running.live, running.live.stage.bodies
    while first.ended is None:
        first.shoves[:] = [3.0 * float(live.model.body_mass.sum()) * np.array([0.0, 1.0, 0.0])]
        time.sleep(0.01)
    assert live.words.startswith("Robot 1 fell") and second.ended is None
    lies, walked = first.data.qpos.copy(), second.time
    running.until(lambda: second.time > walked + 0.5)
    assert first.ended is None or np.array_equal(first.data.qpos, lies)
    running.until(lambda: first.ended is None)
    assert live.episodes.tolist() == [3, 1, 2] and second.time > walked + 1.0


@pytest.fixture(scope="module", params=[None, "unmodified"])
def posed(request, tmp_path_factory):
    """A dog that nobody trained: its shanks and an unseen guard of a thigh touch, and a hip turns without end."""
    path, robots = tmp_path_factory.mktemp("posed"), folder("robots")
    text = (robots / "dog.xml").read_text()
    shank, touch = '<geom type="capsule" fromto="0 0 0 0 0 -0.213" size="0.012"', 'contype="1" conaffinity="1"'
    guard = f'<geom type="sphere" size="0.03" pos="0 0 -0.1" group="3" mass="0" {touch}/>'
    for old, new in (
        (shank, f"{shank} {touch}"),
        ('<joint name="FR_thigh"', f'{guard}<joint name="FR_thigh"'),
        ('<joint name="FR_hip"', '<joint name="FR_hip" limited="false"'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (path / "dog.xml").write_text(text)
    (path / "pet.yaml").write_text((robots / "dog.yaml").read_text() + "contacts: model\n")
    running = Running(Live(in_world(find_policy(path / "pet.yaml"), request.param)))
    running.live.stage.hands.pace = 10.0
    running.until(lambda: not running.live.words)
    yield running
    running.end()


def test_a_slider_moves_the_set_point_of_its_joint(posed):
    """The servo's law gives back the set-points at rest, and the joints follow but for the sag under the weight."""
    live, robot, (body,) = posed.live, posed.live.task.robot, posed.live.stage.bodies
    joints = live.model.actuator_trnid[:, 0]
    places, dofs = live.model.jnt_qposadr[joints], live.model.jnt_dofadr[joints]

    def settles(wanted):
        def true():
            torque, angles = body.data.qfrc_actuator[dofs], np.degrees(body.data.qpos[places])
            aims = angles + np.degrees((torque + robot.servo.damping * body.data.qvel[dofs]) / robot.servo.stiffness)
            return np.abs(aims - list(wanted.values())).max() < 0.3 and np.abs(angles - aims).max() < 8.0

        posed.until(true)

    home = dict(zip(robot.joints, robot.home, strict=True))
    assert live.told == pytest.approx(home)
    settles(home)
    told = {"FR_thigh": 55.0, "RL_hip": -4.0}
    assert posed.tell({"told": told}) == 204
    settles(home | told)
    # A robot may crouch until its hips are lower than those of one that has fallen.
    crouch = {name: {"thigh": 73.0, "calf": -140.0}.get(name[3:], 0.0) for name in robot.joints}
    assert posed.tell({"told": crouch}) == 204
    settles(crouch)
    assert body.data.xpos[1, 2] < 0.6 * robot.start_height and body.ended is None
    assert posed.tell({"told": home}) == posed.tell({"paused": True}) == 204
    assert posed.tell({"told": {"FR_calf": 1e9, "FL_thigh": -1e9}}) == 204
    assert live.told == pytest.approx(home | {"FR_calf": np.degrees(-0.888), "FL_thigh": np.degrees(-0.686)})
    assert live.ranges["FR_hip"] == (-180.0, 180.0)
    before = dict(live.told)
    for wrong in ({"FL_wing": 1.0}, {"FR_hip": "1"}, {"FR_hip": None}, {"FR_hip": float("nan")}, {"FR_hip": [1]}, [1]):
        assert posed.tell({"told": wrong}) == 400 and live.told == before
    assert posed.tell({"told": home}) == posed.tell({"paused": False}) == 204
    settles(home)


def test_the_page_has_all_shapes_that_touch(posed):
    """Feet, shanks and the guard; hidden are those of the groups that a viewer hides."""
    window = posed.server.shown
    model, data = window.scene.model, re.search(rb'"application/json">(.*?)</script>', window.page())
    shapes = json.loads(data[1])["shapes"]
    assert len(shapes) == len(window.now()["shapes"]) == len(window.geoms)
    bodies = [model.body(model.geom_bodyid[geom]).name for geom in window.geoms]
    touching = [(body, shape["kind"]) for body, shape in zip(bodies, shapes, strict=True) if shape["touches"]]
    calves = [f"{leg}_calf" for leg in ("FR", "FL", "RR", "RL")]
    wanted = [("FR_thigh", "sphere"), *((calf, kind) for calf in calves for kind in ("capsule", "sphere"))]
    assert sorted(touching) == sorted(wanted)
    assert [shape["hidden"] for shape in shapes] == (model.geom_group[window.geoms] > 2).tolist()
    assert all(shape["touches"] for shape in shapes if shape["hidden"])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_a_robot_is_posed_in_the_browser(posed):
    """Sliders, the key for the home posture, and the switch of the shapes that touch: nothing else is orange."""
    live, player = posed.live, "document.querySelector('figure').player"
    orange = (
        "(() => { const c = document.querySelector('canvas');"
        "const p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;"
        "for (let i = 0; i < p.length; i += 4) n += p[i] > 1.2 * p[i + 1] && p[i + 1] > 1.2 * p[i + 2]; return n; })()"
    )
    with browser() as opened:
        opened.open(f"http://127.0.0.1:{posed.port}/", 1280, 800)
        opened.value(f"(() => {{ const {{ input }} = {player}.sliders.FR_thigh; input.value = 50;"
                     "input.dispatchEvent(new Event('input')); })()")  # fmt: skip
        posed.until(lambda: live.told["FR_thigh"] == pytest.approx(50.0))
        assert opened.value("document.querySelectorAll('.joints input').length") == 12
        opened.press(" ")
        posed.until(lambda: live.told == pytest.approx(live.home))
        assert opened.value(f"{player}.sliders.FR_thigh.input.value") == "48"
        posed.until(lambda: opened.value(orange) == 0)
        opened.press("c")
        posed.until(lambda: opened.value(orange) > 300)
        assert opened.value("document.querySelectorAll('[aria-pressed=true]').length") == 1
        opened.press("c")
        posed.until(lambda: opened.value(orange) == 0)
        opened.size(390, 844)
        assert opened.value("document.documentElement.scrollWidth") <= 390
        assert opened.faults == []


def test_frames_say_what_there_is_to_see(walking):
    status, line = walking.ask("GET", "/frames")
    frame = json.loads(line.removeprefix(b"data: "))
    assert status == 200 and set(frame["charts"]) >= {*SPEEDS, "load on a foot, N", "torque, N m"}
    assert set(frame["charts"]["forward, m/s"]) == {"commanded", "measured"}
    assert len(frame["charts"]["reward of a decision"]) > 1 and "reward" in frame["charts"]["reward of a decision"]
    np.testing.assert_allclose([np.linalg.norm(pose[3:]) for pose in frame["shapes"]], 1.0, atol=1e-3)
    assert len(frame["axes"]) == walking.live.model.nu
    np.testing.assert_allclose([np.linalg.norm(axis[3:]) for axis in frame["axes"]], 1.0, atol=2e-3)


class Gate(threading.Event):
    """An event that says whether a thread waits for it."""

    waits = False

    def wait(self, timeout=None):
        self.waits = not self.is_set()
        super().wait(timeout)
        self.waits = False


def test_a_step_is_one_decision(walking, monkeypatch):
    """A robot that waits moves on by one decision and waits again, and the page shows where it is then."""
    live, gate = walking.live, Gate()
    gate.set()
    monkeypatch.setattr(live, "going", gate)
    walking.tell({"paused": True})
    walking.until(lambda: gate.waits)
    for _ in range(3):
        before = live.stage.time
        walking.tell({"once": True})
        walking.until(lambda before=before: live.stage.time > before and gate.waits)
        assert live.stage.time == pytest.approx(before + live.task.period)
        assert walking.server.shown.now()["time"] == pytest.approx(live.stage.time, abs=1e-3)
    walking.tell({"paused": False})
    walking.until(lambda: live.stage.time > before + 5 * live.task.period)


def test_only_pages_of_its_own_reach_the_server(walking):
    own = f"127.0.0.1:{walking.port}"
    assert walking.ask("GET", "/")[0] == walking.ask("GET", "/?a=1", Host=f"localhost:{walking.port}")[0] == 200
    assert walking.ask("HEAD", "/") == (200, b"")
    for path in ("/", "/frames", "/hands"):
        assert walking.ask("GET", path, Host="evil.example")[0] == 403
    assert walking.ask("GET", "/config.yaml")[0] == walking.ask("GET", "/../setup.py")[0] == 404
    json_type = {"Content_Type": "application/json"}
    assert walking.ask("POST", "/hands", {}, **json_type, Origin=f"http://{own}")[0] == 204
    assert walking.ask("POST", "/hands", {}, **json_type, Origin="http://evil.example")[0] == 403
    assert walking.ask("POST", "/hands", {}, **json_type, Host="evil.example")[0] == 403
    # What a form of another site can send.
    assert walking.ask("POST", "/hands", {}, Content_Type="text/plain")[0] == 403
    assert walking.ask("POST", "/hands", "x" * 20_000, **json_type)[0] == 404


@pytest.mark.parametrize(
    "message",
    [
        *(1, [], {"told": {"up, m/s": 1.0}}, {"told": 3}, {"slope": "steep"}, {"payload": float("nan")}, {"grab": {}}),
        *({"grab": {"shape": 999, "point": [0, 0, 0], "to": [0, 0, 0]}}, {"push": None}, {"episode": []}),
        *({"grab": {"shape": -1, "point": [0, 0, 0], "to": [0, 0, 0]}}, {"up": 1.0}, {"episode": 1.5}),
        *(
            {"told": {"forward, m/s": 0.5}, "slope": 3.0, "push": None},
            {"grab": {"to": [0, 0]}},
            {"paused": 1},
            {"once": 1},
        ),
    ],
)
def test_messages_that_mean_nothing_change_nothing(walking, message):
    before = walking.state()
    assert walking.tell(message) == 400
    assert walking.state() == before


VALUES = {
    *("null", "true", '"1"', '"x"', "[]", "[1]", "{}", '{"to": 1}', "1e400", "-1e400", "NaN", "[" * 9000),
    *(
        '{"a":' * 1500,
        f"{10**23}",
        f"-1{'0' * 400}",
        "1" * 9000,
        "[0, 0, 1e400]",
        '[0, 0, "1"]',
        "[0, 0, 0, 0]",
        "\udcff",
    ),
}
FIELDS = {
    *('{"told": %s}', '{"told": {"forward, m/s": %s}}', '{"push": %s}', '{"payload": %s}', '{"slope": %s}'),
    *('{"friction": %s}', '{"pace": %s}', '{"paused": %s}', '{"episode": %s}', '{"grab": %s}', '{"grab": {"to": %s}}'),
    *('{"grab": {"to": [0, 0, %s]}}', '{"grab": {"shape": %s, "point": [0, 0, 0], "to": [0, 0, 0]}}', "%s"),
    *('{"grab": {"shape": 0, "point": %s, "to": [0, 0, 0]}}', '{"grab": {"shape": 0, "point": [%s, 0, 0], "to": 1}}'),
    *('{"up": %s}', "{%s: 1}"),
}
MEANINGFUL = {
    '{"grab": {"shape": true, "point": [0, 0, 0], "to": [0, 0, 0]}}',
    '{"told": {}}',
    '{"paused": true}',
    '{"grab": null}',
    "{}",
} | {
    field % 10**23
    for field in FIELDS
    if "shape" not in field and re.search(r'(m/s|push|payload|slope|friction|pace|0)"?[:,] %s', field)
}
"""Messages among these that can be done, as numbers outside a range count as its end."""


def test_wrong_values_of_all_fields_are_refused_in_silence(walking, capfd):
    assert walking.tell({"paused": True}) == 204  # else episodes may end meanwhile
    before = walking.state()
    for field in FIELDS:
        for value in VALUES:
            text = field % value
            wanted = 204 if text in MEANINGFUL else 400
            body = text.encode(errors="surrogateescape")
            assert walking.ask("POST", "/hands", body, Content_Type="application/json")[0] == wanted, text[:200]
            assert wanted == 204 or walking.state() == before, text[:200]
            walking.live.told.update(before[0])
            walking.live.stage.bodies[0].grab = None
            walking.live.stage.hands.__dict__.update(vars(before[1]))
    walking.live.stage.bodies[0].shoves.clear()
    assert walking.tell({"paused": False}) == 204
    walking.until(lambda: not rests(lambda: walking.live.stage.time))
    assert capfd.readouterr().err == ""


def test_a_port_that_is_taken(walking):
    with pytest.raises(InputError, match=f"--port {walking.port}: "):
        make_server(walking.live, walking.port)


def test_ctrl_c_ends_it_in_silence(monkeypatch):
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    live, told = Live(find_policy("posture_switch")), []

    def interrupt():
        while not live.ready or live.stage.time < 0.1:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    serve(live, told.append)  # returns
    assert told[0].startswith("http://127.0.0.1:") and live.stage.time >= 0.1


def browsed(monkeypatch, browse, others):
    """Show `posture_switch` while `browse(address)` goes on in a thread."""
    monkeypatch.setattr("webbrowser.open", lambda address: True)

    def until_done(address):
        try:
            browse(address)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    def told(words):
        threading.Thread(target=until_done, args=(words.split()[0],), daemon=True).start()

    serve(Live(find_policy("posture_switch")), told, others=others)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_a_page_that_is_open_shows_the_policy_that_it_chooses(monkeypatch):
    seen, place = [], "document.querySelector('select[aria-label=Policy]')"

    def browse(address):
        with browser() as opened:
            opened.open(address, 1280, 800)
            seen.append(opened.value(f"{place}.textContent"))
            opened.value(f"(() => {{ {place}.value = 'walk_dog'; {place}.dispatchEvent(new Event('change')); }})()")
            end = time.monotonic() + 300
            shown = "(({ data, latest }) => latest.compiling === null && data.live.policy)"
            while opened.value(f"{shown}(document.querySelector('figure').player)") != "walk_dog":
                assert time.monotonic() < end
                time.sleep(0.1)
            seen.append(opened.value(f"{place}.value"))
            seen.append(opened.faults)

    browsed(
        monkeypatch, browse, {name: lambda: Live(find_policy("walk_dog")) for name in ("posture_switch", "walk_dog")}
    )
    assert seen == ["posture_switchwalk_dog", "walk_dog", []]


def test_another_policy_is_chosen_in_the_page(monkeypatch):
    """The browser gets another robot, or why there is none, at the address that it has."""
    seen = []

    def absent():
        raise InputError("walk_cat: its package is missing.")

    def ask(address, message):
        request = urllib.request.Request(address + "hands", json.dumps(message).encode())
        request.add_header("Content-Type", "application/json")
        with contextlib.suppress(urllib.error.HTTPError):
            return urllib.request.urlopen(request, timeout=60).status
        return 400

    def shown(address, true):
        """The first frame that is so."""
        with urllib.request.urlopen(address + "frames", timeout=300) as stream:
            for line in stream:
                if line.startswith(b"data: ") and true(frame := json.loads(line[6:])):
                    return frame
        raise AssertionError("the stream ended")

    def browse(address):
        begun = shown(address, lambda frame: frame["compiling"] is None)
        seen.append(begun["policy"])
        seen.append(ask(address, {"policy": "walk_horse"}))
        seen.append(ask(address, {"policy": "walk_cat"}))
        told = shown(address, lambda frame: "walk_cat: " in frame["words"] and frame["time"] > begun["time"] + 0.2)
        seen.append((told["policy"], told["words"]))
        ask(address, {"policy": "walk_dog"})
        stands = shown(address, lambda frame: frame["policy"] == "walk_dog" and frame["compiling"] is None)
        seen.append((stands["words"], len(stands["shapes"]) != len(begun["shapes"])))
        page = urllib.request.urlopen(address, timeout=60).read().decode()
        seen.append(bool(re.search('"policy": ?"walk_dog"', page)))

    walk_dog = lambda: Live(find_policy("walk_dog"))  # noqa: E731
    browsed(monkeypatch, browse, {"posture_switch": absent, "walk_cat": absent, "walk_dog": walk_dog})
    assert seen[:3] == ["posture_switch", 400, 204]
    assert seen[3:] == [("posture_switch", "walk_cat: its package is missing."), ("", True), True]


def test_a_robot_with_a_physics_of_its_own_is_seen_but_not_touched():
    """`sway` brings its physics, and its robot hangs: no sliders, no hands; its episodes follow one another."""
    make_physics("mujoco", robot="legs", timestep=0.02).model  # noqa: B018
    config = parse({"name": "own", "task": {"name": "sway:Sway"}, "learner": {"name": "deep_q", "width": 8}}, "here")
    learner = make_plan(config).groups[0].learner()
    key = jax.random.key(0)
    policy = jax.jit(lambda learner: learner.policy(learner.init(key)))(learner)
    live = Live(StoredPolicy(learner, policy, 0, 0, "own", config, {}))
    live.stage.hands.pace = FAST
    window = Window(live)
    assert not (live.touchable or live.ranges or window.scales)
    thread = threading.Thread(target=live.run, daemon=True)
    thread.start()
    end = time.monotonic() + 600
    while live.episodes[0] < 1 and time.monotonic() < end:
        time.sleep(0.02)
    live.stop()
    thread.join(20)
    frame = window.now()
    assert live.episodes[0] >= 1 and window.number > 5 and "torque, N m" not in frame["charts"]
    assert len(frame["shapes"]) == len(window.geoms)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_keys_and_mouse_drive_it(walking):
    """In a browser: keys steer while they are down, the mouse pulls the robot, turns, moves and zooms the view."""
    live = walking.live

    def key(opened, kind, name):
        opened.ask("Input.dispatchKeyEvent", type=kind, key=name, text=name if kind == "keyDown" else "")

    def mouse(opened, kind, x, y, button="left", **more):
        opened.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, clickCount=1, **more)

    with browser() as opened:
        opened.open(f"http://127.0.0.1:{walking.port}/", 1280, 800)
        walking.until(lambda: int(opened.value("document.querySelector('canvas').dataset.pictures")) > 3)
        opened.value("document.body.focus()")
        for name, part, share in (("w", 0, 0.8), ("a", 1, 0.15), ("q", 2, 1.0), ("e", 2, -1.0)):
            key(opened, "keyDown", name)
            walking.until(lambda part=part, share=share: live.told[SPEEDS[part]] == pytest.approx(0.6 * share))
            key(opened, "keyUp", name)
            walking.until(lambda part=part: live.told[SPEEDS[part]] == 0.0)
        opened.value("document.querySelector('.panel input').value = 0.3;"
                     "document.querySelector('.panel input').dispatchEvent(new Event('input'))")  # fmt: skip
        walking.until(lambda: live.told[SPEEDS[0]] == pytest.approx(0.3, abs=0.011))
        key(opened, "keyDown", " ")
        walking.until(lambda: live.told[SPEEDS[0]] == 0.0)
        opened.value(
            "window.pad = {axes: [0.5, -1, -0.5], buttons: Array.from({length: 10}, (_, i) => ({pressed: i === 9}))};"
            "navigator.getGamepads = () => [null, pad]"
        )
        # A browser shows a gamepad as soon as one of its buttons is pressed: here that which pauses.
        walking.until(lambda: [live.told[name] for name in SPEEDS] == pytest.approx([0.8, -0.075, 0.5]))
        walking.until(lambda: not live.going.is_set())
        opened.value("pad.axes = [0.1, 0, 0]; pad.buttons[9].pressed = false")  # sticks do not quite return
        walking.until(lambda: not any(live.told.values()))
        opened.value("navigator.getGamepads = () => []")
        key(opened, "keyDown", "p")
        walking.until(live.going.is_set)
        key(opened, "keyDown", "p")  # so that nothing moves below the mouse
        walking.until(lambda: not live.going.is_set())
        walking.until(lambda: rests(lambda: opened.value("document.querySelector('figure').player.latest.shapes")))
        player, before = "document.querySelector('figure').player", live.stage.time
        opened.press(".")
        walking.until(lambda: rests(lambda: live.stage.time) and live.stage.time > before)
        walking.until(lambda: float(opened.value("document.querySelector('canvas').dataset.time")) > before)
        opened.press("j")
        assert opened.value(f"{player}.turning && {player}.pose().arrows.length") >= live.model.nu
        opened.press("2")
        assert opened.value(f"{player}.view.yaw") == pytest.approx(np.pi)
        opened.press("1")
        opened.value(
            "(() => { const stick = document.querySelector('.stick'); stick.style.display = 'grid';"
            "stick.hasPointerCapture = () => true; const { left, top, width } = stick.getBoundingClientRect();"
            "stick.onpointermove({ type: 'pointermove', clientX: left, clientY: top + width / 2 }); })()"
        )
        walking.until(lambda: [live.told[name] for name in SPEEDS] == pytest.approx([0.0, 0.0, 1.0]))
        opened.value("document.querySelector('.stick').onpointerup()")
        walking.until(lambda: not any(live.told.values()))
        left, top = opened.value(
            "(() => { const b = document.querySelector('canvas').getBoundingClientRect(); return [b.left, b.top]; })()"
        )
        view = "JSON.stringify(document.querySelector('figure').player.view)"
        first = json.loads(opened.value(view))
        # The torso: of the robot's shapes the first.
        x, y = opened.value(
            "(() => { const p = document.querySelector('figure').player, c = p.canvas.getBoundingClientRect();"
            "const [x, y] = p.camera.see(p.latest.shapes[0].slice(0, 3)), r = p.canvas.width / c.width;"
            "return [c.left + x / r, c.top + y / r]; })()"
        )
        mouse(opened, "mousePressed", x, y)
        mouse(opened, "mouseMoved", x + 20, y - 10, buttons=1)
        walking.until(lambda: live.stage.bodies[0].grab is not None)
        mouse(opened, "mouseReleased", x + 20, y - 10)
        walking.until(lambda: live.stage.bodies[0].grab is None)
        assert json.loads(opened.value(view)) == first
        corner = left + 20, top + 20
        mouse(opened, "mousePressed", *corner)
        mouse(opened, "mouseMoved", corner[0] + 30, corner[1], buttons=1)
        mouse(opened, "mouseReleased", corner[0] + 30, corner[1])
        turned = json.loads(opened.value(view))
        assert turned["yaw"] == pytest.approx(first["yaw"] - 0.2) and turned["pan"] == first["pan"]
        mouse(opened, "mousePressed", *corner, button="right")
        mouse(opened, "mouseMoved", corner[0] + 30, corner[1], button="right", buttons=2)
        mouse(opened, "mouseReleased", corner[0] + 30, corner[1], button="right")
        moved = json.loads(opened.value(view))
        assert moved["yaw"] == turned["yaw"] and np.linalg.norm(moved["pan"]) > 0.01
        mouse(opened, "mouseWheel", *corner, button="none", deltaX=0, deltaY=-120)
        assert json.loads(opened.value(view))["zoom"] == pytest.approx(np.exp(-0.2))
        key(opened, "keyDown", "p")
        walking.until(live.going.is_set)
        opened.value("URL.createObjectURL = (film) => { window.film = [film.type, film.size]; return '#'; }")
        record, pictures = (
            "document.querySelector('figure').player.record()",
            "document.querySelector('canvas').dataset.pictures",
        )

        def records():
            opened.value(record)
            before = int(opened.value(pictures))
            walking.until(lambda: int(opened.value(pictures)) > before + 20)
            opened.value(record)
            walking.until(lambda: opened.value("window.film"))
            kind, size = opened.value("film")
            return kind.startswith("video/") and size > 1000

        walking.until(records)  # on a busy machine the recorder may begin late
        opened.size(390, 844)
        assert opened.value("document.documentElement.scrollWidth") <= 390
        assert opened.faults == []


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")
def test_the_page_says_what_happens(walking):
    """How fast the robot runs, which keys do nothing, what the world is; Restart sets it back; a key pushes once."""
    live, hands = walking.live, walking.live.stage.hands
    player = "document.querySelector('figure').player"

    def text(opened, place):
        return opened.value(f"document.querySelector('{place}').textContent")

    def slide(opened, name, value):
        opened.value(
            f"(() => {{ const input = {player}.sliders['{name}'].input; input.value = {value};"
            "input.dispatchEvent(new Event('input')); })()"
        )

    def legend(opened):
        words = opened.value(f"{player}.charts.get('joint angle, degrees').legend.textContent")
        return re.findall("[a-z_]+", words)

    with browser() as opened:
        opened.open(f"http://127.0.0.1:{walking.port}/", 1280, 800)
        walking.until(lambda: re.search(r"episode \d+, [\d.]+ s, \d\.\d\d . real time", text(opened, ".told")))
        assert "W A D or arrows: go." in text(opened, ".hint")
        opened.press("s")
        walking.until(lambda: "forward, m/s is from 0 to 0.8." in text(opened, "[role=status]"))
        slide(opened, "slope", 1.0)
        slide(opened, "friction", 0.9)
        slide(opened, "forward, m/s", 0.304)  # a step of the slider
        walking.until(lambda: (hands.slope, hands.friction, live.told[SPEEDS[0]]) == pytest.approx((1.0, 0.9, 0.304)))
        walking.until(lambda: opened.value(f"{player}.latest.world.slope") == 1.0)
        opened.open(f"http://127.0.0.1:{walking.port}/", 1280, 800)
        assert opened.value(f"{player}.sliders.slope.input.value") == "1"  # as the world is, not as it was at first
        opened.press("r")
        walking.until(lambda: (hands.slope, hands.friction, hands.payload, *live.told.values()) == (0, 1, 0, 0, 0, 0))
        assert opened.value(f"[{player}.sliders.slope.input.value, {player}.sliders.friction.input.value]") == [
            "0",
            "1",
        ]
        opened.value(f"{player}.send = (message) => (window.sent = window.sent || []).push(message)")
        for repeats in (False, True, True):
            opened.ask("Input.dispatchKeyEvent", type="keyDown", key="x", text="x", autoRepeat=repeats)
        assert len(opened.value("sent")) == 1
        opened.value("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        walking.until(lambda: len(legend(opened)) == 10)
        opened.value(f"{player}.charts.get('joint angle, degrees').choice.selectedIndex = 1")  # of the first leg
        walking.until(lambda: legend(opened) == opened.value(f"{player}.data.legs['leg of right_foot']"))
        live.stage.bodies[0].shoves[:] = [np.array([0.0, 3.0 * MASS, 0.0])]
        walking.until(lambda: text(opened, "[role=status]") == "The robot fell; the next episode follows.")
        forward = f"{player}.charts.get('forward, m/s').legend.textContent"
        walking.until(lambda: opened.value(forward) == "commanded 0.00measured –")  # noqa: RUF001
        assert opened.faults == []
