"""Section 7 B and Figures 7.1 to 7.4: the planned motion of the joints and where it takes the toe; and the
singular postures of the gaits (chapter 8, section 4.4)."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from humanoid_mjx import dynamics, kinematics
from humanoid_mjx.mechanics.gaits import Gait, gait
from humanoid_mjx.mechanics.trajectories import rest_to_rest, thesis_quintics
from humanoid_mjx.report.style import COLORS
from humanoid_mjx.reproduction.findings import Finding, Setting, changed, check, compare, experiment, in_words, listed
from humanoid_mjx.reproduction.leg_values import over, planned, plot_joints
from humanoid_mjx.reproduction.motor_sizing import body_weight
from humanoid_mjx.robot.leg import Leg, cylinder_inertias
from humanoid_mjx.thesis import leg as thesis

TOLERANCE_M, TOLERANCE_RAD = 6e-5, 5e-5
"""The printing's last digit is 0.1 mm; lengths recovered in whole millimetres add a little."""

SAMPLES = 20_000
HEMISPHERE = 0.1
"""By how much thickness over width may differ from a half."""

GRAIN_M = 0.01

LENGTHS = {
    "lengths": {f"l{i}": x for i, x in enumerate(thesis.LINK_LENGTHS, start=1)},
    "straight_walk_end": {"knee": thesis.STRAIGHT_WALK_END[3], "ankle": thesis.STRAIGHT_WALK_END[4]},
}
PRINTED_LENGTHS = {f"l{i}": x for i, x in enumerate(thesis.SCRIPT_LENGTHS, start=1)}
PRINTED_END = {"knee": thesis.QUINTIC_RANGES[3][1], "ankle": thesis.QUINTIC_RANGES[4][1]}

MOTIONS = {2: "straight walking", 3: "sudden turn", 4: "all joints"}


@experiment("figure-7.1", "The planned motion of the joints", {"units": {"degree": thesis.FIGURE_7_5_DEGREE}})
def planned_trajectories(setting: Setting) -> Iterator[Finding]:
    degree = setting.config["units"]["degree"]
    t = np.linspace(0, thesis.QUINTIC_S, 201)
    angles, marks = np.degrees(planned(t).position) * degree, np.array(thesis.FIGURE_7_1)
    with setting.figure(1, 1, size=(6.0, 3.6)) as (_, axes):
        plot_joints(axes[0, 0], t, angles, {0.0: marks[:, 0], thesis.QUINTIC_S: marks[:, 1]})
        axes[0, 0].set(ylabel="angle, rad", title="Planned joint positions; dots: the values section 7 A prints")
    quantity, values = "the joints start and end at, rad", ({"degree": degree}, {"degree": np.pi / 180})
    why = f"{in_words(*values)} rad: 3.15/180, pi rounded"
    yield compare(quantity, marks, angles[[0, -1]].T, TOLERANCE_RAD, why, 5, values=values)
    jerk = 6 * np.degrees(thesis_quintics().coefficients[3])
    quantity = "jerk at the start and the end of the plan, degrees/s^3 by joint (none, as speed is 0 there: 7 A)"
    why = "at rest without acceleration a quintic over an angle D in a time T has the jerk 60 D / T^3"
    yield compare(quantity, np.zeros(5), jerk, 1.0, why)


@experiment("workspace-7b", "The toe at the start and the end of the planned motions", LENGTHS)
def reach(setting: Setting) -> Iterator[Finding]:
    """The triples of section 7 B as the toe's place at the start and at the end."""
    lengths, places = setting.config["lengths"], {}
    for name in MOTIONS.values():
        ends = np.degrees(_motion(name, np.array([0.0, thesis.QUINTIC_S])))
        for when, posture, mark in zip(("start", "end"), ends, thesis.WORKSPACE[name], strict=True):
            places.setdefault((*posture, *mark), (f"{name}, {when}: the toe, m", posture, mark))
    for quantity, posture, mark in places.values():
        yield _place(quantity, posture, mark, lengths, lengths, PRINTED_LENGTHS)
    swapped = np.array(thesis.STRAIGHT_WALK_END)
    swapped[3:] = setting.config["straight_walk_end"]["knee"], setting.config["straight_walk_end"]["ankle"]
    mark = thesis.WORKSPACE["straight walking"][1]
    used, printed = lengths | setting.config["straight_walk_end"], PRINTED_LENGTHS | PRINTED_END
    quantity = "straight walking, end, with knee and ankle at other angles: the toe, m"
    yield _place(quantity, swapped, mark, lengths, used, printed)


