"""The report of a run folder as one web page that needs nothing else: no network, no other file."""

import io
import json
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from humanoid_mjx.compute.provenance import PACKAGES
from humanoid_mjx.config import dump_yaml
from humanoid_mjx.evaluation.film import driven_films, show
from humanoid_mjx.evaluation.policy import StoredPolicy, find_policy, on_native, on_plane
from humanoid_mjx.evaluation.replay import remarks
from humanoid_mjx.report.drawing import HEAT_MAPS
from humanoid_mjx.report.figures import EFFECTS, Figure, averaged, by_value, curved, heat_maps, mapped, parameters
from humanoid_mjx.report.learned import learned
from humanoid_mjx.report.rendering import strip
from humanoid_mjx.report.scene import film_data, player
from humanoid_mjx.report.style import figure
from humanoid_mjx.report.web import contents, data_address, facts, image, link, page, section, table, text
from humanoid_mjx.robot.differences import HEADINGS, differences_of
from humanoid_mjx.runs.curves import Learning, read_learning
from humanoid_mjx.runs.folder import read_config, read_provenance
from humanoid_mjx.runs.ranking import Ranked, best_table, in_words, ranked, short
from humanoid_mjx.runs.tables import read_table
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.pace import time_in_words
from humanoid_mjx.training.progress import Reporter, counted

FEW_VALUES, ROWS = 12, 200
"""More values of a swept parameter are not listed one by one; most rows of the table of points."""

PANEL, DRIVEN_S = (4.4, 3.0), 6.0
"""Size of a panel, inches; length of a film under one command, s."""

NO_SCRIPT = "<noscript><p>The motion needs JavaScript; the pictures below it show the same.</p></noscript>"


def run_page(path: Path, reporter: Reporter, motion: bool) -> str:
    """The page of a run folder."""
    reporter.phase("reading")
    config, provenance = read_config(path), read_provenance(path)
    summary, quickest = read_table(path / "summary.parquet"), bool(config.get("episodes"))
    learning = read_learning(path, config, summary, quickest)
    axes = list(learning.axes)
    reporter.phase("drawing figures")
    points = ranked(axes, summary, quickest)
    run, trained = _config(config, axes, summary), None
    try:
        trained = find_policy(path)
        if rows := differences_of(trained.learner.task):
            run += [text("Its robot and the MJCF", "h3"), table(HEADINGS, rows)]
    except InputError as error:
        run.append(_note(error))
    parts = {
        "Result": _result(path, learning, summary, points, quickest),
        "Learning": [text(f"Lines: {averaged(learning)}."), *curve_panels(learning)],
    }
    if others := parameters(learning):
        parts["What matters"] = [text(_capital(EFFECTS[learning.mode]) + "."), _panels(others)]
    if maps := mapped(learning):
        words = "Success is a mean over seeds, steps a median. Maps of a measure share colours: yellow is best."
        found = (text(_capital(HEAT_MAPS[name]), "h3") + _panels(heat_maps(learning, name)) for name in maps)
        parts["Two parameters at a time"] = [text(words), *found]
    if trained and config["learner"]["name"] == "tabular_q":
        reporter.phase("drawing its table")
        words, tables = learned(trained)
        parts["What was learned"] = [text(words), _panels(tables)]
    if trained and motion and getattr(trained.learner.task, "simulator", None) is not None:
        parts["The robot"] = _motion(trained, reporter)
    parts |= {
        "What was run": run,
        "Where and when": _provenance(provenance),
        "Run it again": _again(config, provenance),
    }
    body = "".join(section(title, *words) for title, words in parts.items())
    return page(str(config.get("name", path.name)), _lead(config, summary, points, quickest) + contents(parts) + body)


def _lead(
    config: Mapping[str, Any], summary: Mapping[str, np.ndarray], points: Sequence[Ranked], quickest: bool
) -> str:
    task, learner = (str(config.get(part, {}).get("name")) for part in ("task", "learner"))
    seeds = len(np.unique(summary["seed"]))
    unit = "episodes" if config.get("episodes") else "total_steps"
    budget = f"{config[unit]:,} {'episodes' if unit == 'episodes' else 'control steps'}" if config.get(unit) else ""
    best = points[0]
    size = f"{counted(len(points), 'point')}, {counted(seeds, 'seed')}{' each' * (len(points) > 1)}"
    judged = f"in {best.greedy_steps:.1f} steps" if quickest else f"with a return of {best.greedy_return:.4g}"
    words = (
        f"{learner} on {task}: {size}{f', {budget} a run' if budget else ''}. "
        f"The best point succeeds in {best.success:.1%} of its greedy episodes, {judged}."
    )
    return f'<p class="lead">{text(words, "span")}</p>'


