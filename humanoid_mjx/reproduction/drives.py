"""Sections 5.3, 5.4 and 4.9: what a gear makes of the leg's dynamics, and which gears a motor needs."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from humanoid_mjx.control import Reference, implicit_euler, servo
from humanoid_mjx.control.drives import DcMotor
from humanoid_mjx.mechanics.dynamics import inverse_dynamics, joint_inertias
from humanoid_mjx.mechanics.trajectories import thesis_quintics
from humanoid_mjx.reproduction import motor_sizing
from humanoid_mjx.reproduction.findings import Finding, Setting, check, experiment, listed, three_digits, unprinted
from humanoid_mjx.reproduction.leg_values import errors_along, over, planned
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

GEARS = np.array([1.0, 3.0, 10.0, 30.0, 100.0, 300.0])

HIGH, SHOWN = GEARS[GEARS >= 10.0], 100.0
"""Gear ratios far above 1, and the one at which shares are told."""

ROTORS = np.array([1e-8, 1e-7, 1e-6, 1e-5])
"""Rotor inertias that are tried, kg m^2: from motors of a few grams to one that weighs more than the leg."""

TRACKS, STEP_S = np.radians(1.0), 1e-3
"""Largest error of a good trajectory tracking, rad; step of the simulation, s."""

MOTOR = {"torque_constant": 0.0136, "resistance": 7.0, "friction": 1e-6, "max_voltage": 12.0}
"""N m/A, ohm, N m s/rad and V: a DC motor of about 25 mm. Nothing is printed of the motors but their maker
(8.1)."""


@experiment("motors-5.3", "Gear and motor", {"motor": MOTOR})
def motors(setting: Setting) -> list[Finding]:
    """Sections 5.3, 5.4 and 4.9: what a gear makes of the leg's dynamics, and which gears a motor needs."""
    motion, config = _planned_motion(), setting.config["motor"]
    shares = {rotor: interaction_shares(motion, rotor, config["friction"]) for rotor in ROTORS}
    varies = {rotor: inertia_variation(motion["inertia"], rotor) for rotor in ROTORS}
    mean, reflected = motion["inertia"].mean(axis=0), HIGH**2 * ROTORS[:, None]
    errors = tracking_errors(reflected.ravel(), mean).max(axis=1).reshape(reflected.shape)
    shown, tried = list(GEARS).index(SHOWN), "nothing is printed of the rotor; the motion is the planned one"
    share = f"share of d of (5.17), the interaction, in the motor's torque at a gear of {SHOWN:g}, by rotor and joint"
    slow = f"root mean squares, gravity along the leg: {tried}. Slow motions leave little to inertia, and d has the "
    slow += "weight"
    inertia = f"share by which I_eff of (5.20) varies at a gear of {SHOWN:g}, by rotor and joint"
    most = f"from the least to the largest inertia: {tried}. Without a gear it varies by a factor of up to "
    most += f"{1 + varies[ROTORS[0]][0].max():.1f}"
    return [
        unprinted(share, _by_rotor({rotor: values[shown] for rotor, values in shares.items()}), slow),
        unprinted(inertia, _by_rotor({rotor: values[shown] for rotor, values in varies.items()}), most),
        judge_tracking(errors),
        _selection(motion, config),
    ]


def judge_tracking(errors: np.ndarray) -> Finding:
    """The finding on section 5.3's claim that a highly geared joint tracks well though its controller ignores d.

    No rotor and no gear is printed, so there is a verdict only where it is the same for all of them.

    Args:
      errors: (rotors, gears) Largest errors of the worst joint, rad, by `ROTORS` and `HIGH`.
    """
    tracks = errors <= TRACKS
    quantity = f"largest error of the planned motion without d, rad, by rotor and gears of {listed(HIGH)}"
    found = _by_rotor(dict(zip(ROTORS, errors, strict=True)))
    why = "worst joint, each alone under Table 5.1's gains and the mean of its I_eff, the leg as it is, gravity along "
    why += f"it; of {tracks.size} rotors and gears {tracks.sum()} track within a degree. What counts is the inertia "
    why += "that the rotor adds to the joint, gear ratio^2 times its own"
    if tracks.any() and not tracks.all():
        return unprinted(quantity, found, f"{why}: the claim (5.3) holds or fails with values that are not printed")
    return check(quantity, "a good trajectory tracking performance (5.3)", found, tracks.all(), why, float(TRACKS))


