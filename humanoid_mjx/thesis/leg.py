"""Chapters 3, 4, 5 and 7: the numbers of the leg. Lengths in metres, masses in kilograms, angles in degrees.

Joints count from the hip: 1 pitch, 2 yaw, 3 roll (the torso's joints of the tables), 4 knee pitch, 5 ankle pitch.
"""

JOINT_NAMES = ("hip_pitch", "hip_yaw", "hip_roll", "knee_pitch", "ankle_pitch")

BODY_MM = {
    "foot_length": 240.0,
    "foot_width": 90.0,
    "foot_height": 100.0,
    "lower_leg_height": 380.0,
    "lower_leg_circumference": 370.0,
    "upper_leg_height": 380.0,
    "upper_leg_circumference": 480.0,
    "torso_length": 330.0,
    "torso_width": 150.0,
}
"""Table 3.1, in millimetres. The two it calls diameters can only be circumferences: a leg 380 mm long and 480 mm thick
is none. The model is built at 1:4 (`SCALE`)."""

SCALE = 0.25
"""Recovered: the lengths that reproduce chapter 7 are those of Table 3.1 at 1:4 (330/2/4 = 41.25, 380/4 = 95)."""

JOINT_RANGES = {
    "human": ((-15.0, 130.0), (-45.0, 50.0), (-30.0, 45.0), (-10.0, 155.0), (-20.0, 50.0)),
    "proposed": ((-15.0, 100.0), (-45.0, 45.0), (0.0, 45.0), (0.0, 120.0), (-20.0, 40.0)),
}
"""Table 3.2, its two columns."""

DH_THETA_OFFSETS = (0.0, 90.0, -90.0, 0.0, 0.0)
DH_ALPHAS = (90.0, -90.0, 90.0, 0.0, 0.0)
"""Table 4.1. Its offsets d are (l1, l2, 0, 0, 0) and its lengths a are (0, 0, l3, l4, l5)."""

LINK_LENGTHS = (0.04125, 0.040, 0.040, 0.093, 0.095)
"""Recovered, printed nowhere: 15 of the 18 numbers of section 7 B fit them to 0.05 mm, the printing's own rounding, and
so do the coefficients of the singularity polynomials (4.22, 4.23) and the start torques of Figure 7.5."""

LINK_MASSES = (0.142, 0.04319, 0.026, 0.06733, 0.066)
"""Table 4.3."""

LINK_CENTROIDS = (
    (-0.032, 0.01, 0.0),
    (-0.121, 0.067, 0.015),
    (0.00982, -0.041, -0.074),
    (0.012, 0.052, 0.052),
    (0.013, 0.060, 0.047),
)
"""Table 4.4. They lie outside the links in the DH frames (the yaw link is 40 mm long, its centroid 139 mm away)."""

PSEUDO_INERTIAS = (
    (
        (-0.0003276, -0.0000484, -0.000000000003, -0.00459),
        (-0.0000484, 0.0000614, 0.0000000002, 0.00152),
        (-0.000000000003, 0.0000000002, 0.0000436, 0.0),
        (-0.00459, 0.00152, 0.0, 0.142),
    ),
    (
        (0.000643, -0.000355, -0.00078, -0.0053),
        (-0.000355, 0.0002031, 0.0000439, 0.00292),
        (-0.000078, 0.0000439, 0.000013, 0.000647),
        (-0.0053, 0.00292, 0.000647, 0.04319),
    ),
    (
        (0.000032, -0.0000107, -0.0000192, 0.000258),
        (-0.0000107, 0.0000525, 0.0000806, -0.00108),
        (-0.0000192, 0.0000806, 0.000147, -0.00195),
        (0.000258, -0.00108, -0.00195, 0.026),
    ),
    (
        (0.0000130, 0.000044, 0.000044, 0.00084),
        (0.000044, 0.000219, 0.000186, 0.00353),
        (0.000044, 0.000186, 0.000189, 0.00355),
        (0.00084, 0.00353, 0.00355, 0.06733),
    ),
    (
        (0.0000149, 0.000054, 0.0000431, 0.00091),
        (0.0000548, 0.000275, 0.000188, 0.00399),
        (0.0000431, 0.000188, 0.000150, 0.00312),
        (0.00091, 0.00399, 0.00312, 0.066),
    ),
)
"""Section 4.6, as printed: the integrals of r r^T dm with r = [x y z 1]. Links 1 and 2 are no possible bodies, 2 and 5
are not symmetric: `INERTIA_CORRECTIONS`."""

INERTIA_CORRECTIONS = ((1, (1, 1), 0.0003276), (2, (1, 3), -0.000078), (5, (1, 2), 0.0000544))
"""Changes to section 4.6 that make it physical: link, row and column (and its mirror), new value; the reasons stand in
`reproduction/printed/errata.yaml`. Beyond these the last rows and columns become mass x centroid of Tables 4.3 and 4.4,
which they are to rounding: without it link 2 stays impossible."""

