"""A live robot in the browser of this machine: one page, the frames that it draws, and what it sends back."""

import json
import math
import random
import signal
import threading
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.live import SPEEDS, Grab, Live
from humanoid_mjx.report import player
from humanoid_mjx.report.scene import make_scene, posed
from humanoid_mjx.report.web import page
from humanoid_mjx.spec import InputError

LOOPBACK = "127.0.0.1"

SLOPE, FRICTION, PAYLOAD, PUSH = 10.0, 2.0, 0.5, 0.2
"""Largest slope, degrees; friction, as a factor; payload, as a share of the robot's mass; and impulse of a key's push,
as a share of the robot's momentum at the speed sqrt(gravity * extent)."""

SLOWEST = 0.05
"""Least seconds of the robot a second."""

BESIDE = 1.0
"""Distance at which several robots are drawn beside each other, as a share of the robot's extent."""

LONGEST = 10_000
"""Bytes of a message."""


def serve(live: Live, told: Callable[[str], None], *, port: int = 0, browse: bool = True) -> None:
    """Show a live robot in the browser until Ctrl-C, from a server that only this machine can reach.

    Args:
      live: the robot.
      told: called with the address, once it answers.
      port: of the server; 0: any that is free.
      browse: open the browser there.

    Raises:
      InputError: the port is taken.
    """

    def end(*_: Any) -> None:
        if not live.ready:
            raise KeyboardInterrupt
        live.stop()  # an exception would arise within a step of the physics, of which jax makes a failure

    with make_server(live, port) as server:
        address = f"http://{LOOPBACK}:{server.server_address[1]}/"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        told(f"{address}  (Ctrl-C ends it)")
        if browse:
            threading.Thread(target=partial(webbrowser.open, address), daemon=True).start()
        before = signal.signal(signal.SIGINT, end)
        try:
            live.run()
        finally:
            signal.signal(signal.SIGINT, before)


