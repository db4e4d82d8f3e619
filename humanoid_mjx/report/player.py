"""A film as a piece of a web page that is played in the browser, seen from any side (`player.js`)."""

import json
from collections.abc import Iterable
from html import escape
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from humanoid_mjx.evaluation.film import Film
from humanoid_mjx.report import scene

FPS = 25.0
"""Postures per second that a page holds; the player draws what lies between."""


def player(film: Film, *, still: str = "") -> str:
    """The HTML of a player; `still` is what stands in its place without JavaScript, as HTML."""
    return figure(film_data(film), film.title, still)


def figure(data: dict[str, Any], title: str, still: str) -> str:
    """The HTML that `player.js` makes a player of."""
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<figure class="player"><div class="stage">{still}</div>'
        f'<script type="application/json">{text}</script><figcaption>{escape(title)}</figcaption></figure>'
    )


def scene_data(motion: scene.Scene, title: str) -> dict[str, Any]:
    """Return what `player.js` reads of any robot: light and camera, and shapes."""
    return {
        "title": title,
        "yaw": np.radians(scene.AZIMUTH),
        "pitch": np.radians(scene.ELEVATION),
        "field": np.tan(np.radians(scene.FIELD_OF_VIEW / 2)),
        "distance": motion.distance,
        "light": scene.LIGHT.tolist(),
        "brightness": [scene.AMBIENT, scene.DIFFUSE, scene.HEADLIGHT, scene.SKYLIGHT],
        "middle": float(motion.middle[0, 2]),
        "grid": motion.grid,
        "arrow": motion.arrow,
        "shapes": [
            {"kind": shape.kind, "size": rounded(shape.size), "color": rounded(shape.color)} for shape in motion.shapes
        ],
    }


def film_data(film: Film) -> dict[str, Any]:
    """Return what `player.js` reads of a film: the scene, and for each frame a position, m, and a quaternion (w x y z)
    of each shape."""
    motion = scene.make_scene(film.model, film.at(FPS)[0], film.terrain)
    pushes = [{"start": p.start, "seconds": p.shown, "force": p.force.tolist(), "words": p.words} for p in film.pushes]
    return scene_data(motion, film.title) | {
        "fps": FPS,
        "frames": [poses(*frame) for frame in zip(motion.position, motion.rotation, strict=True)],
        "torso": [rounded(place) for place in motion.torso],
        "told": [list(each) for each in film.told],
        "pushes": pushes,
    }


def poses(places: Float[np.ndarray, "shapes 3"], turns: Float[np.ndarray, "shapes 3 3"]) -> list[list[float]]:
    """Positions and quaternions, side by side."""
    return [[*rounded(place), *rounded(_quaternion(turn))] for place, turn in zip(places, turns, strict=True)]


def rounded(values: Iterable[float]) -> list[float]:
    """To a tenth of a millimetre, or what turns a leg's end by as much."""
    return [round(float(value), 4) for value in values]


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, rotation.reshape(-1))  # pyright: ignore[reportAttributeAccessIssue]
    return quaternion
