"""Table 5.1: the gains of the joint controllers, and the damping that they give."""

from typing import Any

import numpy as np

from humanoid_mjx.report.style import COLORS, figure, label_lines
from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, judge
from humanoid_mjx.thesis import leg as thesis

JOINTS = range(5)

CRITICAL = 0.05
"""A damping ratio this near to 1 would be called critical."""


def table(setting: Setting) -> list[Finding]:
    """Table 5.1: the damping that its gains give, which section 5.6 wants critical."""
    import jax.numpy as jnp

    from humanoid_mjx.control.gains import critical_kd, damping_ratio, poles

    kp, kd = jnp.array(thesis.KP), jnp.array(thesis.KD)
    ratios, critical = np.asarray(damping_ratio(kp, kd)), np.asarray(critical_kd(kp))
    slow = np.asarray(poles(kp, kd))[0]
    _draw_responses(setting, np.sqrt(kp), ratios)
    return [
        Finding(
            name="table-5.1",
            quantity=f"damping ratio of joint {joint + 1} (critical by 5.35)",
            printed=1.0,
            reproduced=round(float(ratios[joint]), 3),
            tolerance=CRITICAL,
            verdict=judge(abs(float(ratios[joint]) - 1) < CRITICAL, {}, {}),
            why=f"Kd is {kd[joint]:g}, {kd[joint] / critical[joint]:.2f} times the critical {critical[joint]:.2f}: the "
            f"slow pole is {slow[joint]:.2f} /s, not {-np.sqrt(kp[joint]):.2f} /s",
        )
        for joint in JOINTS
    ]


def _draw_responses(setting: Setting, frequencies: Any, ratios: np.ndarray) -> None:
    import jax.numpy as jnp

    from humanoid_mjx.control.response import step_response

    times = jnp.linspace(0.0, 1.0, 201)
    with figure(setting.out / "table-5.1.png", 1, 1, size=(6.0, 3.4)) as (_, axes):
        panel = axes[0, 0]
        ends = []
        for joint in JOINTS:
            omega, ratio = float(frequencies[joint]), float(ratios[joint])
            ends.append(float(step_response(times, omega, ratio)[-1]))
            panel.plot(times, step_response(times, omega, ratio), color=COLORS[joint])
            panel.plot(times, step_response(times, omega, 1.0), color=COLORS[joint], linestyle=":")
        panel.set_xlim(0, 1)
        panel.set_ylim(0, 1.01)
        label_lines(panel, ends, [f"joint {i + 1}" for i in JOINTS], COLORS[:5])
        panel.set_title("Steps with the gains of Table 5.1 (lines) and critically damped (dots)")
        panel.set_xlabel("time, s")
        panel.set_ylabel("share of the step")


EXPERIMENTS = [Experiment("table-5.1", "Gains of the joint controllers", table)]