def _place(quantity: str, degrees: np.ndarray, mark: Any, lengths: Any, used: Any, printed: Any) -> Finding:
    """The finding on one place of the toe, m, from the links' lengths and the values used and printed, by name."""
    changes = changed({k: v for k, v in used.items() if k not in lengths}, printed)
    place, script = (_toe(x, np.radians(degrees)[None])[0] for x in (lengths.values(), thesis.SCRIPT_LENGTHS))
    error, as_printed = (np.abs(x - mark).max() for x in (place, script))
    why = f"links of {listed(1e3 * x for x in lengths.values())} mm (printed are only the script's, with which it is "
    why += f"off by {1e3 * as_printed:.0f} mm), joints at {listed(degrees + 0.0)} degrees"
    why += "".join(f", {change}" for change in changes) + f": off by {1e3 * error:.2g} mm"
    return compare(quantity, mark, place, TOLERANCE_M, why, 5, values=(used, printed))


def workspace(name: str, setting: Setting) -> Iterator[Finding]:
    """Figures 7.2 to 7.4: the toe's path, and all places that the moving joints reach in the ranges of Table 3.2."""
    lengths = setting.config["lengths"]
    path = _toe(lengths.values(), _motion(name, np.linspace(0, thesis.QUINTIC_S, 401)))
    ranges = thesis.QUINTIC_RANGES, thesis.JOINT_RANGES["proposed"]
    own, cloud = (_cloud(lengths.values(), name, each) for each in ranges)
    _draw(setting, name, lengths.values(), path, own, cloud)
    marks = np.sort(np.array(thesis.WORKSPACE[name]), axis=0)
    extent = np.stack([path.min(axis=0), path.max(axis=0)])
    quantity = f"{name}: from where to where the toe's path reaches along x, y and z, m"
    why = "the text says that the reach varies from one triple to the other; they are the path's two ends "
    why += f"(workspace-7b), not its extents, which differ by up to {1e3 * np.abs(extent - marks).max():.0f} mm"
    yield compare(quantity, marks, extent, TOLERANCE_M, why, 4, values=(lengths, PRINTED_LENGTHS))
    if name in SHAPES:
        yield SHAPES[name](name, cloud, lengths)


def _hemisphere(name: str, cloud: np.ndarray, lengths: dict[str, float]) -> Finding:
    """A hemisphere is half as thick as it is wide, in one direction or another."""
    widths = np.sort(np.ptp(cloud - cloud.mean(axis=0), axis=0))
    thick, wide = float(widths[0]), float(widths[-1])
    quantity, agrees = f"{name}: how thick and how wide the workspace is, m", abs(thick / wide - 0.5) < HEMISPHERE
    why = "joints 1, 4 and 5 have parallel axes, so the workspace is a flat piece of the plane z = l1; a hemisphere "
    why += "would be half as thick as wide"
    found, values = [round(thick, 6), round(wide, 4)], (lengths, PRINTED_LENGTHS)
    return check(quantity, "hemispherical in shape", found, agrees, why, HEMISPHERE, values)


def _ellipsoid(name: str, cloud: np.ndarray, lengths: dict[str, float]) -> Finding:
    """An ellipsoid, solid or hollow, is its own mirror image at its centre."""
    centre = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    mirrored = KDTree(cloud).query(2 * centre - cloud)[0] < GRAIN_M
    why = f"a place counts as reached within {1e3 * GRAIN_M:g} mm of one of {SAMPLES:,} that are; an ellipsoid would "
    why += "hold the mirror image of each of its places at its centre"
    quantity, share = f"{name}: share of the workspace whose mirror image belongs to it", round(mirrored.mean(), 3)
    return check(quantity, "ellipsoid in shape", share, share > 0.95, why, 0.05, (lengths, PRINTED_LENGTHS))


SHAPES = {"straight walking": _hemisphere, "sudden turn": _ellipsoid}


