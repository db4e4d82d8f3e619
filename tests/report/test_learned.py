"""What a table has learned: its stages are those of shorter trainings, its way is that of its greedy moves."""

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import told
from PIL import Image
from small_sweep import CONFIG

from humanoid_mjx import InputError, sweep, train
from humanoid_mjx.evaluation.policy import find_policy
from humanoid_mjx.report.learned import FRAMES, best, greedy_way, learned, repeated
from humanoid_mjx.report.page import run_page
from humanoid_mjx.tasks.navigate import shortest_path
from humanoid_mjx.training.program import run_key
from humanoid_mjx.training.progress import Reporter

ROOM = ("S.#.", "....", ".#.G")
ROOM_CONFIG = CONFIG | {
    "task": {"name": "navigate", "map": list(ROOM), "step_reward": -1, "bonus": 0, "max_episode_steps": 40},
    "learner": {"name": "tabular_q", "epsilon": 0.2},
    "sweep": {"axes": {"learner.learning_rate": [0.5, 1.0]}},
    "episodes": 80,
}


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    return sweep(ROOM_CONFIG, tmp_path_factory.mktemp("learned") / "room").path


def drawn(path):
    words, panels = learned(find_policy(path))
    return words, [each.title for each in panels]


@pytest.mark.parametrize("method", ["q_learning", "n_step"])
def test_stages_are_the_tables_of_shorter_trainings(tmp_path, method):
    learner = {"name": "tabular_q", "method": method, "epsilon_decay": 0.95}
    run = sweep(CONFIG | {"learner": learner, "sweep": None, "record": 1}, tmp_path / "run")
    trained = find_policy(str(run.path))
    stages = repeated(trained)
    assert stages is not None
    assert stages.episodes[0] == 1 and stages.episodes[-1] == CONFIG["episodes"]
    key = run_key(jnp.uint32(CONFIG["seed"]), jnp.uint32(trained.seed))
    for episodes, table, visits in zip(*stages, strict=True):
        alone = train(trained.learner.replace(episodes=episodes, record=1), key)
        np.testing.assert_allclose(table, np.asarray(alone.policy.weights), rtol=1e-5, atol=1e-5)
        # The goal's row is never moved from, and every move of an episode is made somewhere.
        assert visits[-1] == 0 and visits.sum() == pytest.approx(episodes * float(alone.curve["steps"][0]))
    np.testing.assert_allclose(stages.tables[-1], trained.policy, rtol=1e-6)  # another program, which rounds otherwise


def test_a_map_shows_the_way_along_the_training(room):
    stages = repeated(find_policy(str(room)))
    assert stages is not None
    way = greedy_way(ROOM, stages.tables[-1])
    assert "".join(ROOM)[way[-1]] == "G" and len(way) - 1 == shortest_path(ROOM)
    words, titles = drawn(room)
    assert "Orange: the way" in words
    assert titles == [*stages.words, "visits: moves made in each cell"] and titles[0] == "after 1 episode"


def test_a_way_ends_where_it_would_go_in_circles():
    table = np.zeros((12, 4))
    table[0, 1] = table[1, 3] = 1.0  # S sends to the right, where it is sent back
    assert greedy_way(ROOM, table) == [0, 1]


def test_only_an_action_that_is_better_than_all_others_is_best():
    table = np.array([[1.0, 1.0], [0.0, 2.0], [np.nan, np.nan]])
    assert best(table).tolist() == [[False, False], [False, True], [False, False]]


def test_plot_and_report_draw_it(room, tmp_path):
    out = tmp_path / "x.png"
    assert "Arrows: the best move." in told("plot", room, "--y", "learned", "--out", out) and out.stat().st_size
    film = tmp_path / "x.gif"
    told("plot", room, "--y", "learned", "--out", film)
    with Image.open(film) as frames:
        assert 10 < frames.n_frames <= FRAMES and frames.size[0] > 300
    with pytest.raises(InputError, match=r"must end in \.png, or \.gif, \.mp4, \.webm for a film of the training"):
        told("plot", room, "--y", "learned", "--out", tmp_path / "x.pdf")
    with pytest.raises(InputError, match=r"x\.gif: the file must end in \.png\.$"):
        told("plot", room, "--out", film)
    with pytest.raises(InputError, match="no"):
        told("plot", room, "--y", "learned", "--out", tmp_path / "no" / "x.gif")
    html = run_page(room, Reporter(), motion=False)
    assert "What was learned" in html and "Visits: moves made in each cell" in html


def test_a_training_that_cannot_be_repeated_shows_its_end(room, monkeypatch):
    monkeypatch.setattr("humanoid_mjx.report.learned.MOST_MOVES", 10)
    words, titles = drawn(room)
    assert "its training cannot be repeated here" in words and titles == ["after 80 episodes"]


def test_what_has_no_table_is_refused(room):
    with pytest.raises(InputError, match="walk: deep_q has no table to draw; choose a run of tabular_q"):
        learned(find_policy("walk"))
    with pytest.raises(InputError, match="leave out the other runs"):
        told("plot", room, room, "--y", "learned")
