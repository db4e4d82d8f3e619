"""Sections 5.3, 5.4 and 4.9: what a gear makes of the leg's dynamics, and which gears a motor needs."""

import jax.numpy as jnp
import numpy as np

from humanoid_mjx.control.actuator import Motor
from humanoid_mjx.mechanics.dynamics import inverse_dynamics, joint_inertias
from humanoid_mjx.report.style import COLORS, log_axis
from humanoid_mjx.reproduction import motor_sizing
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, check, listed, three_digits, unprinted
from humanoid_mjx.reproduction.leg_values import NAMES, over, planned
from humanoid_mjx.robot.leg import Leg
from humanoid_mjx.thesis import leg as thesis

GEARS = np.array([1.0, 3.0, 10.0, 30.0, 100.0, 300.0])

SMALL = 0.1
"""Share of the motor's torque that may be ignored."""

STEADY = 0.1
"""Share by which an inertia may vary and count as almost constant."""

MOTOR = {"torque_constant": 0.0136, "resistance": 7.0, "rotor_inertia": 4e-7, "friction": 1e-6, "max_voltage": 12.0}
"""N m/A, ohm, kg m^2, N m s/rad and V: a DC motor of about 25 mm. Nothing is printed of the motors but their maker
(8.1)."""


def motors(setting: Setting) -> list[Finding]:
    """Sections 5.3, 5.4 and 4.9: what a gear makes of the leg's dynamics, and which gears a motor needs."""
    motion = _planned_motion()
    config = setting.config["motor"]
    findings = [*judge_gears(motion, config["rotor_inertia"], config["friction"])]
    _draw_gears(setting, motion, config)
    return [*findings, _selection(motion, config)]


def judge_gears(motion: dict[str, np.ndarray], rotor_inertia: float, friction: float) -> list[Finding]:
    """Findings on section 5.3: a high gear hides the interaction terms and the changes of the inertia."""
    shares = interaction_shares(motion, rotor_inertia, friction)
    varies = inertia_variation(motion["inertia"], rotor_inertia)
    least, bare = [_first_below(shares[:, joint], joint) for joint in range(5)], 1 + varies[0].max()
    hundred = int(np.argmin(np.abs(GEARS - 100.0)))
    shares, varies = shares[hundred], varies[hundred]
    means = "root mean squares over the planned motion, gravity along the leg; the least gear of "
    means += f"{listed(GEARS)} at which the share is below {SMALL:g}: {', '.join(least)}"
    means += f"; with a rotor of {rotor_inertia:g} kg m^2: slow motions leave little to inertia, and d has the weight"
    return [
        check(
            "share of the interaction terms d of (5.17) in the motor's torque at a gear of 100, by joint",
            "reasonable to ignore for gears far above 1",
            three_digits(shares),
            (shares <= SMALL).all(),
            means,
            SMALL,
        ),
        check(
            "share by which I_eff of (5.20) varies over the planned motion, by joint, at a gear of 100",
            "almost constant for highly geared manipulators",
            three_digits(varies),
            (varies <= STEADY).all(),
            f"from the least to the largest inertia; without a gear it varies by a factor of up to {bare:.1f}",
            STEADY,
        ),
    ]


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
    """(gears, 5) By which share the largest I_eff is larger than the least."""
    effective = rotor_inertia + inertia / GEARS[:, None, None] ** 2
    return effective.max(axis=1) / effective.min(axis=1) - 1


def _first_below(shares: np.ndarray, joint: int) -> str:
    low = np.flatnonzero(shares <= SMALL)
    return f"{GEARS[low[0]]:g} ({NAMES[joint]})" if len(low) else f"none ({NAMES[joint]})"


def _selection(motion: dict[str, np.ndarray], config: dict[str, float]) -> Finding:
    """The gears with which the motor of the config can do the planned motion and hold the squat."""
    load, deepest = (motor_sizing.CONFIG[key][of] for key, of in (("load", "torso"), ("squat", "knee")))
    squat = motor_sizing.squat(load, 2, deepest)
    gears = np.geomspace(1.0, 10_000.0, 401)
    swings = _able(config, gears, motion["torque"], motion["qvel"])
    holds = _able(config, gears, squat.torque, np.zeros_like(squat.torque))
    knee = _span(gears, swings[:, 3] & holds[:, 3])
    return unprinted(
        "gears with which one small motor does the planned motion, by joint: from and to",
        [_span(gears, able) for able in swings.T],
        "nothing is printed of the motors but Table 4.7 and that they were too weak (8.1); this one has "
        f"{config['max_voltage']:g} V, {config['torque_constant']:g} N m/A and {config['resistance']:g} ohm. To hold a "
        f"squat of {deepest:g} degrees on two legs as well its gear at the knee must be "
        f"{' to '.join(f'{x:g}' for x in knee) or 'none'}",
    )


def _able(config: dict[str, float], gears: np.ndarray, torque: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """(gears, 5) True where the driver's voltage suffices for torques at speeds, (times, 5) (5.21 to 5.24)."""
    motor = Motor.build(**config, gear_ratio=gears[:, None, None])
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


def _draw_gears(setting: Setting, motion: dict[str, np.ndarray], config: dict[str, float]) -> None:
    shares = interaction_shares(motion, config["rotor_inertia"], config["friction"])
    varies = inertia_variation(motion["inertia"], config["rotor_inertia"])
    with setting.figure(1, 2, size=(4.8, 3.4)) as (_, axes):
        titles = ("Interaction terms in the motor's torque", "Change of I_eff over the planned motion")
        for panel, values, title, limit in zip(axes[0], (shares, varies), titles, (SMALL, STEADY), strict=True):
            for joint in range(5):
                panel.plot(GEARS, values[:, joint], "-o", markersize=3, color=COLORS[joint], label=NAMES[joint])
            panel.axhline(limit, color="0.4", linestyle="--", linewidth=1.0)
            panel.text(GEARS[0], limit, f"small: up to {limit:g}", color="0.4", va="bottom", fontsize=8)
            log_axis(panel)
            log_axis(panel, upright=True)
            panel.set_ylim(bottom=1e-3)
            panel.set(title=title, xlabel="gear ratio (logarithmic)", ylabel="share")
        axes[0, 0].legend(frameon=False)


EXPERIMENTS = [Experiment("motors-5.3", "Gear and motor", motors, {"motor": MOTOR})]
