"""Bias forces of a tree, velocity terms and gravity, by Newton and Euler's recursion."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from humanoid_mjx.mechanics.scalars import NULL, TWO, ZERO, Scalar, Vector, add, cross, dot, scale
from humanoid_mjx.mechanics.tree.algebra import NOWHERE, Spatial, over_lanes, power, subtract, summed, total
from humanoid_mjx.mechanics.tree.inertia import Mass
from humanoid_mjx.mechanics.tree.kinematics import Kinematics
from humanoid_mjx.mechanics.tree.structure import Tree


class Drift(NamedTuple):
    """Acceleration of a body while no degree of freedom accelerates."""

    angular: Vector
    """Its angular velocity, rad/s."""
    rate: Vector
    """Its angular acceleration."""
    linear: Vector
    """The acceleration of its own origin."""

    def at(self, arm: Vector) -> Vector:
        """The acceleration of its point at `arm` from its origin."""
        if all(part.is_known(0.0) for part in arm):
            return self.linear
        spinning = cross(self.angular, cross(self.angular, arm))
        return add(self.linear, add(cross(self.rate, arm), spinning))


def drifts_of(tree: Tree, kinematics: Kinematics, velocity: Sequence[Scalar]) -> list[Drift]:
    """The drift of each body. `velocity` has the free body's angular part in the world's axes."""
    still = Drift(NULL, NULL, NULL)
    found = [still]
    for index, body in enumerate(tree.bodies[1:], 1):
        if index == tree.free:
            found.append(still._replace(angular=Vector(*velocity[3:6])))
            continue
        now, place = found[body.parent], kinematics.poses[body.parent].position
        moved = body.position != (0.0, 0.0, 0.0)
        for joint in body.joints:
            if joint.slides:
                speed = scale(TWO * velocity[joint.dof], kinematics.motions[joint.dof].linear)
                linear = now.at(subtract(kinematics.anchors[joint.dof], place))
                now = now._replace(linear=add(linear, cross(now.angular, speed)))
                place, moved = kinematics.anchors[joint.dof], False
                continue
            anchor = kinematics.anchors[joint.dof]
            if moved or any(joint.anchor):
                now = now._replace(linear=now.at(subtract(anchor, place)))
            place, moved = anchor, False
            turning = scale(velocity[joint.dof], kinematics.motions[joint.dof].angular)
            now = Drift(add(now.angular, turning), add(now.rate, cross(now.angular, turning)), now.linear)
        offset = any(joint.anchor != (0.0, 0.0, 0.0) for joint in body.joints) or moved
        found.append(now._replace(linear=now.at(subtract(kinematics.poses[index].position, place))) if offset else now)
    return found


def bias_forces(
    tree: Tree,
    kinematics: Kinematics,
    masses: Sequence[Mass],
    drifts: Sequence[Drift],
    gravity: Vector,
) -> list[Scalar]:
    """Forces of the degrees of freedom with which none of them accelerates, N and N m."""
    wrenches = [NOWHERE] + [_wrench(mass, drift, gravity) for mass, drift in zip(masses[1:], drifts[1:], strict=True)]
    forces = [ZERO] * tree.nv
    for index in reversed(range(1, len(tree.bodies))):
        body = tree.bodies[index]
        if index == tree.free:
            forces[:6] = [*wrenches[index].linear, *wrenches[index].angular]
        for joint in body.joints:
            forces[joint.dof] = power(kinematics.motions[joint.dof], wrenches[index])
        merge = body.laned and not tree.bodies[body.parent].laned
        wrench = summed(wrenches[index], partial(over_lanes, tree)) if merge else wrenches[index]
        wrenches[body.parent] = total([wrenches[body.parent], wrench])
    return forces


def _wrench(mass: Mass, drift: Drift, gravity: Vector) -> Spatial:
    """Force that a body's inertia and weight require, about the origin."""
    force = scale(mass.mass, subtract(drift.at(mass.arm), gravity))
    # About principal axes u: I a + w x I w = base a + sum more (u (u.a) + (u.w) (w x u)).
    moment = scale(mass.base, drift.rate)
    for more, axis in mass.extra:
        about = scale(more * dot(axis, drift.rate), axis)
        moment = add(moment, add(about, scale(more * dot(axis, drift.angular), cross(drift.angular, axis))))
    return Spatial(force, add(moment, cross(mass.center, force)))
