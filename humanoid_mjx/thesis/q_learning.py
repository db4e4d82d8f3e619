"""Chapter 6 and sections 7 E to 7 H: the numbers of the Q-learning posture controller."""

JOINT_RANGES = {1: (-15.0, 100.0), 4: (0.0, 120.0), 5: (-20.0, 40.0)}
"""Start and goal in degrees of each joint that learns (sections 7 E, 7 F, 7 G)."""

POSTURES = {"6.4": ((-20.0, -10.0, 0.0), (20.0, 15.0, 10.0)), "7H": ((-10.0, 15.0, -20.0), (10.0, 120.0, 0.0))}
"""Start and goal of hip pitch, knee and ankle of the right leg, degrees. 7 H prints -120 for the knee, whose range in
Table 3.2 is 0 to 120: read with that table's sign. It also says that its software started from 0 everywhere."""

REWARD_SCALE = 0.1
"""`R = states * .1` (section 6.3)."""

PSEUDO_CODE = {
    "start": -40.0,
    "goal": 0.0,
    "states": 10,
    "action": 1.0,
    "bonus": 100.0,
    "success_rate": 1.0,
    "learning_rate": 0.9,
    "epsilon": 0.6,
    "epsilon_decay": 0.8,
    "discount": 0.9,
    "max_episodes": 50_000,
}
"""The values that the pseudo-code of section 6.3 declares. `epsilon_decay` is declared and never used."""

TABLES = {
    1: ((-1.5, 1.375, 4.25, 7.125, 10.0), (-1.5, 1.375, 4.25, 7.125, 117.91)),
    4: ((0.0, 3.0, 6.0, 9.0, 12.0), (0.0, 3.0, 6.0, 9.0, 121.692)),
    5: ((-2.0, -0.5, 1.0, 2.5, 4.0), (-2.0, -0.5, 1.0, 2.5, 106.564)),
}
"""Tables 7.1, 7.2, 7.3: the columns of Q for staying and for moving, by joint (their heads say "State", "Action")."""

TABLES_STATES = 5
"""Rows of the tables 7.1 to 7.3; the text of section 6.3 says 10."""

TABLES_LEARNING_RATE = 0.99
"""Recovered: the learning rate that gives every printed digit of Tables 7.1 to 7.3. The text says .90."""

FIGURES_ACTION = 5.0
"""Recovered: the step in degrees at which the marks below lie on the grid of positions. The text says 1."""

FIGURE_MARKS = {
    1: (((4, 6), 0.0), ((45, 49), 75.0)),
    4: (((7, 12), 25.0), ((54, 60), 110.0)),
    5: (((4, 9), -10.0), ((16, 18), 15.0)),
}
"""Statements of the text on Figures 7.11, 7.13, 7.15: ((first, last episode), angle in degrees), by joint."""

AVERAGE_RANDOM_NUMBER = {1: 0.456301, 4: 0.493718, 5: 0.526571}
"""The "average random number" of Figures 7.12, 7.14, 7.16, by joint."""
