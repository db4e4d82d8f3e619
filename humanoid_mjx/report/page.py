"""The report of a run folder as one web page that needs nothing else: no network, no other file."""

import io
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from humanoid_mjx.config import dump_yaml
from humanoid_mjx.evaluation.film import show
from humanoid_mjx.evaluation.policy import find_policy, on_native
from humanoid_mjx.files import write_text
from humanoid_mjx.report.figures import HEAT_MAPS, Figure, averaged, curved, draw_map, figures_of, limits, mapped
from humanoid_mjx.report.player import player
from humanoid_mjx.report.rendering import strip
from humanoid_mjx.report.style import figure, short
from humanoid_mjx.report.web import data_address, facts, image, link, page, section, table, text
from humanoid_mjx.runs.folder import read_config, read_provenance
from humanoid_mjx.runs.ranking import Ranked, ranked, ties, training_interval
from humanoid_mjx.runs.tables import read_table
from humanoid_mjx.spec import InputError
from humanoid_mjx.training.progress import Reporter

BEST_POINTS = 10
"""Rows of the table of points."""

FEW_VALUES = 12
"""More values of a swept parameter are not listed one by one."""

NO_SCRIPT = "<noscript><p>The motion needs JavaScript; the pictures below it show the same.</p></noscript>"

PACKAGES = ("humanoid-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "brax", "numpy")
"""Whose versions a result depends on, by their names in a package index, this package's first."""


def write_page(target: Path, html: str) -> None:
    """Write a page, as a whole or not at all.

    Raises:
      InputError: it cannot be written.
    """
    try:
        write_text(target, html)
    except OSError as error:
        raise InputError(f"{target}: cannot be written: {error.strerror}.") from error


def run_page(path: Path, reporter: Reporter, motion: bool) -> str:
    """The page of a run folder."""
    reporter.phase("reading")
    config, provenance = read_config(path), read_provenance(path)
    results, summary = (read_table(path / f"{name}.parquet") for name in ("results", "summary"))
    axes = list((config.get("sweep") or {}).get("axes", {}))
    if missing := [axis for axis in axes if axis not in summary or axis not in results]:
        raise InputError(f"{path}: its tables do not fit its config; they have no column {missing[0]}.")
    reporter.phase("drawing figures")
    points = ranked(axes, summary, quickest=bool(config.get("episodes")))
    own = figures_of(str(config["task"]["name"]), config.get("modules"))
    parts = [
        _lead(config, summary, points),
        section("Result", *_result(axes, summary, points)),
        section("Learning", text(f"Lines: {averaged(axes, results)}."), *_curves(axes, results, own)),
    ]
    if maps := mapped(axes, summary):
        parts.append(section("Two parameters at a time", *_maps(axes, summary, maps)))
    if motion and (shown := _motion(path, reporter)):
        parts.append(section("The robot", *shown))
    parts += [
        section("What was run", *_config(config, axes, summary)),
        section("Where and when", facts(_provenance(provenance))),
        section("Run it again", *_again(config, provenance)),
    ]
    return page(str(config.get("name", path.name)), "".join(parts))


def _lead(config: Mapping[str, Any], summary: Mapping[str, np.ndarray], points: Sequence[Ranked]) -> str:
    task, learner = (str(config.get(part, {}).get("name")) for part in ("task", "learner"))
    seeds = len(np.unique(summary["seed"]))
    unit = "episodes" if config.get("episodes") else "total_steps"
    budget = f"{config[unit]:,} {'episodes' if unit == 'episodes' else 'control steps'}" if config.get(unit) else ""
    best = points[0]
    size = f"{_many(len(points), 'point')}, {_many(seeds, 'seed')}{' each' * (len(points) > 1)}"
    words = (
        f"{learner} on {task}: {size}{f', {budget} a run' if budget else ''}. "
        f"The best point succeeds in {best.success:.1%} of its greedy episodes, in {best.greedy_steps:.1f} steps."
    )
    return f'<p class="lead">{text(words, "span")}</p>'


def _many(count: int, name: str) -> str:
    return f"{count:,} {name}{'s' * (count != 1)}"


def _result(axes: Sequence[str], summary: Mapping[str, np.ndarray], points: Sequence[Ranked]) -> list[str]:
    rows = []
    for point in points[:BEST_POINTS]:
        low, high = training_interval(summary, point.point)
        steps = f"{point.steps:.2f} ({low:.2f} to {high:.2f})" if low < high else f"{point.steps:.2f}"
        greedy = f"{point.success:.1%}", f"{point.greedy_steps:.1f}", f"{point.greedy_return:.4g}"
        rows.append((point.point, *map(short, point.values), *greedy, steps))
    headings = (
        "point",
        *axes,
        "greedy success",
        "greedy steps",
        "greedy return",
        "steps at the end of training (95\u00a0%)",
    )
    shown = len(rows)
    some = f"The best {shown} of {len(points):,} points" if shown < len(points) else f"All {shown} points, best first"
    caption = some if len(points) > 1 else "The only point"
    parts = [table(headings, rows, caption=caption)]
    if (equals := ties(points)) > 1:
        parts.append(text(f"{equals:,} points act equally well; training tells them apart."))
    if diverged := int(np.sum(summary["diverged"])):
        words = f"{diverged:,} of {len(summary['point']):,} runs stopped at numbers that were not finite."
        parts.append(f'<p class="note">{text(words, "strong")}</p>')
    words = (
        "Greedy: episodes in which nothing is explored or learned, after training. Success is the mean over seeds, the "
        "other columns are interquartile means over seeds; returns are undiscounted sums of rewards."
    )
    return [*parts, f'<p class="note">{text(words, "span")}</p>']


def _curves(axes: Sequence[str], results: Mapping[str, np.ndarray], own: Sequence[Figure]) -> list[str]:
    """A row of panels for each figure; where nothing is swept, all figures in one."""
    rows = curved(results, own)
    if not axes:
        return [f'<div class="grid">{"".join(_curve(results, None, each) for each in rows)}</div>']
    return [
        f'{text(_capital(each.title), "h3")}<div class="grid">'
        + "".join(_curve(results, axis, each) for axis in (axes if each.by_axis else (None,)))
        + "</div>"
        for each in rows
    ]


def _curve(results: Mapping[str, np.ndarray], axis: str | None, each: Figure) -> str:
    ends: dict[str, float] = {}
    svg = _svg(lambda panel: ends.update(each.draw(panel, results, axis)))
    last = ", ".join(f"{label}: {value:.4g}" for label, value in ends.items())
    by = f" by {axis}" if axis else ""
    return _figure(svg, f"{each.title}{by}; at the end {last}", axis or _capital(each.title))


def _maps(axes: Sequence[str], summary: Mapping[str, np.ndarray], names: Sequence[str]) -> list[str]:
    parts = [
        text("Means over seeds and over all values of the other parameters; maps of a measure share their colours.")
    ]
    for name in names:
        span = limits(axes, summary, name)
        pictures = []
        for pair in combinations(axes, 2):
            svg = _svg(
                lambda panel, pair=pair, name=name, span=span: panel.figure.colorbar(
                    draw_map(panel, summary, pair, name, span), ax=panel
                )
            )
            pictures.append(_figure(svg, f"{HEAT_MAPS[name]} by {pair[0]} and {pair[1]}", f"{pair[0]} and {pair[1]}"))
        parts.append(text(_capital(HEAT_MAPS[name]), "h3") + f'<div class="grid">{"".join(pictures)}</div>')
    return parts


def _motion(path: Path, reporter: Reporter) -> list[str]:
    """The robot under the best policy, in its first held-out episode; nothing where the task has none."""
    try:
        trained = on_native(find_policy(str(path)))
        if getattr(trained.learner.task, "simulator", None) is None:
            return []
        shown = show(trained, reporter)
    except InputError as error:
        return [f'<p class="note">{text(str(error), "span")}</p>']
    reporter.phase("rendering")
    pictures = []
    for frame, seconds in strip(shown.film):
        file = io.BytesIO()
        Image.fromarray(frame).save(file, "JPEG", quality=88)
        pictures.append(_figure(file.getvalue(), f"The robot after {seconds:.2f} s", f"{seconds:.2f} s", ".jpg"))
    words = f"The best policy in the first held-out episode: {shown.outcome}."
    return [text(words), player(shown.film, still=NO_SCRIPT), f'<div class="grid strip">{"".join(pictures)}</div>']


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


def _provenance(provenance: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Plain values, those within others by dotted names."""
    found = []
    for name, value in provenance.items():
        if isinstance(value, dict):
            found += [(str(key), str(inner)) for key, inner in value.items()]
        elif name == "sessions":
            found.append(("sessions", str(len(value)) if isinstance(value, list) else str(value)))
        elif value is not None:
            found.append((name.replace("_", " "), _plain(value)))
    return found or [("provenance", "this folder holds no provenance.json")]


def _plain(value: Any) -> str:
    """Numbers with all their digits, a comma at each thousand; texts as they are."""
    return f"{value:,.10g}" if isinstance(value, int | float) else str(value)


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


def _svg(draw: Callable[[Any], object]) -> bytes:
    """One panel as SVG."""
    file = io.BytesIO()
    with figure(file, 1, 1, size=(4.4, 3.0)) as (_, panels):
        draw(panels[0, 0])
    return file.getvalue()


def _figure(data: bytes, alt: str, caption: str, kind: str = ".svg") -> str:
    below = text(caption, "figcaption") if caption else ""
    return f"<figure>{image(data, kind, alt)}{below}</figure>"


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