def tracking_errors(reflected: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(n, 5) Largest errors, rad, of joints that ignore d, by the inertia that the rotors add; infinite if unstable.

    Args:
      reflected: (n,) inertias that the rotors add to each joint, kg m^2.
      inertia: (5,) the controllers' constant inertias of the links, kg m^2.
    """
    leg, kp, kd = Leg.physical(), jnp.array(thesis.KP), jnp.array(thesis.KD)

    def simulate(added: Any, start: Any) -> Any:
        def act(plan: Reference, qpos: Any, qvel: Any) -> Any:
            return (inertia + added) * servo(kp, kd, plan, qpos, qvel)

        free = implicit_euler(jnp.zeros(5), jnp.zeros(5), armature=added)
        return jnp.abs(errors_along(leg, act, start, STEP_S, free)).max(axis=0)

    starts = jnp.tile(thesis_quintics().at(0.0).position, (len(reflected), 1))
    found = np.asarray(jax.jit(jax.vmap(simulate))(jnp.asarray(reflected, float), starts), float)
    return np.nan_to_num(found, nan=np.inf)


def interaction_shares(motion: dict[str, np.ndarray], rotor_inertia: float, friction: float) -> np.ndarray:
    """(gears, 5) Root mean square of d / eta over that of the motor's torque of (5.19)."""
    own = motion["inertia"] * motion["qacc"]
    d = motion["torque"] - own
    shares = []
    for gear in GEARS:
        total = gear * (rotor_inertia * motion["qacc"] + friction * motion["qvel"]) + motion["torque"] / gear
        shares.append(np.sqrt(np.mean((d / gear) ** 2, axis=0) / np.mean(total**2, axis=0)))
    return np.array(shares)


def inertia_variation(inertia: np.ndarray, rotor_inertia: float) -> np.ndarray:
    """(gears, 5) Share by which the largest I_eff is larger than the least."""
    effective = rotor_inertia + inertia / GEARS[:, None, None] ** 2
    return effective.max(axis=1) / effective.min(axis=1) - 1


def _by_rotor(values: Mapping[float, np.ndarray]) -> dict[str, list[float]]:
    return {f"{rotor:g} kg m^2": three_digits(np.minimum(found, 1e9)) for rotor, found in values.items()}


def _selection(motion: dict[str, np.ndarray], config: dict[str, float]) -> Finding:
    """The gears with which the motor of the config can do the planned motion and hold the squat."""
    load, deepest = (motor_sizing.CONFIG[key][of] for key, of in (("load", "torso"), ("squat", "knee")))
    squat = motor_sizing.squat(load, 2, deepest)
    gears = np.geomspace(1.0, 10_000.0, 401)
    swings = _able(config, gears, motion["torque"], motion["qvel"])
    holds = _able(config, gears, squat.torque, np.zeros_like(squat.torque))
    knee = _span(gears, swings[:, 3] & holds[:, 3])
    quantity = "gears with which one small motor does the planned motion, by joint: from and to"
    why = "nothing is printed of the motors but Table 4.7 and that they were too weak (8.1); this one has "
    why += f"{config['max_voltage']:g} V, {config['torque_constant']:g} N m/A and {config['resistance']:g} ohm. To "
    why += f"hold a squat of {deepest:g} degrees on two legs as well its gear at the knee must be "
    why += f"{' to '.join(f'{x:g}' for x in knee) or 'none'}"
    return unprinted(quantity, [_span(gears, able) for able in swings.T], why)


def _able(config: dict[str, float], gears: np.ndarray, torque: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """(gears, 5) True where the driver's voltage suffices for torques at speeds, (times, 5) (5.21 to 5.24)."""
    values: dict[str, Any] = {name: value for name, value in config.items() if name != "max_voltage"}
    motor = DcMotor(**values).replace(gear=gears[:, None, None])
    voltage = np.asarray(motor.voltage_for(jnp.asarray(torque), jnp.asarray(qvel)))
    return np.abs(voltage).max(axis=1) <= config["max_voltage"]


def _span(gears: np.ndarray, able: np.ndarray) -> list[float]:
    chosen = gears[able]
    return [three_digits(chosen[0]), three_digits(chosen[-1])] if len(chosen) else []


def _planned_motion() -> dict[str, np.ndarray]:
    """(times, 5) each: speeds, accelerations, torques and joint inertias of the planned motion."""
    motion, leg = planned(np.linspace(0.0, thesis.QUINTIC_S, 501)), Leg.physical()
    torque, inertia = over(inverse_dynamics, leg, *motion), over(joint_inertias, leg, motion.position)
    return {"qvel": motion.velocity, "qacc": motion.acceleration, "torque": torque, "inertia": inertia}
