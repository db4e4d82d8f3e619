"""Functions for programs and notebooks: read a run, evaluate, plot and play it.

A notebook displays their results. `humanoid_mjx.start()` sets up the process as the commands do.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from humanoid_mjx.api import Policy, Trained
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, in_world, on_native, with_config
from humanoid_mjx.report.web import MEDIA, data_address
from humanoid_mjx.runs.folder import read_config
from humanoid_mjx.runs.statistics import Evaluation
from humanoid_mjx.spec import check_folder
from humanoid_mjx.training.progress import Reporter
from humanoid_mjx.training.sweep import Run


class Picture(NamedTuple):
    """A figure or film on disk, which a notebook displays."""

    path: Path
    words: str
    """Sentences about what it shows."""

    def _repr_html_(self) -> str:
        data = data_address(self.path.read_bytes(), MEDIA[self.path.suffix])
        if MEDIA[self.path.suffix].startswith("video"):
            return f'<video src="{data}" autoplay loop muted></video><p>{self.words}</p>'
        return f'<img src="{data}" style="max-width: 100%"><p>{self.words}</p>'


def load_run(path: Path | str) -> Run:
    """Return the run in a folder that a sweep has written.

    Raises:
      InputError: this is no run folder.
    """
    read_config(_folder(path))
    return Run(_folder(path))


def draw(run: Run | Path | str) -> list[Picture]:
    """Draw the figures that the command `sweep` draws into the run's `figures/`: learning curves, and swept values.

    Raises:
      InputError: this is no run folder.
    """
    from humanoid_mjx.report.figures import draw_run  # matplotlib takes a while

    run = load_run(_folder(run))
    return [Picture(path, "") for path in draw_run(run, run.summary)[1]]


def evaluate(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    *,
    point: int | None = None,
    episodes: int = 1024,
    physics: str | None = None,
    overrides: Sequence[str] = (),
) -> dict[str, Evaluation]:
    """Evaluate a policy on held-out episodes.

    Args:
      what: a run or its folder, a policy file, the name of a shipped policy, or what `train` returns.
      point: the point of a run's sweep; by default the best.
      episodes: how many each agent plays.
      physics: another physics than that of training, such as `mujoco`.
      overrides: changes of the task, such as "task.friction=0.5".

    Returns:
      the evaluations of the `greedy` policy and of the `zero` and the `random` agent.

    Raises:
      InputError: there is no such policy, or it cannot be used so.
    """
    from humanoid_mjx.evaluation.evaluate import evaluate_all

    return {each.agent: each for each in evaluate_all([_policy(what, point, physics, overrides)], episodes)}


def plot(
    *runs: Run | Path | str, x: str | None = None, y: str = "success", by: str | None = None, out: Path | None = None
) -> Picture:
    """Draw any column of the tables of runs over any other: lines with their 95 % interval over seeds.

    Args:
      runs: runs or their folders.
      x: the column across; by default the episodes or steps trained.
      y: the column upwards; `learned` draws the table of the best run instead.
      by: the column that has a line for each value; `run` for each run. By default what is swept, if that is one.
      out: a .png; by default in the figures of the first run.

    Raises:
      InputError: no run, or a column that is not there or cannot be drawn.
    """
    from humanoid_mjx.report import plotting

    path, notes = plotting.plot([_folder(run) for run in runs], x, y, by, out)
    return Picture(path, " ".join(notes))


def play(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    *,
    point: int | None = None,
    episode: int = 0,
    physics: str | None = None,
    overrides: Sequence[str] = (),
    out: Path | str | None = None,
) -> Picture:
    """Write a film of a held-out episode.

    Args:
      what, point, overrides: as `evaluate` takes them.
      episode: its number.
      physics: by default native MuJoCo where the task can, as the command's.
      out: a .gif, .mp4, .webm or .png; by default `figures/play.gif` of the run, or `NAME.gif`.

    Raises:
      InputError: there is no such policy, or its task moves no robot.
    """
    from humanoid_mjx.training.progress import reporting

    with reporting() as reporter:
        return film(what, reporter, point, episode, physics, overrides, out)


def film(
    what: Run | StoredPolicy | Policy | Trained | Path | str,
    reporter: Reporter,
    point: int | None,
    episode: int,
    physics: str | None,
    overrides: Sequence[str],
    out: Path | str | None,
    **look: Any,
) -> Picture:
    """Write a film as `play` does; `look` is the rate and the size of its pictures, as `render_film` takes them."""
    from humanoid_mjx.evaluation.film import show
    from humanoid_mjx.report.rendering import render_film

    trained = _policy(what, point, physics, overrides)
    trained = trained if physics else on_native(trained)
    (shown, outcome), target = show(trained, reporter, episode), Path(out or f"{trained.name}.gif")
    if out is None and isinstance(what, (Run, Path, str)) and _folder(what).is_dir():
        target = _folder(what) / "figures" / "play.gif"
        target.parent.mkdir(exist_ok=True)
        check_folder(target)
    reporter.phase("rendering")
    render_film(shown, target, tell=reporter.count, **look)
    return Picture(target, outcome)


def _policy(what: Any, point: int | None, physics: str | None, overrides: Sequence[str]) -> StoredPolicy:
    what = what.policy if isinstance(what, Trained) else what.path if isinstance(what, Run) else what
    if isinstance(what, Policy):
        what = with_config(what.learner, what.weights)
    return in_world(what if isinstance(what, StoredPolicy) else find_policy(what, point, overrides), physics, overrides)


def _folder(what: object) -> Path:
    return what.path if isinstance(what, Run) else Path(str(what))