SCRIPT_LENGTHS = (0.2, 0.3, 0.1, 0.2, 0.2)
SCRIPT_MASSES = (0.5, 0.3, 0.4, 0.2, 0.2)
"""The MATLAB script at the thesis's end. Its links are thin rods along x of their frames (see `script_inertias`), also
links 1 and 2, which run along y."""

FIGURE_7_5_MASSES = (0.142, 0.0439, 0.04394, 0.067, 0.066)
"""Recovered: each of m2 to m4 solved from a printed start torque of section 7 C comes out round to 1e-9, and the
ankle's torque, with nothing left to solve, agrees to 9 digits. m1 (no torque depends on it) is Table 4.3's."""

FIGURE_7_5_DEGREE = 0.0175
"""Recovered: radians per degree in sections 7 A and 7 C, 3.15/180."""

GRAVITY = 9.81

QUINTIC_S = 5.0
"""Duration of the planned trajectories."""

QUINTIC_RANGES = ((-45.0, 45.0), (-15.0, 100.0), (0.0, 45.0), (0.0, 120.0), (-20.0, 40.0))
"""Equations 4.35 to 4.39: start and end. Joints 1 and 2 have each other's ranges of Table 3.2."""

QUINTIC_COEFFICIENTS = (
    (-45.0, 7.2, -2.16, 0.1728),
    (-15.0, 9.2, -2.76, 0.2208),
    (0.0, 3.6, -1.08, 0.0864),
    (0.0, 9.6, -2.88, 0.2304),
    (-20.0, 4.8, -1.44, 0.1152),
)
"""Equations 4.35 to 4.39: constant, t^3, t^4, t^5, in degrees and seconds."""

GAIT_TIMES_S = (0.0, 0.1333, 0.2667, 0.4, 0.5333, 0.6667, 0.8)

STRAIGHT_WALK = {
    "ankle_pitch": (-7.5, 10.0, 10.0, 5.0, 0.0, -10.0, -7.5),
    "knee_pitch": (10.0, -5.0, 2.5, -10.0, -10.0, 15.0, 10.0),
    "hip_pitch": (-10.0, -7.5, -15.0, 10.0, 15.0, 10.0, -10.0),
}
"""Table 4.5."""

SUDDEN_TURN = STRAIGHT_WALK | {"hip_yaw": (0.0, 5.0, 5.0, 5.0, 5.0, 5.0, 0.0)}
"""Table 4.6."""

STALL_TORQUES = (0.0, 0.0, -0.13748, 0.0, 0.0)
"""Table 4.2, N m."""

MAX_TORQUES = (0.0112, 0.0299, 0.2756, 0.0540, 0.0413)
"""Table 4.7, N m."""

KP = (65.0, 68.0, 72.0, 65.0, 70.0)
KD = (32.0, 30.0, 34.0, 38.0, 34.0)
"""Table 5.1."""

SCRIPT_FORCE = (0.0, 0.0, -10.0)
"""The MATLAB script's force at the toe, N."""

FIGURE_7_1 = ((-0.7875, 0.7875), (-0.2625, 1.75), (0.0, 0.7875), (0.0, 2.1), (-0.35, 0.7))
"""Section 7 A: where the planned trajectories start and end, rad. The start of joint 3 is missing; 0 is meant."""

WORKSPACE = {
    "straight walking": ((-0.1625, -0.2084, 0.0413), (-0.0257, -0.1021, 0.0413)),
    "sudden turn": ((-0.1633, -0.2076, 0.0328), (-0.0256, 0.0533, -0.0701)),
    "all joints": ((-0.1633, -0.2076, 0.0328), (0.0414, 0.0806, -0.0583)),
}
"""Section 7 B, metres: "the reach varies from ... to ...". They are the toe's positions at the start and at the end of
the quintics of the joints that move (`WORKSPACE_JOINTS`), not extents."""

STRAIGHT_WALK_END = (45.0, 0.0, 0.0, 45.0, 120.0)
"""Recovered, degrees: the posture of section 7 B's straight walking at its end. The knee ends where joint 3 should and
the ankle where the knee should, as if that simulation were wired wrongly; planned were (45, 0, 0, 120, 40)."""

WORKSPACE_JOINTS = {"straight walking": (1, 4, 5), "sudden turn": (1, 2, 4, 5), "all joints": (1, 2, 3, 4, 5)}

FIGURE_7_5 = {
    "start": (0.0, -0.056275024, 0.272241706, 0.054035874, 0.020501987),
    "end": (-0.000181195, 0.029943409, -0.017557993, -0.01030846, 0.04131821),
    "maximum": (0.011248351, 0.029943409, 0.275608884, 0.054035874, 0.04131821),
}
"""Section 7 C, N m."""

TRACKING = {"end": (0.7875, 1.3, 0.781, 1.92, 0.562), "error": (0.0, 0.02, 0.006, 0.18, 0.138)}
"""Section 7 D, Figures 7.6 to 7.10: where the joints are after 5 s, and how far from their targets, rad. Joint 1 "is
achieved". The two contradict each other in joint 2, whose target is 1.75 (`FIGURE_7_1`)."""