def make_server(live: Live, port: int = 0) -> ThreadingHTTPServer:
    """The server of a live robot on the loopback interface, which answers once it is let run.

    Raises:
      InputError: the port is taken.
    """
    try:
        server = ThreadingHTTPServer((LOOPBACK, port), Handler)
    except OSError as error:
        raise InputError(f"--port {port}: {error.strerror}; without --port a free one is taken.") from error
    server.RequestHandlerClass = partial(Handler, Window(live))
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

    def __init__(self, live: Live):
        self.live, self.model = live, live.model
        self.scene = make_scene(self.model, self.model.qpos0[None])
        bodies = self.live.stage.bodies
        self.sides = BESIDE * self.model.stat.extent * (np.arange(len(bodies)) - (len(bodies) - 1) / 2)
        """Offset to the left at which each robot is drawn, m."""
        self.scales = _scales(live)
        self.frame, self.number, self.changed = self._frame(), 0, threading.Condition()
        live.stage.shown = lambda: self._show(self._frame())

    def page(self) -> bytes:
        """The page."""
        live, title = self.live, self.live.trained.title
        data = player.scene_data(self.scene, title)
        data["shapes"] *= len(live.stage.bodies)
        data["distance"] *= 1.0 + 0.5 * (len(live.stage.bodies) - 1)
        data |= {
            "live": {"ranges": live.ranges, "told": live.told, "scales": self.scales, "touchable": live.touchable},
            "first": self.now(),
        }
        return page(title, player.figure(data, title, "<p>This needs JavaScript.</p>"), live=True).encode()

    def frames(self) -> Iterator[str]:
        """The frames as they come, the newest only where its reader is slow."""
        seen = -1
        while True:
            with self.changed:
                self.changed.wait_for(lambda: self.number != seen, timeout=5.0)  # noqa: B023
                seen = self.number
            yield json.dumps(self.now(), separators=(",", ":"))

    def now(self) -> dict[str, Any]:
        """The newest frame, and whether the robot waits now."""
        return self.frame | {"paused": not self.live.going.is_set()}

    def take(self, message: Any) -> None:
        """Do what the browser asks for.

        Raises:
          ValueError, TypeError, LookupError, AttributeError: this is no such message.
        """
        live, hands = self.live, self.live.stage.hands
        for name, value in message.get("told", {}).items():
            live.told[name] = _within(value, *live.ranges[name])
        for name in self.scales.keys() & message.keys() - {"push"}:
            setattr(hands, name, _within(message[name], *self.scales[name][:2]))
        if "pace" in message:
            hands.pace = _within(message["pace"], SLOWEST, 1.0)
        if "push" in message:
            size, side = _within(message["push"], *self.scales["push"][:2]), random.uniform(0.0, math.tau)
            for body in live.stage.bodies:
                body.shoves[:] = [size * np.array([math.cos(side), math.sin(side), 0.0])]
        if "grab" in message and live.touchable:
            self._grab(message["grab"])
        if "paused" in message:
            (live.going.clear if message["paused"] else live.going.set)()
            self._show(self.frame)  # a robot that waits shows no other
        if "episode" in message:
            live.episodes = np.maximum(live.episodes + int(message["episode"]), np.arange(len(live.episodes)))
            live.again.set()
            live.going.set()

    def _grab(self, what: Any) -> None:
        """Take a place on a shape into the hand, where one is named; else move the hand, or open it."""
        bodies, views = self.live.stage.bodies, self.views()
        if what is None:
            for body in bodies:
                body.grab = None
            return
        to = _place(what["to"])
        if "shape" in what:
            robot, shape = divmod(int(what["shape"]), len(self.scene.shown))
            held, part = bodies[robot], int(self.model.geom_bodyid[self.scene.shown[shape]])
            place = views[robot].back(_place(what["point"])) - held.data.xpos[part]
            held.grab = Grab(part, held.data.xmat[part].reshape(3, 3).T @ place, place)
        for body, view in zip(bodies, views, strict=True):
            body.grab = body.grab and body.grab._replace(to=view.back(to))

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
        frame: dict[str, Any] = {"shapes": [], "torsos": [], "forces": [], "pushes": [], "ahead": []}
        pressing = [body.pressing() if live.touchable else {} for body in bodies]
        for body, view, pressed in zip(bodies, views, pressing, strict=True):
            places, turns = posed(self.model, body.data, self.scene.shown)
            shown = {
                "torsos": view.at(body.data.xpos[1]),
                "pushes": None if body.shoved is None else view.turn @ body.shoved,
                "ahead": view.turn[:2, :2] @ body.ahead,
            }
            for name, values in shown.items():
                frame[name].append(None if values is None else player.rounded(values))
            frame["shapes"] += player.poses(view.at(places), view.turn @ turns)
            frame["forces"] += [player.rounded([*view.at(at), *view.turn @ force]) for at, force in pressed.values()]
        return frame | {
            "time": round(live.stage.time, 3),
            "ground": player.rounded(views[0].ground(bodies[0].ground)),
            "words": live.words,
            "episodes": live.episodes.tolist(),
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
        charts: dict[str, dict[str, Any]] = {name: {"commanded": value} for name, value in live.told.items()}
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
            charts["torque, N m"] = dict(zip(names, first.data.actuator_force, strict=True))
        return charts | {"reward of a decision": {name: values[0] for name, values in live.rewards.items()}}


def _scales(live: Live) -> dict[str, Scale]:
    """The sliders of a robot's world; none where nobody can touch it."""
    model, first = live.model, live.stage.bodies[0]
    if not (live.touchable and first.free):
        return {}
    mass = float(model.body_mass.sum())
    hardest = PUSH * mass * math.sqrt(9.81 * model.stat.extent)
    scales = {
        "push": Scale(0.0, _short(hardest), _short(hardest / 3), "push, N s"),
        "payload": Scale(0.0, _short(PAYLOAD * mass), 0.0, "payload, kg"),
    }
    if len(first.planes):
        scales["slope"] = Scale(-SLOPE, SLOPE, 0.0, "slope, degrees uphill")
        scales["friction"] = Scale(0.0, FRICTION, 1.0, "friction, times the model's")
    return scales


def _within(value: Any, low: float, high: float) -> float:
    if not math.isfinite(value):
        raise ValueError
    return min(max(float(value), low), high)


def _place(values: Any) -> Float[np.ndarray, "3"]:
    return np.array([_within(values[i], -1e6, 1e6) for i in range(3)])


def _short(value: float) -> float:
    return float(f"{value:.2g}")


class Handler(BaseHTTPRequestHandler):
    """Answers to the browser of this machine, and to no page of another site in it."""

    protocol_version = "HTTP/1.1"

    def __init__(self, window: Any, *args: Any):
        self.window = window
        super().__init__(*args)

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if not self._is_for_us():
            self._answer(403)
        elif path == "/":
            self._answer(200, self.window.page(), "text/html; charset=utf-8")
        elif path == "/frames" and self.command == "GET":
            self._stream()
        else:
            self._answer(404)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not self._is_for_us() or self.headers.get("Content-Type") != "application/json":
            self._answer(403)
        elif self.path != "/hands" or not length.isdecimal() or int(length) > LONGEST:
            self._answer(404)
        else:
            try:
                self.window.take(json.loads(self.rfile.read(int(length))))
            except (ValueError, TypeError, LookupError, AttributeError):
                self._answer(400)
            else:
                self._answer(204)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing of the requests is printed."""

    def _is_for_us(self) -> bool:
        """Return whether a request names this server as its host, and comes from no page of another site."""
        port = self.server.server_address[1]  # pyright: ignore[reportIndexIssue]
        names = {f"{host}:{port}" for host in (LOOPBACK, "localhost")}
        origin = self.headers.get("Origin")
        return self.headers.get("Host") in names and origin in (None, *(f"http://{name}" for name in names))

    def _stream(self) -> None:
        """Frames as server-sent events, until the browser has gone."""
        self.close_connection = True
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        with suppress(OSError):
            for frame in self.window.frames():
                self.wfile.write(f"data: {frame}\n\n".encode())

    def _answer(self, status: int, content: bytes = b"", kind: str = "text/plain") -> None:
        self.close_connection = self.close_connection or status >= 400
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
