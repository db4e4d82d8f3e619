"""The report of a run folder while its sweep trains: a page that grows, and that the browser loads again and again."""

import threading
import time
import webbrowser
from contextlib import suppress
from datetime import datetime
from pathlib import Path

import numpy as np

from humanoid_mjx.files import write_text
from humanoid_mjx.report.figures import averaged
from humanoid_mjx.report.page import curve_panels, run_page
from humanoid_mjx.report.web import page, section, table, text
from humanoid_mjx.runs.curves import Learning, swept
from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.runs.ranking import BEST_POINTS, short
from humanoid_mjx.training.curves import Curves
from humanoid_mjx.training.pace import time_in_words
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.progress import Reporter, State

MAX_POINTS = 60
"""The most sweep points whose curves are drawn while they grow."""

EVERY_S = 5.0
"""The least time between two drawings, and that after which a browser loads the page again, s."""

DRAWING_SHARE = 0.1
"""The most of the time that drawing may take."""


class Growing(Reporter):
    """The page of a sweep under way, drawn anew by a thread within `with`; and a reporter that passes on to another
    what it is told."""

    curves: Curves
    file: Path

    def __init__(self, reporter: Reporter):
        self.reporter = reporter
        self.state: State | None = None
        self.words = "starting"
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def watch(self, folder: RunFolder, plan: Plan) -> Curves:
        """Begin to draw, and open the page; the curves that it shows (`training.sweep.sweep`)."""
        self.curves, self.file = Curves(folder, plan, MAX_POINTS), folder.path / "report.html"
        self.write()
        self.reporter.note(f"{self.file.resolve().as_uri()}: grows while the sweep trains")
        threading.Thread(target=webbrowser.open, args=(self.file.resolve().as_uri(),), daemon=True).start()
        self._thread.start()
        return self.curves

    def __enter__(self) -> "Growing":
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Leave the report of the run, or where the sweep was stopped the page as it is."""
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()
            self.words = "stopped"
            write_text(self.file, self.html() if kind else run_page(self.file.parent, Reporter(), motion=False))

    def note(self, text: str) -> None:
        self.reporter.note(text)

    def phase(self, text: str) -> None:
        self.words = text
        self.reporter.phase(text)

    def update(self, state: State) -> None:
        self.state = state
        self.reporter.update(state)

    def _run(self) -> None:
        took = 0.0
        with suppress(OSError):  # the folder is gone or full: the sweep itself says so
            while not self._over.wait(max(EVERY_S, took / DRAWING_SHARE)):
                began = time.monotonic()
                self.write()
                took = time.monotonic() - began

    def write(self) -> None:
        """Write the page as it is now."""
        again = f'<meta http-equiv="refresh" content="{EVERY_S:g}"><title>'
        write_text(self.file, self.html().replace("<title>", again, 1))

    def html(self) -> str:
        """The page as it is now."""
        name, learning = self.curves.plan.config.name, learning_so_far(self.curves)
        lead = f'<p class="lead">{text(self._status(), "span")}</p>'
        if learning is None:
            return page(name, lead)
        best = section("Best so far", table(*best_so_far(self.curves)))
        if not learning.names:
            return page(name, lead + best + section("Learning", text("No episode has ended yet.")))
        shown = len(self.curves.points) < len(self.curves.plan.points)
        drawn = f" {len(self.curves.points)} points drawn by chance." if shown else ""
        words = text(f"Lines: {averaged(learning)}.{drawn}")
        return page(name, lead + best + section("Learning", words, *curve_panels(learning)))

    def _status(self) -> str:
        now, state = f"{datetime.now():%H:%M:%S}", self.state
        if state is None:
            return f"{now}: {self.words}"
        left = "" if state.left_s is None else f"; about {time_in_words(state.left_s)} left"
        rate = f" at {state.rate:,.0f} {state.unit} a second" if state.rate else ""
        return f"{now}: {self.words}, {state.done / state.total:.0%} trained{rate}{left}"


def learning_so_far(curves: Curves) -> Learning | None:
    """The curves of the finished runs, or of those under way while none is finished; None while no run has reached a
    record point.

    Record points that a run has not reached are NaN. A measure known at fewer than two of them makes no line and is
    left out.
    """
    measures, known = _measured(curves)
    shown, plan = _shown(known, len(curves.places)), curves.plan
    rows, seeds = (np.flatnonzero(shown.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return None
    reached = shown[..., None] & (np.arange(len(curves.places)) < known[..., None])
    drawn = {name: np.where(reached, values, np.nan)[rows][:, seeds] for name, values in measures.items()}
    drawn = {name: values for name, values in drawn.items() if np.isfinite(values).any(axis=(0, 1)).sum() > 1}
    points, hyper, (mode, axes) = curves.points[rows], plan.table(), swept(plan.config.model_dump(mode="json"))
    order = [int(np.searchsorted(points, int(row[0]))) for row in best_so_far(curves, None)[1]]
    columns = {axis: np.asarray(hyper[axis])[points] for axis in axes}
    names, places = list(drawn), curves.places
    return Learning(mode, columns, plan.unit, places, names, drawn.__getitem__, len(seeds), points.tolist(), order)


def best_so_far(curves: Curves, most: int | None = BEST_POINTS) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of the best points so far, by success, then by steps or by return, as `ranked` judges them.

    A point is judged at the last record point that all of its runs in `learning_so_far` have reached, or the last one
    before it up to which an episode of each has ended.
    """
    plan, (measures, known) = curves.plan, _measured(curves)
    names = [name for name in ("success", "return", "steps") if name in measures]
    shown, rows = _shown(known, len(curves.places)), []
    for index in np.flatnonzero(shown.any(axis=1)).tolist():
        runs = shown[index]
        place = int(known[index, runs].min()) - 1
        means = [measures[name][index, runs, : place + 1].mean(axis=0) for name in names]
        means = [float(next(iter(mean[np.isfinite(mean)][::-1]), np.nan)) for mean in means]
        rows.append((means, int(curves.points[index]), int(runs.sum()), int(curves.places[place])))
    better = {"success": -1.0, **({"return": -1.0} if plan.config.episodes is None else {"steps": 1.0})}
    judged = [(names.index(name), sign) for name, sign in better.items() if name in names]
    rows.sort(key=lambda row: [np.nan_to_num(sign * row[0][place], nan=np.inf) for place, sign in judged])
    cells = [
        [str(point), *map(short, plan.points[point].values()), str(seeds), f"{count:,}"]
        + [short(mean) if np.isfinite(mean) else "" for mean in means]
        for means, point, seeds, count in rows[:most]
    ]
    return ["point", *plan.points[0], "seeds", f"{plan.unit}s trained", *names], cells


def _measured(curves: Curves) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The curves by measure, (points, seeds, record) each, and how many record points each run has reached."""
    with curves.lock:
        known = [each.known for name, each in curves.measures.items() if not name.startswith("greedy_")]
        least = np.min(known, axis=0) if known else np.zeros((len(curves.points), curves.seeds), int)
        return {name: each.curves.copy() for name, each in curves.measures.items()}, least


def _shown(known: np.ndarray, record: int) -> np.ndarray:
    """Flags of the runs that are drawn, from how many record points each has reached: the finished ones, or while none
    is finished those at least half as far as the one ahead. A line is then of the same runs throughout."""
    most = known.max(initial=0)
    return (known > 0) & (known == record if most == record else 2 * known >= most)
