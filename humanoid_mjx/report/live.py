"""A live robot in the browser of this machine: one page, the frames that it draws, and what it sends back."""

import json
import math
import random
import signal
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.live import SPEEDS, Grab, Live
from humanoid_mjx.report.scene import make_scene, player, posed, poses, rounded, scene_data, shape_of
from humanoid_mjx.report.server import LOOPBACK, Server
from humanoid_mjx.report.web import page
from humanoid_mjx.robot.description import below, two_digits
from humanoid_mjx.robot.touching import pairs_of
from humanoid_mjx.spec import InputError
from humanoid_mjx.tasks.legged.events import Push

SLOPE, FRICTION, PAYLOAD, PUSH = 10.0, 2.0, 0.5, 0.2
"""Largest slope, degrees; friction, as a factor; payload, as a share of the robot's mass; and impulse of a key's push,
as a share of the robot's momentum at the speed sqrt(gravity * extent). Pushes of the training are possible anyhow."""

GENTLE = 0.15
"""First impulse of a key's push for a policy that was trained with none, as a share of the largest."""

SLOWEST = 0.05
"""Least seconds of the robot a second."""

BESIDE = 1.0
"""Distance at which several robots are drawn beside each other, as a share of the robot's extent."""

NOTE_S = 15.0
"""Time for which the page says why it has no other policy, s."""

LAST_EPISODE = 10**6
"""Largest number of an episode, as of `play --episode`."""


def serve(
    live: Live, told: Callable[[str], None], *, port: int = 0, others: Mapping[str, Callable[[], Live]] = {}
) -> None:
    """Show a live robot in the browser until Ctrl-C, from a server that only this machine can reach.

    Args:
      told: called with the address, once it answers.
      port: of the server; 0: any that is free.
      others: what makes the robots of each policy that the page offers, first that of `live`.

    Raises:
      InputError: the port is taken.
    """

    over = threading.Event()

    def end(*_: Any) -> None:
        over.set()
        if not server.shown.live.ready:
            raise KeyboardInterrupt
        server.shown.live.stop()  # an exception would arise within a step of the physics, of which jax makes a failure

    with make_server(live, port, tuple(others)) as server:
        address = f"http://{LOOPBACK}:{server.server_address[1]}/"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        told(f"{address}  (Ctrl-C ends it)")
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        before = signal.signal(signal.SIGINT, end)
        try:
            live.run()
            while not over.is_set() and (wanted := server.shown.wanted) is not None:
                server.shown = server.shown.followed(wanted, others[wanted])
                if not over.is_set():
                    server.shown.live.run()
        finally:
            signal.signal(signal.SIGINT, before)


def make_server(live: Live, port: int = 0, policies: Sequence[str] = ()) -> Server:
    """The server of a live robot on the loopback interface, which answers once it is let run; raises as `serve`.
    `policies`: those that the page offers, of which the first is the robot's."""
    try:
        server = Server(port)
    except OSError as error:
        raise InputError(f"--port {port}: {error.strerror}; without --port a free one is taken.") from error
    server.shown = Window(live, policies, *policies[:1])
    return server


class Scale(NamedTuple):
    """A slider for what a person may change."""

    low: float
    high: float
    now: float
    words: str


