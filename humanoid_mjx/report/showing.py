"""From a policy to its film, with a report of each step."""

from typing import NamedTuple

from humanoid_mjx.evaluation.episode import play, robot_of
from humanoid_mjx.evaluation.film import Film, film_of
from humanoid_mjx.evaluation.policy import Trained
from humanoid_mjx.training.progress import Reporter


class Shown(NamedTuple):
    """A played episode as a film, and how it ended."""

    film: Film
    outcome: str
    """A sentence."""


def show(trained: Trained, reporter: Reporter, episode: int = 0) -> Shown:
    """Play a policy's held-out episode of this number; 0 is the first.

    Raises:
      InputError: the policy's task moves no robot.
    """
    robot_of(trained)
    period: float = trained.learner.task.period  # pyright: ignore[reportAttributeAccessIssue]
    reporter.phase("compiling")

    def tell(decisions: int) -> None:
        reporter.phase("simulating")

    played = play(trained, episode, tell)
    task = trained.config.task["name"]
    name = task if trained.name == task else f"{trained.name}: {task}"
    which = f", episode {episode}" * (episode > 0)
    film = film_of(trained, played, f"{name}, point {trained.point}, seed {trained.seed}{which}")
    decisions = len(played.actions)
    outcome = "succeeds" if played.success else "does not succeed"
    return Shown(
        film,
        f"point {trained.point}, seed {trained.seed}: {outcome} in {decisions} decisions, {decisions * period:g} s; "
        f"return {played.episode_return:.4g}",
    )
