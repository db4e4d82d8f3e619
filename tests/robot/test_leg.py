"""The leg's numbers: against each other, against the golden file, and what no leg can have is refused."""

import numpy as np
import pytest
from leg_reference import GOLDEN

from humanoid_mjx import InputError, Leg
from humanoid_mjx.robot.leg import corrected_inertias, cylinder_inertias, script_inertias
from humanoid_mjx.thesis import leg as thesis


def test_lengths_are_those_of_table_3_1_at_one_to_four():
    body = thesis.BODY_MM
    assert thesis.LINK_LENGTHS[0] == pytest.approx(body["torso_length"] / 2 * thesis.SCALE / 1000)
    assert thesis.LINK_LENGTHS[4] == pytest.approx(body["lower_leg_height"] * thesis.SCALE / 1000)


def test_singularity_polynomials_confirm_the_lengths():
    """The coefficients of (4.22) and (4.23), printed to six places."""
    _, l2, l3, l4, l5 = thesis.LINK_LENGTHS
    products = (l2 * l4 * l5, l3 * l4 * l5, l4 * l5**2, l4**2 * l5)
    np.testing.assert_allclose(products, (0.000353, 0.000353, 0.000839, 0.000821), atol=1e-6)


def test_printed_inertias_agree_with_tables_4_3_and_4_4():
    inertia = np.array(thesis.PSEUDO_INERTIAS)
    np.testing.assert_array_equal(inertia[:, 3, 3], thesis.LINK_MASSES)
    first = np.array(thesis.LINK_MASSES)[:, None] * np.array(thesis.LINK_CENTROIDS)
    # Table 4.4 is rounded to two or three digits: 6.6 % of the largest component of a link at worst.
    np.testing.assert_allclose(inertia[:, :3, 3], first, atol=0.07 * np.abs(first).max())


def test_parameter_sets_are_the_golden_ones():
    fit, script = GOLDEN["params_thesis_fit"], GOLDEN["params_script"]
    np.testing.assert_allclose(corrected_inertias(), fit["I_corrected"], rtol=0, atol=1e-15)
    np.testing.assert_allclose(script_inertias(), script["I"], rtol=0, atol=1e-15)
    assert list(thesis.LINK_LENGTHS) == fit["l"] and list(thesis.SCRIPT_LENGTHS) == script["l"]
    assert list(thesis.FIGURE_7_5_MASSES) == GOLDEN["fig75_gravity_model"]["m"]
    for make in (Leg.physical, Leg.thesis, Leg.matlab_script, Leg.figure_7_5):
        assert np.linalg.eigvalsh(make().pseudo_inertia).min() > -1e-9


def test_printed_inertias_are_refused_and_the_corrections_are_what_mends_them():
    printed = np.array(thesis.PSEUDO_INERTIAS)
    with pytest.raises(InputError, match="pseudo_inertia of link 1 must be positive semi-definite"):
        Leg.from_links(thesis.LINK_LENGTHS, printed)
    changed = {(link, *sorted(place)) for link, place, _ in thesis.INERTIA_CORRECTIONS}
    second = np.abs(corrected_inertias() - printed)[:, :3, :3] > 1e-12
    found = {(link + 1, *sorted((row + 1, column + 1))) for link, row, column in np.argwhere(second)}
    assert found == changed


def test_cylinders_lie_between_the_frames():
    inertia = cylinder_inertias()
    centres = inertia[:, :3, 3] / inertia[:, 3, 3, None]
    halves = np.array(thesis.LINK_LENGTHS) / 2
    expected = np.zeros((5, 3))
    expected[0, 1], expected[1, 1], expected[2:, 0] = -halves[0], halves[1], -halves[2:]
    np.testing.assert_allclose(centres, expected, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lengths": (0.1, 0.1, 0.1, 0.1)}, "lengths must be five positive numbers"),
        ({"lengths": (0.1, 0.1, -0.1, 0.1, 0.1)}, "lengths must be five positive numbers"),
        ({"pseudo_inertia": np.zeros((4, 4, 4))}, r"pseudo_inertia must have the shape \(5, 4, 4\)"),
        ({"pseudo_inertia": np.full((5, 4, 4), np.nan)}, "pseudo_inertia must be finite"),
        ({"gravity": (0.0, -9.81)}, r"gravity must have the shape \(3,\)"),
    ],
)
def test_what_no_leg_has_is_refused(change, words):
    values = {"lengths": thesis.LINK_LENGTHS, "pseudo_inertia": cylinder_inertias()} | change
    with pytest.raises(InputError, match=words):
        Leg.from_links(**values)


def test_a_chain_without_a_last_mass_carries_nothing():
    rods = np.array(Leg.physical().pseudo_inertia)
    rods[-1] = 0.0
    with pytest.raises(InputError, match="must have a mass"):
        Leg.from_links(thesis.LINK_LENGTHS, rods).carrying(0.1)