class Seen(NamedTuple):
    """A robot's world as the picture shows it: turned about the vertical, then shifted."""

    turn: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    def at(self, places: Float[np.ndarray, "*places 3"]) -> Float[np.ndarray, "*places 3"]:
        """Return places of the robot's world in the picture."""
        return places @ self.turn.T + self.shift

    def back(self, place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return a place of the picture in the robot's world."""
        return (place - self.shift) @ self.turn

    def ground(self, plane: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the height at the origin and the rises of a plane in the picture."""
        rise = self.turn[:2, :2] @ plane[1:]
        return np.array([plane[0] + self.shift[2] - rise @ self.shift[:2], *rise])


class Window:
    """A live robot as the browser gets it, and the messages that come back."""

    def __init__(self, live: Live, policies: Sequence[str] = (), policy: str = ""):
        bodies = live.stage.bodies
        self.live, self.model, self.policies, self.policy = live, live.model, policies, policy
        self.wanted: str | None = None
        """The policy that is to follow."""
        self.follower: Window | None = None
        self.note, self.until = "", 0.0
        """Message that precedes those about the robots, and the moment until which it does, by the monotonic clock."""
        self.scene = make_scene(bodies[0].model, self.model.qpos0[None])
        self.touching = {*pairs_of(bodies[0].model)[1].ravel().tolist()} - {*bodies[0].planes.tolist()}
        """Geoms that may touch, but for planes."""
        self.geoms = [*self.scene.shown, *sorted(self.touching - {*self.scene.shown})]
        """Geoms of the page's shapes: those that are always drawn, then those that a switch shows."""
        self.sides = BESIDE * self.model.stat.extent * (np.arange(len(bodies)) - (len(bodies) - 1) / 2)
        """Offset to the left at which each robot is drawn, m."""
        self.scales = _scales(live)
        self.made, self.frame, self.number, self.changed = time.monotonic(), self._frame(), 0, threading.Condition()
        live.stage.shown = lambda: self._show(self._frame())

    def page(self) -> bytes:
        """The page."""
        live, title = self.live, self.live.trained.title
        data, model, shown = scene_data(self.scene, title), self.scene.model, self.scene.shown
        kinds = [{"touches": geom in self.touching, "hidden": geom not in shown} for geom in self.geoms]
        shapes = [shape_of(model, geom) | kind for geom, kind in zip(self.geoms, kinds, strict=True)]
        data["shapes"] = shapes * len(live.stage.bodies)
        data["distance"] *= 1.0 + 0.5 * (len(live.stage.bodies) - 1)
        data |= {
            "live": {"scales": self.scales, "policies": self.policies, "policy": self.policy}
            | {name: getattr(live, name) for name in ("ranges", "told", "home", "touchable")},
            "legs": _legs(live),
            "first": self.now(),
        }
        return page(title, player(data, "<p>This needs JavaScript.</p>"), live=True).encode()

    def frames(self) -> Iterator[str]:
        """The frames as they come, the newest only where its reader is slow, and one a second where none comes."""
        seen = -1
        while True:
            with self.changed:
                self.changed.wait_for(lambda: self.number != seen, timeout=1.0)  # noqa: B023
                seen = self.number
            yield json.dumps((self.follower or self).now(), separators=(",", ":"))

    def now(self) -> dict[str, Any]:
        """The newest frame, and what is true now; `compiling`: for how long it has, s, until it is ready."""
        live, compiling = self.live, None if self.live.ready else time.monotonic() - self.made
        words = self.note if time.monotonic() < self.until else live.words
        now = {"policy": self.policy, "words": words, "compiling": compiling}
        return self.frame | now | {"paused": not live.going.is_set()}

    def followed(self, policy: str, other: Callable[[], Live]) -> "Window":
        """The window of another policy's robots, which browsers load in place of this one; or this one, which then says
        why there are none."""
        self.wanted = None
        try:
            self.follower = Window(other(), self.policies, policy)
        except InputError as error:
            self.note, self.until, self.live.over = str(error), time.monotonic() + NOTE_S, False
        return self.follower or self

    def take(self, message: Any) -> None:
        """Do what the browser asks for.

        Raises:
          ValueError, TypeError, LookupError, AttributeError, ArithmeticError: this is no such message, and nothing is
            done.
        """
        live = self.live
        for name, value in {name: self._read(name, value) for name, value in message.items()}.items():
            if name == "told":
                live.told.update(value)
            elif name == "push":
                side = random.uniform(0.0, math.tau)
                for body in live.stage.bodies:
                    body.shoves[:] = [value * np.array([math.cos(side), math.sin(side), 0.0])]
            elif name == "grab":
                for body, grab in zip(live.stage.bodies, value, strict=True):
                    body.grab = grab
            elif name == "paused":
                (live.going.clear if value else live.going.set)()
                self._show(self.frame)  # a robot that waits shows no other
            elif name == "policy":
                self.wanted, self.note, self.until = value, f"{value} is loaded.", math.inf
                live.stop()
            elif name == "once":
                live.once = value
                live.going.set()
            elif name == "episode":
                first = np.arange(len(live.episodes))
                live.episodes = np.clip(live.episodes + value, first, first + LAST_EPISODE)
                live.again.set()
                live.going.set()
            else:
                setattr(live.stage.hands, name, value)

    def _read(self, name: str, value: Any) -> Any:
        if name == "told":
            return {part: _within(number, *self.live.ranges[part]) for part, number in value.items()}
        if name == "grab" and self.live.touchable:
            return self._grabs(value)
        if name == "policy":
            return self.policies[self.policies.index(value)]
        if name in ("paused", "once") and type(value) is bool:
            return value
        if name == "episode" and type(value) is int and abs(value) <= LAST_EPISODE:
            return value
        return _within(value, *((SLOWEST, 1.0) if name == "pace" else self.scales[name][:2]))

    def _grabs(self, what: Any) -> list[Grab | None]:
        """Take a place on a shape into the hand, where one is named; else move the hand, or open it."""
        bodies, views, shown = self.live.stage.bodies, self.views(), self.geoms
        if what is None:
            return [None] * len(bodies)
        grabs, to = [body.grab for body in bodies], _place(what["to"])
        if "shape" in what:
            robot, shape = divmod(range(len(bodies) * len(shown)).index(what["shape"]), len(shown))
            data, part = bodies[robot].data, int(self.scene.model.geom_bodyid[shown[shape]])
            place = views[robot].back(_place(what["point"])) - data.xpos[part]
            grabs[robot] = Grab(part, data.xmat[part].reshape(3, 3).T @ place, place)
        return [grab and grab._replace(to=view.back(to)) for grab, view in zip(grabs, views, strict=True)]

    def _show(self, frame: dict[str, Any]) -> None:
        with self.changed:
            self.frame, self.number = frame, self.number + 1
            self.changed.notify_all()

    def views(self) -> list["Seen"]:
        """The picture of each robot: all look the same way when their episodes begin, and stand on one ground."""
        views: list[Seen] = []
        for body, side in zip(self.live.stage.bodies, self.sides, strict=True):
            view, place = Seen(np.eye(3), np.array([0.0, side, 0.0])), body.data.xpos[1]
            view.turn[:2, :2] = body.turn
            if views:
                level = views[0].ground(self.live.stage.bodies[0].ground) @ [1.0, *view.at(place)[:2]]
                view.shift[2] = level - body.height(place)
            views.append(view)
        return views

    def _frame(self) -> dict[str, Any]:
        live, bodies, views = self.live, self.live.stage.bodies, self.views()
        names = "shapes", "torsos", "forces", "pushes", "ahead", "centres", "axes"
        frame: dict[str, Any] = {name: [] for name in names}
        pressing = [body.pressing() if live.touchable else {} for body in bodies]
        for body, view, pressed in zip(bodies, views, pressing, strict=True):
            places, turns = posed(body.model, body.data, self.geoms)
            shown = {
                "torsos": view.at(body.data.xpos[1]),
                "centres": view.at(body.data.subtree_com[1]),
                "pushes": None if body.shoved is None else view.turn @ body.shoved,
                "ahead": view.turn[:2, :2] @ body.ahead,
            }
            for name, values in shown.items():
                frame[name].append(None if values is None else rounded(values))
            frame["shapes"] += poses(view.at(places), view.turn @ turns)
            frame["forces"] += [rounded([*view.at(at), *view.turn @ force]) for at, force in pressed.values()]
            joints = body.model.actuator_trnid[:, 0]
            axes = view.at(body.data.xanchor[joints]), body.data.xaxis[joints] @ view.turn.T
            frame["axes"] += map(rounded, np.hstack(axes))
        return frame | {
            "time": round(live.stage.time, 3),
            "ground": rounded(views[0].ground(bodies[0].ground)),
            "episodes": live.episodes.tolist(),
            "ended": [body.ended is not None for body in bodies],
            "world": {name: getattr(live.stage.hands, name) for name in self.scales if name != "push"},
            "charts": {
                title: {name: round(float(value), 4) for name, value in lines.items()}
                for title, lines in self._charts(pressing).items()
            },
        }

    def _charts(self, pressing: Sequence[Mapping[int, Any]]) -> dict[str, dict[str, Any]]:
        """The present numbers of each curve, by the curves' titles and the lines' names; of several robots only those
        of which each has one."""
        live, (first, *others) = self.live, self.live.stage.bodies
        names = [f"robot {i + 1}" for i in range(len(others) + 1)] if others else ["measured"]
        charts: dict[str, Any] = {name: {"commanded": live.told[name]} for name in live.told if name not in live.home}
        for i, name in enumerate(SPEEDS if first.free else ()):
            measured = [body.speeds[i] for body in (first, *others)]
            charts.setdefault(name, {}).update(zip(names, measured, strict=True))
        if others:
            return charts | {"reward of a decision": dict(zip(names, live.rewards.get("reward", ()), strict=False))}
        if loads := {foot: pressing[0].get(self.model.body(foot).id) for foot in live.feet}:
            charts["load on a foot, N"] = {
                foot: np.linalg.norm(found[1]) if found else 0.0 for foot, found in loads.items()
            }
        joints = self.model.actuator_trnid[:, 0]
        names = [self.model.joint(joint).name for joint in joints]
        angles = np.degrees(first.data.qpos[self.model.jnt_qposadr[joints]])
        charts["joint angle, degrees"] = dict(zip(names, angles, strict=True))
        if live.touchable:
            torques = first.data.qfrc_actuator[self.model.jnt_dofadr[joints]]
            charts["torque, N m"] = dict(zip(names, torques, strict=True))
        return charts | {"reward of a decision": {name: values[0] for name, values in live.rewards.items()}}


def _scales(live: Live) -> dict[str, Scale]:
    """The sliders of a robot's world; none where nobody can touch it.

    The first push is the mean one of the training, so that the policy bears it, and a third of `PUSH` at most: policies
    that were trained with harder ones bear not all of them.
    """
    model, first = live.model, live.stage.bodies[0]
    if not (live.touchable and first.free):
        return {}
    mass, task = float(model.body_mass.sum()), cast(Any, live.trained.learner.task)
    hardest = PUSH * mass * math.sqrt(9.81 * model.stat.extent)
    push: Any = task.push if isinstance(getattr(task, "push", None), Push) else Push(impulse=0.0)
    trained = float(push.impulse) * task.robot.momentum if push.impulse > 0 else 0.0
    usual = (1.0 + float(push.least)) / 2 * trained or GENTLE * hardest
    scales = {
        "push": Scale(0.0, two_digits(max(hardest, trained)), two_digits(min(usual, hardest / 3)), "push, N s"),
        "payload": Scale(0.0, two_digits(PAYLOAD * mass), 0.0, "payload, kg"),
    }
    if len(first.planes):
        scales["slope"] = Scale(-SLOPE, SLOPE, 0.0, "slope, degrees uphill")
        scales["friction"] = Scale(0.0, FRICTION, 1.0, "friction, times the model's")
    return scales


def _legs(live: Live) -> dict[str, list[str]]:
    """Names of the joints with a motor between the world and each foot."""
    model, legs = live.model, {}
    joints = model.actuator_trnid[:, 0]
    for foot in live.feet:
        moved = joints[below(model)[model.jnt_bodyid[joints], model.body(foot).id] > 0]
        legs[f"leg of {foot}"] = [model.joint(joint).name for joint in moved]
    return legs


def _within(value: Any, low: float, high: float) -> float:
    """The number in the range that is nearest to a finite one."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError
    return min(max(float(value), low), high)


def _place(values: Any) -> Float[np.ndarray, "3"]:
    x, y, z = values
    return np.array([_within(each, -1e6, 1e6) for each in (x, y, z)])