def _result(
    path: Path, learning: Learning, summary: Mapping[str, np.ndarray], points: Sequence[Ranked], quickest: bool
) -> list[str]:
    headings, rows = best_table(list(learning.axes), summary, points[:ROWS], quickest, learning.compared)
    every = f"humanoid_mjx.load_run({str(path)!r}).points() lists all"
    some = f"The best {ROWS} of {len(points):,} points; {every}" if len(points) > ROWS else f"All {len(rows)} points"
    caption = f"{some}, best first" if len(points) > 1 else "The only point"
    parts = [table(headings, rows, caption=caption)]
    parts += [text(_capital(line)) for line in in_words(list(learning.axes), points, learning.compared).splitlines()]
    parts += [_note(words, "strong") for words in remarks(path, summary)]
    words = (
        "Greedy: episodes in which nothing is explored or learned, after training. Success is the mean over seeds, the "
        "other columns are medians over seeds. Points are as good as the best if the same seeds do not tell them apart "
        "(5 % false alarms over all points together). Returns are undiscounted sums of rewards: where a task pays "
        "at every step, a longer episode collects more."
    )
    parts.append(_note(words))
    if axes := list(learning.axes)[:2]:
        run, best = shlex.quote(str(path)), f"--point {points[0].point}"
        drawn = " ".join(f"--{option} {axis}" for option, axis in zip(("x", "by"), axes, strict=False))
        commands = f"plot {run} --y {learning.compared.policy.measure or 'success'} {drawn}", f"evaluate {run} {best}"
        parts += [text("Next, for example:"), text("\n".join(f"humanoid-mjx {command}" for command in commands), "pre")]
    return parts


def curve_panels(learning: Learning) -> list[str]:
    """A row of panels for each figure, on one scale; where lines are points of the sweep, all figures in one."""
    rows, axes = curved(learning), list(learning.axes)
    if not by_value(learning):
        return [_panels(rows)]
    return [text(_capital(each.title), "h3") + _grid(_row(axes if each.by_axis else (None,), each)) for each in rows]


def _panels(figures: Iterable[Figure]) -> str:
    """The figures side by side, a panel each."""
    return _grid(panel for each in figures for panel in _row((None,), each))


def _row(axes: Sequence[str | None], each: Figure) -> list[str]:
    """The panels of one figure, a swept parameter each."""
    with ExitStack() as stack:
        files = [io.BytesIO() for _ in axes]
        figures = [stack.enter_context(figure(file, 1, 1, size=PANEL)) for file in files]
        panels = [grid[0, 0] for _, grid in figures]
        ends = [each.draw(panel, axis) for panel, axis in zip(panels, axes, strict=True)]
        low, high = zip(*(panel.get_ylim() for panel in panels), strict=True)
        for (fig, _), panel in zip(figures, panels, strict=True):
            panel.set_ylim(min(low), max(high))
            fig.draw_without_rendering()
        lines = [_lines(panel) for panel in panels]
    found = []
    for axis, file, end, data in zip(axes, files, ends, lines, strict=True):
        last = ", ".join(f"{label}: {value:.4g}" for label, value in (end or {}).items())
        by = f" by {axis}" if axis else ""
        words = f"{each.title}{by}" + f"; at the end {last}" * bool(last)
        found.append(_figure(file.getvalue(), ".svg", words, axis or _capital(each.title), data))
    return found


def _lines(panel: Any) -> dict[str, Any]:
    """Data of a panel's lines for the tip below the pointer: the panel's place on the picture, as shares from left
    and top, the limits of its x axis, and the finite places of each labelled line."""
    box, scale = panel.get_position(), panel.get_xscale()
    lines = {
        str(line.get_label()): [
            [float(f"{value:.4g}") for value in values]
            for values in np.array(line.get_data())[:, np.isfinite(line.get_ydata())]
        ]
        for line in panel.get_lines()
        if not str(line.get_label()).startswith("_")
    }
    return {"box": [box.x0, 1 - box.y1, box.x1, 1 - box.y0], "x": panel.get_xlim(), "scale": scale, "lines": lines}


def _grid(pictures: Iterable[str], kind: str = "") -> str:
    return f'<div class="grid{kind}">{"".join(pictures)}</div>'


def _motion(trained: StoredPolicy, reporter: Reporter) -> list[str]:
    """The robot under a policy, in its first held-out episode."""
    try:
        film, outcome = show(trained := on_native(on_plane(trained)), reporter)
    except InputError as error:
        return [_note(error)]
    reporter.phase("rendering")
    pictures = []
    for frame, seconds in strip(film):
        file = io.BytesIO()
        Image.fromarray(frame).save(file, "JPEG", quality=88)
        pictures.append(_figure(file.getvalue(), ".jpg", f"The robot after {seconds:.2f} s", f"{seconds:.2f} s"))
    reporter.phase("simulating commands")
    films = driven_films(trained, DRIVEN_S)
    together = text("Under commands that stay; the films play together", "h3")
    driven = [together, _grid(player(film_data(film)) for film in films)] if films else []
    words = f"The best policy in the first held-out episode: {outcome}."
    return [text(words), player(film_data(film), NO_SCRIPT), _grid(pictures, " strip"), *driven]


