"""Bias forces of a tree, velocity terms and gravity, by Newton and Euler's recursion."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from humanoid_mjx.mechanics.tree.algebra import cross, force_at, joined, stacked, turn
from humanoid_mjx.mechanics.tree.inertia import Mass, felt_forces
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Tree


class Drift(NamedTuple):
    """Acceleration of a body while no degree of freedom accelerates."""

    angular: Any
    """Its angular velocity, rad/s."""
    rate: Any
    """Its angular acceleration."""
    linear: Any
    """The acceleration of its own origin."""

    def at(self, arm: Any) -> Any:
        """The acceleration of its point at `arm` from its origin."""
        return self.linear + (cross(self.rate, arm) + cross(self.angular, cross(self.angular, arm)))

    def moved(self, old: Any, new: Any) -> "Drift":
        """The drift about another origin."""
        return self if new is old else self._replace(linear=self.at(new - old))


def drifts_of(tree: Tree, kinematics: Kinematics, velocity: Sequence[Any]) -> list[Drift]:
    """The drift of each body. `velocity` has the free body's angular part in the world's axes."""
    still = Drift(*np.zeros((3, 3, 1, 1)))
    found = [still]
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            found.append(still._replace(angular=stacked(velocity[3:6])))
            continue
        now, place = found[body.parent], kinematics.poses[body.parent].position
        for joint in body.joints:
            anchor, turning = kinematics.anchors[joint.dof], velocity[joint.dof] * kinematics.motions[joint.dof]
            now = now.moved(place, anchor)
            if joint.slides:
                now = now._replace(linear=now.linear + 2.0 * cross(now.angular, turning[:3]))
            else:
                rate = now.rate + cross(now.angular, turning[3:])
                now = Drift(now.angular + turning[3:], rate, now.linear)
            place = anchor
        found.append(now.moved(place, kinematics.poses[index].position))
    return found


def bias_forces(
    tree: Tree, kinematics: Kinematics, masses: Sequence[Mass], drifts: Sequence[Drift], gravity: Any
) -> list[Any]:
    """Forces of the degrees of freedom with which none of them accelerates, N and N m."""
    each = enumerate(zip(masses, drifts[1:], strict=True), 1)
    return felt_forces(tree, kinematics, {index: _wrench(*both, gravity) for index, both in each})


def _wrench(mass: Mass, drift: Drift, gravity: Any) -> Any:
    """Force that a body's inertia and weight require, about the origin."""
    force = mass.mass * (drift.at(mass.arm) - gravity)
    moment = turn(mass.inertia, drift.rate) + cross(drift.angular, turn(mass.inertia, drift.angular))
    return force_at(force, mass.center) + joined(np.zeros((3, 1, 1)), moment)