def _draw(setting: Setting, name: str, lengths: Any, path: np.ndarray, own: np.ndarray, cloud: np.ndarray) -> None:
    """Places in reach, the path and the printed ends, from the right, from behind, and in space with the leg."""
    marks, black = np.array(thesis.WORKSPACE[name]), {"color": COLORS[6], "markersize": 3, "linewidth": 1}
    curves = [(path, "-", COLORS[0], "planned path of the toe"), (marks, "x", COLORS[1], "both ends as printed")]
    if name == "straight walking":
        swapped = rest_to_rest(_motion(name, np.zeros(1))[0], np.radians(thesis.STRAIGHT_WALK_END), thesis.QUINTIC_S)
        swapped = _toe(lengths, planned(np.linspace(0, thesis.QUINTIC_S, 401), swapped).position)
        curves += [(swapped, "--", COLORS[2], "with knee to 45° and ankle to 120°, as recovered")]
    leg, ends = Leg.from_links(list(lengths), cylinder_inertias()), _motion(name, np.array([0.0, thesis.QUINTIC_S]))
    legs = zip(over(kinematics.frames, leg, ends)[:, :, :3, 3], ("o-", "o:"), ("start", "end"), strict=True)
    legs = [(joints, look, f"the leg at the {when}") for joints, look, when in legs]
    clouds = (own, "#9CCBE8", "in reach in the plan's ranges"), (cloud, "0.7", "in reach in the ranges of Table 3.2")
    title = f"{name.capitalize()}: where the toe goes and could go; joints 1 and 2 are planned in each other's ranges"
    views = (([0, 1], "From the right"), ([2, 1], "From behind"), ([2, 0, 1], "In space, from behind on the right"))
    words = "x (forwards), m", "y (upwards), m", "z (sideways), m"
    with setting.figure(1, 3, size=(4.2, 4.4), title=title, legend=3) as (fig, axes):
        axes[0, 2].remove()
        space = fig.add_subplot(1, 3, 3, projection="3d", elev=25, azim=-35)
        for panel, (seen, view) in zip((*axes[0, :2], space), views, strict=True):
            for places, color, label in clouds:
                panel.plot(*places[:, seen].T, ".", color=color, markersize=0.5)
                panel.plot(*[[]] * len(seen), "s", color=color, label=label)
            for places, look, color, label in curves:
                panel.plot(*places[:, seen].T, look, color=color, markersize=8, label=label)
            for joints, look, label in legs:
                panel.plot(*joints[:, seen].T, look, label=label, **black)
            panel.set(title=view, xlabel=words[seen[0]], ylabel=words[seen[1]])
            panel.locator_params(nbins=5)
            panel.set_aspect("equal", adjustable="datalim")
        space.set(xlim=(-0.2, 0.25), ylim=(-0.25, 0.3), zlim=(-0.3, 0.15))
        space.set_aspect("equal", adjustable="box")


def _cloud(lengths: Any, name: str, ranges: Any) -> np.ndarray:
    """(n, 3) The toe's places, m, with the joints that move anywhere in ranges, degrees, and the others at 0."""
    free = np.radians(ranges) * np.isin(np.arange(1, 6), thesis.WORKSPACE_JOINTS[name])[:, None]
    sample = jax.jit(kinematics.workspace, static_argnames="n")
    leg = Leg.from_links(list(lengths), cylinder_inertias())
    return np.asarray(sample(leg, jnp.array(free), jax.random.key(0), n=SAMPLES))


def _motion(name: str, t: np.ndarray) -> np.ndarray:
    """(n, 5) The planned angles, rad, of the joints that move; the others stay at 0."""
    return planned(t).position * np.isin(np.arange(1, 6), thesis.WORKSPACE_JOINTS[name])


def _toe(lengths: Any, q: np.ndarray) -> np.ndarray:
    """(n, 3) The toe's places, m."""
    return over(kinematics.forward, Leg.from_links(list(lengths), cylinder_inertias()), q)[:, :3, 3]


for _number, _name in MOTIONS.items():
    experiment(f"figure-7.{_number}", f"Workspace of {_name}", {"lengths": LENGTHS["lengths"]})(
        partial(workspace, _name)
    )


SINGULAR, NEAR = 1e-5, 0.25
"""The least singular value of the Jacobian counts as 0 below the first, m and rad, in single precision; below this
share of that at the start a posture is nearly singular."""

GAITS = {"straight_walk": "walking straight, Table 4.5", "sudden_turn": "the sudden turn, Table 4.6"}
INSTANTS = 2001
HALF_WEIGHT = body_weight(-thesis.SCRIPT_FORCE[2]) / 2


