"""Tables 7.1 to 7.3: what the table of Q holds when a joint has reached its goal by the pseudo-code of section 6.3."""

from functools import partial

import numpy as np

from humanoid_mjx.reproduction.findings import Experiment, Finding, Setting, check, in_words
from humanoid_mjx.thesis import q_learning as thesis

TOLERANCE = 5e-4
"""Half of the last digit of the tables' longest numbers."""

PRINTED = thesis.PSEUDO_CODE

CONFIG = {
    "task": {"action": PRINTED["action"], "states": thesis.TABLES_STATES, "bonus": PRINTED["bonus"]},
    "learner": {
        "epsilon": PRINTED["epsilon"],
        "learning_rate": thesis.TABLES_LEARNING_RATE,
        "discount": PRINTED["discount"],
    },
}


def q_table(joint: int, setting: Setting) -> list[Finding]:
    from humanoid_mjx.reproduction.traces import printed_run

    run = printed_run(joint, setting.config, runs=16, steps=2000)
    reached = run.q_table[run.terminated.any(axis=1)]
    printed = np.array(thesis.TABLES[joint]).T
    comparable = len(reached) > 0 and reached.shape[1:] == printed.shape
    error = float(np.abs(reached - printed).max()) if comparable else float("inf")
    used = setting.config["task"] | setting.config["learner"]
    return [
        check(
            "Q after the goal: for each row, staying and moving",
            printed.tolist(),
            np.round(reached[0].astype(float), 4).tolist() if len(reached) else None,
            error <= TOLERANCE,
            f"{in_words(used, PRINTED)}; {len(reached)} of {len(run.terminated)} runs reached the goal, "
            + (f"the largest difference of any run is {error:.2g}" if comparable else "the table has another shape"),
            TOLERANCE,
            (used, PRINTED),
        )
    ]


EXPERIMENTS = [
    Experiment(f"table-7.{number}", f"Q after learning of joint {joint}", partial(q_table, joint), CONFIG)
    for number, joint in enumerate((1, 4, 5), start=1)
]
