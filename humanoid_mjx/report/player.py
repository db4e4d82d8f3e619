"""A film as a piece of a web page that is played in the browser, seen from any side (`player.js`)."""

import json
import threading
import webbrowser
from collections.abc import Callable
from functools import partial
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import mujoco
import numpy as np

from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.report import overlay, scene
from humanoid_mjx.report.web import page

FPS = 25.0
"""Postures per second that a page holds; the player draws what lies between."""

LOOPBACK = "127.0.0.1"


def player(film: Film, *, still: str = "", autoplay: bool = False) -> str:
    """The HTML of a player; `still` is what stands in its place without JavaScript, as HTML."""
    data = json.dumps(film_data(film), separators=(",", ":")).replace("<", "\\u003c")
    caption = escape(film.title)
    return (
        f'<figure class="player"{" data-autoplay" * autoplay}><div class="stage">{still}</div>'
        f'<script type="application/json">{data}</script><figcaption>{caption}</figcaption></figure>'
    )


def film_data(film: Film) -> dict[str, Any]:
    """Return what `player.js` reads: light and camera, shapes, and for each frame a position, m, and a quaternion
    (w x y z) of each."""
    qpos, _ = film.at(FPS)
    motion = scene.make_scene(film.model, qpos)
    poses = [
        [[*_rounded(place), *_rounded(_quaternion(turn))] for place, turn in zip(places, turns, strict=True)]
        for places, turns in zip(motion.position, motion.rotation, strict=True)
    ]
    shapes = [
        {"kind": shape.kind, "size": _rounded(shape.size), "color": _rounded(shape.color)} for shape in motion.shapes
    ]
    pushes = [
        {"start": p.start, "seconds": max(p.seconds, overlay.SHOWN_S), "force": p.force.tolist(), "words": p.words}
        for p in film.pushes
    ]
    return {
        "title": film.title,
        "fps": FPS,
        "yaw": np.radians(scene.AZIMUTH),
        "pitch": np.radians(scene.ELEVATION),
        "field": np.tan(np.radians(scene.FIELD_OF_VIEW / 2)),
        "distance": motion.distance,
        "light": scene.LIGHT.tolist(),
        "brightness": [scene.AMBIENT, scene.DIFFUSE, scene.HEADLIGHT],
        "middle": float(motion.middle[0, 2]),
        "grid": motion.grid,
        "arrow": motion.arrow,
        "shapes": shapes,
        "frames": poses,
        "torso": [_rounded(place) for place in motion.torso],
        "told": [list(each) for each in film.told],
        "pushes": pushes,
    }


def serve(film: Film, told: Callable[[str], None], *, browse: bool = True) -> None:
    """Show a film in the browser until Ctrl-C, from a server that only this machine can reach.

    Args:
      film: what is shown.
      told: called with the address, once it answers.
      browse: open the browser there.
    """
    with make_server(film) as server:
        address = f"http://{LOOPBACK}:{server.server_address[1]}/"
        told(address)
        if browse:
            threading.Thread(target=partial(webbrowser.open, address), daemon=True).start()
        server.serve_forever()


def make_server(film: Film) -> ThreadingHTTPServer:
    """A server of one page on a free port of the loopback interface."""
    content = page(film.title, player(film, autoplay=True, still="<p>This needs JavaScript.</p>")).encode()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            found = self.path == "/"
            self.send_response(200 if found else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(content) if found else 0))
            self.end_headers()
            if found:
                self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            """Nothing of the requests is printed."""

    return ThreadingHTTPServer((LOOPBACK, 0), Handler)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.reshape(-1))  # pyright: ignore[reportAttributeAccessIssue]
    return quaternion


def _rounded(values: np.ndarray) -> list[float]:
    """To a tenth of a millimetre, or what turns a leg's end by as much."""
    return [round(float(value), 4) for value in values]
