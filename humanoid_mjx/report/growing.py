"""A page of a sweep that grows while it trains, for the browser of this machine."""

import threading
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import ThreadingHTTPServer
from pathlib import Path

import numpy as np

from humanoid_mjx.report.figures import averaged, figures_of
from humanoid_mjx.report.live import LOOPBACK, Handler
from humanoid_mjx.report.page import curve_panels, run_page
from humanoid_mjx.report.style import short
from humanoid_mjx.report.web import page, section, table, text
from humanoid_mjx.runs.folder import RunFolder
from humanoid_mjx.training.events import Curves
from humanoid_mjx.training.pace import time_in_words
from humanoid_mjx.training.plan import Plan
from humanoid_mjx.training.progress import Reporter, State

MAX_POINTS = 60
"""The most sweep points whose curves are drawn while they grow."""

EVERY_S = 5
"""Seconds after which a browser asks for the page again."""

DRAWING_SHARE = 0.1
"""The most of the time that drawing may take while a browser looks on."""

BEST = 10


class Growing(Reporter):
    """The page of a sweep under way, and a reporter that passes on to another what it is told."""

    def __init__(self) -> None:
        self.reporter = Reporter()
        self.curves: Curves | None = None
        self.state: State | None = None
        self.words = "starting"
        self.report: bytes | None = None
        """The report of the run, once it is over."""
        self._drawn: tuple[float, bytes] | None = None
        """When the page may be drawn anew, and what it is until then."""
        self._lock = threading.Lock()

    def watch(self, folder: RunFolder, plan: Plan) -> Curves:
        """The curves that the page shows (`training.sweep.sweep`)."""
        self.curves = Curves(folder, plan, MAX_POINTS)
        return self.curves

    def finish(self, run: Path) -> None:
        """Show the report of the run from now on."""
        self.report = run_page(run, Reporter(), motion=False).encode()

    def note(self, text: str) -> None:
        self.reporter.note(text)

    def phase(self, text: str) -> None:
        self.words = text
        self.reporter.phase(text)

    def update(self, state: State) -> None:
        self.state = state
        self.reporter.update(state)

    def page(self) -> bytes:
        """The page as it is now, drawn anew where the last one is old."""
        if self.report:
            return self.report
        with self._lock:
            if self._drawn is None or time.monotonic() > self._drawn[0]:
                began = time.monotonic()
                html = self._html().replace("<title>", f'<meta http-equiv="refresh" content="{EVERY_S}"><title>', 1)
                now = time.monotonic()
                self._drawn = now + max(EVERY_S / 2, (now - began) / DRAWING_SHARE), html.encode()
            return self._drawn[1]

    def _html(self) -> str:
        if self.curves is None:
            return page("sweep", text(f"{self.words} ..."))
        config, results = self.curves.plan.config, results_so_far(self.curves)
        lead = f'<p class="lead">{text(self._status(), "span")}</p>'
        if not results:
            return page(config.name, lead)
        axes = list(config.sweep.axes) if config.sweep else []
        shown = len(self.curves.points) < len(self.curves.plan.points)
        drawn = f" {len(self.curves.points)} points drawn by chance." if shown else ""
        own = figures_of(config.task["name"], config.modules)
        best = section("Best so far", table(*best_so_far(self.curves)))
        words = text(f"Lines: {averaged(axes, results)}.{drawn}")
        return page(config.name, lead + best + section("Learning", words, *curve_panels(axes, results, own)))

    def _status(self) -> str:
        if self.state is None:
            return f"{self.words} ..."
        state = self.state
        left = "" if state.left_s is None else f"; about {time_in_words(state.left_s)} left"
        rate = f" at {state.rate:,.0f} {state.unit} a second" if state.rate else ""
        return f"{self.words}: {state.done / state.total:.0%} trained{rate}{left}"


def results_so_far(curves: Curves) -> dict[str, np.ndarray]:
    """The columns of results.parquet of the runs that are over, or while there are none of those under way: NaN where
    nothing is known yet. Empty where nothing is known at all."""
    measures, known = _measured(curves)
    points, seeds = np.nonzero(_shown(known, len(curves.places)))
    if not len(points):
        return {}
    plan, places = curves.plan, curves.places
    runs = np.repeat(np.arange(len(points)), len(places))
    found = {"point": curves.points[points][runs], "seed": seeds[runs], plan.unit: np.tile(places, len(points))}
    found |= {name: np.asarray(values)[found["point"]] for name, values in plan.table().items()}
    here = np.arange(len(places)) < known[points, seeds][:, None]
    for name, values in measures.items():
        found[name] = np.where(here, values[points, seeds], np.nan).reshape(-1)
    return found


def best_so_far(curves: Curves) -> tuple[list[str], list[list[str]]]:
    """The headings and the rows of the points that succeed most often, and among these have the highest return, at the
    last place that those of their runs know that `results_so_far` has."""
    plan, (measures, known) = curves.plan, _measured(curves)
    names = [name for name in ("success", "return", "steps") if name in measures]
    shown, rows = _shown(known, len(curves.places)), []
    for index in np.flatnonzero(shown.any(axis=1)).tolist():
        runs = shown[index]
        place = int(known[index, runs].min()) - 1
        means = [float(measures[name][index, runs, place].mean()) for name in names]
        rows.append((means, int(curves.points[index]), int(runs.sum()), int(curves.places[place])))
    rows.sort(key=lambda row: tuple(-np.nan_to_num(mean, nan=-np.inf) for mean in row[0][:2]))
    cells = [
        [str(point), *map(short, plan.points[point].values()), str(seeds), f"{count:,}", *map(short, means)]
        for means, point, seeds, count in rows[:BEST]
    ]
    return ["point", *plan.points[0], "seeds", f"{plan.unit}s trained", *names], cells


def _measured(curves: Curves) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The curves by measure, (points, seeds, record) each; and how many record points of each run all of them know."""
    with curves.lock:
        known = [each.known for name, each in curves.measures.items() if not name.startswith("greedy_")]
        least = np.min(known, axis=0) if known else np.zeros((len(curves.points), curves.seeds), int)
        return {name: each.curves.copy() for name, each in curves.measures.items()}, least


def _shown(known: np.ndarray, record: int) -> np.ndarray:
    """Which runs are shown, by the record points that are known of each: those that are over, or while there are none
    those under way that know half as much as the one ahead. So lines are of the same runs from end to end."""
    most = known.max(initial=0)
    return (known > 0) & (known == record if most == record else 2 * known >= most)


class _Handler(Handler):
    """Answers with the page alone."""

    def do_GET(self) -> None:
        if not self._is_for_us():
            self._answer(403)
        elif self.path.partition("?")[0] == "/":
            self._answer(200, self.window.page(), "text/html; charset=utf-8")
        else:
            self._answer(404)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        self._answer(404 if self._is_for_us() else 403)


@contextmanager
def served(growing: Growing, browse: bool = True) -> Iterator[str]:
    """Serve the page to this machine within the block, which gets the address; `browse`: open the browser there."""
    with ThreadingHTTPServer((LOOPBACK, 0), partial(_Handler, growing)) as server:
        server.daemon_threads = True
        address = f"http://{LOOPBACK}:{server.server_address[1]}/"
        threading.Thread(target=server.serve_forever, daemon=True).start()
        if browse:
            threading.Thread(target=partial(webbrowser.open, address), daemon=True).start()
        try:
            yield address
        finally:
            server.shutdown()