@experiment("finding-singularity", "Singular postures during walking")
def singularity(setting: Setting) -> list[Finding]:
    """The singular postures of both gaits, and what the determinants of section 4.4 tell of them."""
    t = np.linspace(0.0, thesis.GAIT_TIMES_S[-1], INSTANTS)
    walks = [_walk(gait(name, "linear"), title, t) for name, title in GAITS.items()]
    return [*walks, _rank_test(t), judge_locking(*(straight_stiffness(force) for force in (0.0, HALF_WEIGHT)))]


def straight_stiffness(force: float) -> float:
    """The least stiffness, N m/rad, of the straight leg without torques, which is singular, against any motion of its
    joints; a force, N, pushes the toe towards the hip. Negative: it does not stay straight."""
    leg, wrench = Leg.physical(), jnp.zeros(6).at[1].set(force)
    held = jax.jacfwd(lambda q: dynamics.gravity(leg, q) - kinematics.static_torque(leg, q, wrench))(jnp.zeros(5))
    return float(np.linalg.eigvalsh(held).min())


def judge_locking(hanging: float, standing: float) -> Finding:
    """The finding that a singular posture locks, from the stiffness of the straight leg, N m/rad."""
    quantity = "the least stiffness of the straight leg without torques, N m/rad: hanging, carrying half of the body"
    claim = "in a singular posture the structure comes to a locking state, which gives safety (4.4.1)"
    why = f"a force along the straight leg needs no torque, whatever its size; but pushed by {HALF_WEIGHT:.1f} N it "
    why += "buckles at any touch where the stiffness is negative, and hanging nothing holds the yaw. The rank is lost "
    why += "as the joints can move there without the toe: a posture that is not singular holds them if the foot is held"
    found = [round(x, 4) + 0.0 for x in (hanging, standing)]
    return check(quantity, claim, found, min(found) >= 0, why, 0.0)


def _walk(motion: Gait, title: str, t: np.ndarray) -> Finding:
    """The singular postures of a gait."""
    q = over(Gait.at, motion, t).position
    crossing = np.flatnonzero(np.diff(np.sign(q[:, 3])) != 0)
    share = q[crossing, 3] / (q[crossing, 3] - q[crossing + 1, 3])
    times = t[crossing] + share * (t[crossing + 1] - t[crossing])
    at_crossing = _least(over(Gait.at, motion, times).position)
    singular = times[at_crossing < SINGULAR]
    zeros, yaws = (", ".join(f"{x:.3f}" for x in some) for some in (times, singular))
    values = _least(q)
    least, near = float(min(at_crossing.min(), values.min())), values < NEAR * values[0]
    passes = int(near[0]) + int((np.diff(near.astype(int)) > 0).sum())
    yaw = f"the yaw is 0 at {yaws} s" if len(singular) else "where the yaw is not"
    why = f"the leg is singular where yaw and knee are both 0; the knee passes 0 at {zeros} s, {yaw}; the least "
    why += f"singular value of the Jacobian is {least:.2g} (at the start {values[0]:.2g}), and below {NEAR:g} of that "
    why += f"at the start {passes} times a step: nearly singular"
    return check(f"{title}: singular postures in a step", 0, len(singular), len(singular) == 0, why)


def _rank_test(t: np.ndarray) -> Finding:
    """The share of a walk where the determinants (4.22) and (4.23) vanish and the Jacobian keeps its rank."""
    q = over(Gait.at, gait("straight_walk", "linear"), t).position
    jac, least = over(kinematics.jacobian, Leg.physical(), q), _least(q)
    leg = np.abs(np.linalg.det(jac[:, :3][:, :, [0, 3, 4]]))
    torso = np.abs(np.linalg.det(jac[:, :2][:, :, [1, 2]]))
    vanish = (leg < SINGULAR**2) & (torso < SINGULAR**2)
    wrong = float(np.mean(vanish & (least > SINGULAR)))
    quantity = "share of the straight walk where (4.22) and (4.23) are 0 and the Jacobian has full rank"
    why = "the determinants of parts of the Jacobian are both 0 wherever yaw and roll are, at any angle of the knee: "
    why += "they are no test of its rank"
    return check(quantity, "singular where the determinants are 0 (4.4.1)", round(wrong, 4), wrong == 0.0, why)


def _least(q: np.ndarray) -> np.ndarray:
    """(n,) The least singular value of the Jacobian, m and rad."""
    return np.linalg.svd(over(kinematics.jacobian, Leg.physical(), q), compute_uv=False)[:, -1]
