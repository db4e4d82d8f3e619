"""The printed dynamics: letter by letter the script's, and without its faults the verified ones."""

import numpy as np
from leg_reference import GOLDEN, uniform

from humanoid_mjx.reproduction.printed import dynamics
from humanoid_mjx.robot.leg import corrected_inertias, script_inertias
from humanoid_mjx.thesis import leg as thesis

SCRIPT = dynamics.Model(thesis.SCRIPT_LENGTHS, script_inertias(), dynamics.script_centroids(thesis.SCRIPT_LENGTHS))
THESIS = dynamics.Model(thesis.LINK_LENGTHS, corrected_inertias(), np.array(thesis.LINK_CENTROIDS))
MOTION = q, qd, qdd = np.array([[state[key] for state in GOLDEN["states"]] for key in ("q", "qd", "qdd")]).swapaxes(
    1, 2
)


def golden(parameters, block, key):
    return np.moveaxis(np.array([state[parameters][block][key] for state in GOLDEN["states"]]), 0, -1)


def test_all_faults_give_the_script():
    for key, found in {
        "M": dynamics.mass_matrix(SCRIPT, q),
        "H": dynamics.coriolis(SCRIPT, q, qd),
        "G": dynamics.gravity(SCRIPT, q),
        "tau": dynamics.inverse_dynamics(SCRIPT, *MOTION),
    }.items():
        np.testing.assert_allclose(found, golden("script_params", "script", key), rtol=0, atol=1e-12, err_msg=key)


def test_no_fault_gives_the_verified_dynamics():
    upright = THESIS._replace(gravity=(0.0, -thesis.GRAVITY, 0.0))
    for key, found in {
        "M": dynamics.mass_matrix(THESIS, q, ()),
        "H": dynamics.coriolis(THESIS, q, qd, ()),
        "G_minus_z0": dynamics.gravity(THESIS, q),
        "tau_minus_y0": dynamics.inverse_dynamics(upright, *MOTION, ()),
    }.items():
        np.testing.assert_allclose(found, golden("thesis_fit_params", "correct", key), rtol=0, atol=1e-12, err_msg=key)


def test_the_faults_of_the_velocity_term_add_up_and_each_counts():
    parts = [("rule",), ("slips",), ("speeds",)]
    state = np.random.default_rng(0).uniform(-2, 2, (2, 5, 100))
    right = dynamics.coriolis(SCRIPT, *state, ())
    apart = [dynamics.coriolis(SCRIPT, *state, faults) - right for faults in parts]
    assert all(np.abs(change).max() > 0.01 for change in apart)
    both = dynamics.coriolis(SCRIPT, *state, ("rule", "slips")) - right
    np.testing.assert_allclose(apart[0] + apart[1], both, atol=1e-14)


def test_the_rule_as_printed_loses_energy():
    """Power goes into the motion as qd M' qd / 2; the printed rule does not give it."""
    speeds, step = qd, 1e-6
    ahead, behind = (dynamics.mass_matrix(SCRIPT, q + sign * step * speeds, ()) for sign in (1, -1))
    power = np.einsum("ijn,in,jn->n", (ahead - behind) / (2 * step), speeds, speeds) / 2
    right, wrong = (dynamics.coriolis(SCRIPT, q, speeds, faults) for faults in ((), ("rule",)))
    np.testing.assert_allclose((speeds * right).sum(axis=0), power, atol=1e-8)
    assert np.abs((speeds * wrong).sum(axis=0) - power).max() > 0.01


def test_the_script_s_mass_matrix_is_indefinite_in_most_postures():
    postures = uniform(thesis.QUINTIC_RANGES, 500, seed=0).T
    least = [
        np.linalg.eigvalsh(np.moveaxis(dynamics.mass_matrix(SCRIPT, postures, faults), -1, 0))[:, 0]
        for faults in (("M33",), ())
    ]
    assert 0.5 < np.mean(least[0] < 0) < 0.7
    assert least[1].min() > 0
