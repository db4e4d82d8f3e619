"""The report of a folder that `reproduce` has written: what is printed, what comes out, and the figures."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from humanoid_mjx import compute
from humanoid_mjx.report.web import MEDIA, facts, image, link, page, section, text
from humanoid_mjx.reproduction.runner import load_experiments
from humanoid_mjx.spec import InputError

VERDICTS = {
    "reproduced": "what is printed comes out",
    "recovered": "it comes out with values that are not the printed ones",
    "differs": "it does not come out",
    "not_reproducible": "no values that are possible could make it come out",
    "finding": "nothing is printed that it could agree with",
}
"""In the order in which they are counted."""

KEYS = ("name", "quantity", "printed", "reproduced", "tolerance", "verdict", "why")


def findings_page(path: Path) -> str:
    """The page of a folder that `reproduce` has written.

    Raises:
      InputError: its reproduce.json is damaged.
    """
    findings = _read(path / "reproduce.json")
    pictures = _pictures(path)
    titles = {name: experiment.title for name, experiment in load_experiments().items()}
    names = list(dict.fromkeys(str(finding["name"]) for finding in findings))
    parts = [_lead(findings), _contents(findings, names, titles)]
    for name in names:
        mine = [finding for finding in findings if finding["name"] == name]
        own = [file for file in pictures if _belongs(file.stem, name, names)]
        pictures = [file for file in pictures if file not in own]
        heading = f"{name}: {titles[name]}" if name in titles else name
        parts.append(section(heading, *map(_finding, mine), *map(_picture, own), anchor=_anchor(names, name)))
    if pictures:
        parts.append(section("More figures", *map(_picture, pictures)))
    machine = facts((compute.machine() | compute.versions()).items())
    words = "This page was written on the following machine; reproduce.json does not say on which it was made."
    again = f"humanoid-mjx reproduce {' '.join(names)} --out {path.name}-again"
    parts += [section("Run it again", text(again, "pre")), section("Where the page was written", text(words), machine)]
    return page("The thesis, reproduced", "".join(parts))


def _read(file: Path) -> list[dict[str, Any]]:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: this file is truncated or damaged; run reproduce again.") from error
    if not isinstance(found, list) or not all(isinstance(each, dict) and set(KEYS) <= set(each) for each in found):
        raise InputError(f"{file}: this is not what reproduce writes.")
    return found


def _pictures(path: Path) -> list[Path]:
    return sorted(file for file in path.iterdir() if file.suffix in MEDIA and file.is_file())


def _belongs(stem: str, name: str, names: Sequence[str]) -> bool:
    """True if a file is an experiment's: it begins with its name, and with no longer name of another."""
    fits = [other for other in names if stem == other or stem.startswith(f"{other}-")]
    return bool(fits) and max(fits, key=len) == name


def _lead(findings: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter(str(finding["verdict"]) for finding in findings)
    known = [*VERDICTS, *(verdict for verdict in counts if verdict not in VERDICTS)]
    items = "".join(text(f"{counts[verdict]} {_words(verdict)}", "li") for verdict in known if counts[verdict])
    words = f"{len(findings)} quantities: what is printed in the source, and what comes out."
    meanings = facts((_words(verdict), VERDICTS[verdict]) for verdict in VERDICTS if counts[verdict])
    return f'<p class="lead">{text(words, "span")}</p><ul class="counts">{items}</ul>{meanings}'


def _contents(findings: Sequence[Mapping[str, Any]], names: Sequence[str], titles: Mapping[str, str]) -> str:
    """A link to each experiment, and what became of its quantities."""
    items = []
    for name in names:
        counts = Counter(_words(str(finding["verdict"])) for finding in findings if finding["name"] == name)
        found = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        title = f"{name}: {titles[name]}" if name in titles else name
        items.append(f"<li>{link(title, f'#{_anchor(names, name)}')} {text(f'({found})', 'span')}</li>")
    return f"<nav><ul>{''.join(items)}</ul></nav>"


def _anchor(names: Sequence[str], name: str) -> str:
    return f"experiment-{names.index(name) + 1}"


def _finding(finding: Mapping[str, Any]) -> str:
    verdict = str(finding["verdict"])
    kind = verdict if verdict in VERDICTS else "other"
    compared = [("printed", _value(finding["printed"])), ("comes out", _value(finding["reproduced"]))]
    if finding["tolerance"] is not None:
        compared.append(("tolerance", _value(finding["tolerance"])))
    return (
        f'<div class="finding">{text(str(finding["quantity"]), "h4")}{facts(compared)}'
        f'<p><span class="verdict {kind}">{text(_words(verdict), "span")}</span>: '
        f"{text(str(finding['why']), 'span')}</p></div>"
    )


def _value(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(map(_value, value))
    if isinstance(value, dict):
        return "; ".join(f"{key}: {_value(inner)}" for key, inner in value.items() if inner != "")
    return str(value)


def _words(verdict: str) -> str:
    return verdict.replace("_", " ")


def _picture(file: Path) -> str:
    return f"<figure>{image(file.read_bytes(), file.suffix, file.stem)}{text(file.name, 'figcaption')}</figure>"