def _config(config: Mapping[str, Any], axes: Sequence[str], summary: Mapping[str, np.ndarray]) -> list[str]:
    swept = []
    for axis in axes:
        values = np.unique(summary[axis])
        shown = values if len(values) <= FEW_VALUES else [*values[:3], "…", *values[-2:]]
        swept.append((axis, len(values), ", ".join(map(short, shown))))
    yaml, name = dump_yaml(dict(config)), f"{_file_name(config)}.yaml"
    save = link(f"Save as {name}", data_address(yaml.encode(), "text/yaml"), name)
    parts = [table(("swept parameter", "values", ""), swept)] if swept else []
    return [*parts, text("The config, with all defaults:"), text(yaml.rstrip(), "pre"), f"<p>{save}</p>"]


def _provenance(provenance: Mapping[str, Any]) -> list[str]:
    """The machine, the versions and the times, in words; a damaged or missing record says so."""

    def part(name: str) -> dict[str, Any]:
        return value if isinstance(value := provenance.get(name), dict) else {}

    machine, found, sessions = part("machine"), [], provenance.get("sessions")
    devices, cores = machine.get("device_count"), machine.get("cpu_count")
    found.append(("started", provenance.get("started")))
    for name, words in (("wall_s", "training took"), ("compile_s", "of which compiling")):
        if isinstance(seconds := provenance.get(name), int | float):
            found.append((words, time_in_words(seconds)))
    if isinstance(sessions, list) and len(sessions) > 1:
        found.append(("in", f"{len(sessions)} sessions, the later ones with --resume"))
    for name, words in (("episodes_per_s", "episodes a second"), ("steps_per_s", "control steps a second")):
        if isinstance(rate := provenance.get(name), int | float):
            found.append((words, f"{rate:,.10g}"))
    if machine:
        of = f", {devices} of them" if devices and devices != 1 else ""
        found.append(("computed by", f"{machine.get('device')}{of}" + f" (backend {machine.get('backend')})"))
        found.append(("machine", f"{machine.get('cpu')}, {cores} CPU cores, {machine.get('system')}"))
    told = ("precision", "numbers"), ("seed", "seed of the sweep"), ("commit", "commit")
    found += [(words, provenance.get(name)) for name, words in told]
    found.append(("versions", ", ".join(f"{name} {value}" for name, value in part("versions").items())))
    shown = [(name, str(value)) for name, value in found if value not in (None, "")]
    return [facts(shown) if shown else text("This folder holds no provenance.json.")]


def _again(config: Mapping[str, Any], provenance: Mapping[str, Any]) -> list[str]:
    versions = provenance.get("versions")
    versions = versions if isinstance(versions, dict) else {}
    commit = re.fullmatch(r"([0-9a-f]{40})(-dirty)?", str(provenance.get("commit")))
    pins = " ".join(f"{name}=={versions[name]}" for name in PACKAGES[bool(commit) :] if name in versions)
    name = _file_name(config)
    commands = [f"pip install {pins}"] if pins else []
    if commit:
        commands = [f"git checkout {commit[1]}", f"pip install -e . {pins}"]
    commands.append(f"humanoid-mjx sweep {name}.yaml --out {name}-again")
    words = (
        f"Save the config above as {name}.yaml. With the same versions on the same kind of device the numbers are the "
        "same; elsewhere rounding differs, and learning amplifies it."
    )
    if commit and commit[2]:
        words += " Files differed from that commit when it ran."
    return [text("\n".join(commands), "pre"), text(words)]


def _file_name(config: Mapping[str, Any]) -> str:
    """The config's name without characters that a shell or a file system cannot take."""
    name = "".join(x if x.isascii() and (x.isalnum() or x in "-_") else "-" for x in str(config.get("name", "run")))
    return name.lstrip("-") or "run"


def _figure(data: bytes, kind: str, alt: str, caption: str, lines: Mapping[str, Any] | None = None) -> str:
    """A picture with a caption; `lines` is what the page shows below the pointer (`_lines`)."""
    hover = f' data-lines="{escape(json.dumps(lines))}"' if lines and lines["lines"] else ""
    look = ' class="curves"' if kind == ".svg" else ""
    return f"<figure{look}{hover}>{image(data, kind, alt)}{text(caption, 'figcaption')}</figure>"


def _note(words: object, kind: str = "span") -> str:
    return f'<p class="note">{text(str(words), kind)}</p>'


def _capital(words: str) -> str:
    return words if "." in words.partition(" ")[0] else words[:1].upper() + words[1:]
