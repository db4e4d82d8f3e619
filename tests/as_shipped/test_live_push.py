"""The push that a person gives first in the live view."""

import threading

import numpy as np
import pytest

from humanoid_mjx.evaluation.live import Live
from humanoid_mjx.evaluation.live.body import Hands
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.report.live import _scales

SIDES = 1.0, 4.0
"""Directions of the pushes, rad, each on a robot of its own."""


@pytest.mark.parametrize("name", ["stand", "walk", "walk_sturdy", "walk_dog", "walk_humanoid"])
def test_the_first_push_fells_no_policy_that_ships(name):
    """Standing and walking."""
    live = Live(find_policy(name), robots=len(SIDES))
    live.stage.hands = Hands(pace=1000.0)
    push = _scales(live)["push"]
    begun, moved = live.stage.time, []
    script = [(0.4, "push"), (1.6, "walk"), (2.8, "push"), (4.0, "end")]

    def shown():
        if not live.ready or not script or live.stage.time - begun < script[0][0]:
            return
        act = script.pop(0)[1]
        if act == "push":
            for body, side in zip(live.stage.bodies, SIDES, strict=True):
                body.shoves[:] = [push.now * np.array([np.cos(side), np.sin(side), 0.0])]
        elif act == "walk":
            moved.extend(body._until > 0 for body in live.stage.bodies)
            if "forward, m/s" in live.ranges:
                live.told["forward, m/s"] = 0.6 * live.ranges["forward, m/s"][1]
        else:
            live.stop()

    live.stage.shown = shown
    runner = threading.Thread(target=live.run)
    runner.start()
    runner.join(600)
    assert not runner.is_alive() and moved == [True] * len(SIDES)
    assert live.episodes.tolist() == list(range(len(SIDES))) and all(body.ended is None for body in live.stage.bodies)
