"""The figures of a sweep: what each line is, and that no sweep is drawn as if it were another."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
from small_sweep import of_rows

from humanoid_mjx.report.drawing import CURVES, HEAT_MAPS, draw_band, possible
from humanoid_mjx.report.figures import averaged, curved, draw_curves, draw_greedy, mapped, parameters
from humanoid_mjx.report.parameters import draw_map, draw_parallel, local_mean
from humanoid_mjx.runs.ranking import by_point, compared
from humanoid_mjx.runs.statistics import interval

EPSILON, RATE = np.array([0.1, 0.1, 0.5, 0.5, 0.9, 0.9]), np.array([0.3, 1.0] * 3)
AXES = {"learner.epsilon": EPSILON, "learner.rate": RATE}
SEEDS, RECORD, ORDER = 5, 4, [1, 4, 2, 0, 5, 3]


@pytest.fixture
def panel():
    fig, found = plt.subplots()
    yield found
    plt.close(fig)


def learned(mode="grid"):
    """Six points over two parameters; the order of the points is not that of their curves' means."""
    rng = np.random.default_rng(0)
    point, seed, place = (x.ravel() for x in np.indices((6, SEEDS, RECORD)))
    rows = {"point": point, "seed": seed, "episode": 10 * (place + 1)}
    rows |= {name: values[point] for name, values in AXES.items()} | {"steps": rng.uniform(20, 30, len(point))}
    summary = {name: values[place == 0] for name, values in rows.items()}
    summary |= {"greedy_success": rng.uniform(size=6 * SEEDS), "greedy_steps": rng.uniform(5, 9, 6 * SEEDS)}
    told = {"finals": lambda name: by_point(summary, name)[1] if name in summary else None}
    told["compared"] = compared(mode, list(AXES), summary, quickest=True)
    return dataclasses.replace(of_rows(rows, list(AXES), mode, ORDER), **told)


def test_a_value_has_its_best_setting_and_the_mean_over_all(panel):
    learning = learned()
    draw_curves(learning, "steps", panel, "learner.epsilon")
    curves, lines = learning.read("steps"), panel.lines
    dashed, solid = ([line for line in lines if line.get_linestyle() == style] for style in ("--", "-"))
    for of, (mine, best), mean in zip(solid, (([0, 1], 1), ([2, 3], 2), ([4, 5], 4)), dashed, strict=True):
        np.testing.assert_allclose(of.get_ydata(), np.median(curves[best], axis=0))
        np.testing.assert_allclose(mean.get_ydata(), np.median(curves[mine].mean(axis=0), axis=0))
        assert of.get_color() == mean.get_color()
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["0.1", "0.5", "0.9"]
    low, high = interval(curves[1])
    box = panel.collections[0].get_paths()[0].get_extents()
    np.testing.assert_allclose([box.y0, box.y1], [low.min(), high.max()])
    assert "best after training" in averaged(learning) and "dashed: the mean" in averaged(learning)


@pytest.mark.parametrize(
    ("measure", "seeds", "ends"),
    [
        # The interval of three seeds reaches 0.813 of their range beyond them.
        ("greedy_steps", [1.0, 9.0, 9.0], [0.0, 15.504]),
        ("greedy_success", [0.2, 0.9, 0.9], [0.0, 1.0]),
        ("greedy_return", [1.0, 9.0, 9.0], [-5.504, 15.504]),
    ],
)
def test_a_band_ends_where_values_are_impossible(panel, measure, seeds, ends):
    within = possible(measure)
    draw_band(panel, np.zeros(1), np.array(seeds)[:, None], "black", joined=False, within=within)
    ((_, low), (_, high)) = panel.containers[0].lines[2][0].get_segments()[0]
    assert [low, high] == pytest.approx(ends)


def test_greedy_episodes_stand_beside_the_curves(panel):
    learning = learned()
    titles = [each.title for each in curved(learning)]
    assert titles == [CURVES["steps"], HEAT_MAPS["greedy_success"]]
    ends = draw_greedy(learning, "greedy_success", panel, "learner.rate")
    success = learning.finals("greedy_success")
    assert ends == pytest.approx({"0.3": np.median(success[4]), "1": np.median(success[1])})


@pytest.mark.parametrize("mode", ["zip", "random"])
def test_points_that_are_no_grid_are_drawn_one_by_one(panel, mode):
    learning = learned(mode)
    draw_curves(learning, "steps", panel, None)
    values = [text.get_text() for text in panel.get_legend().get_texts()]
    order = range(6) if mode == "zip" else ORDER
    assert values == [f"{EPSILON[point]:g}, {RATE[point]:g}" for point in order]
    assert panel.get_legend().get_title().get_text() == "epsilon, rate"
    for line, point in zip(panel.lines, order, strict=True):
        np.testing.assert_allclose(line.get_ydata(), np.median(learning.read("steps")[point], axis=0))
    assert mapped(learning) == [] and "over all" not in averaged(learning)
    titles = [each.title for each in parameters(learning)]
    assert titles[:2] == list(AXES)[: len(titles)] and len(titles) == (0 if mode == "zip" else 4)


def test_parallel_coordinates_have_a_line_for_each_point(panel):
    draw_parallel(learned("random"), panel, None)
    assert len(panel.lines) == 6 and all(0 <= y <= 1 for line in panel.lines for y in line.get_ydata())


def test_a_heat_map_is_of_the_best_setting_or_the_mean(panel):
    learning = learned()
    axes = "learner.epsilon", "learner.rate"
    draw_map(learning, axes, "greedy_steps", (5.0, 9.0), True, panel, None)
    steps, success = (learning.finals(name) for name in ("greedy_steps", "greedy_success"))
    np.testing.assert_allclose(panel.images[-1].get_array(), np.median(steps, axis=1).reshape(3, 2).T)
    draw_map(learning, axes, "greedy_success", (0.0, 1.0), True, panel, None)
    np.testing.assert_allclose(panel.images[-1].get_array(), success.mean(axis=1).reshape(3, 2).T)


def test_a_local_mean_finds_a_line_and_covers_it():
    rng = np.random.default_rng(1)
    x = rng.uniform(size=400)
    low, middle, high = local_mean(x, 2 * x + rng.normal(0.0, 0.3, 400), np.linspace(0.3, 0.7, 9))
    truth = 2 * np.linspace(0.3, 0.7, 9)
    np.testing.assert_allclose(middle, truth, atol=0.15)
    assert ((low <= truth) & (truth <= high)).mean() > 0.5 and (high - low < 0.4).all()
