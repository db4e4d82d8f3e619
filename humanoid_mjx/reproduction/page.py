"""The report of a folder that `reproduce` has written: what is printed, what comes out, tables and figures."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from humanoid_mjx.report.web import MEDIA, anchor_of, facts, image, link, page, section, table, text
from humanoid_mjx.reproduction.findings import MEANINGS, as_text
from humanoid_mjx.reproduction.runner import FINDINGS, load_experiments, read_findings, read_runs


def findings_page(path: Path) -> str:
    """The page of a folder that `reproduce` has written.

    Raises:
      InputError: its reproduce.json is damaged.
    """
    findings = read_findings(path / FINDINGS)
    shown = sorted(file for file in path.iterdir() if file.suffix in (*MEDIA, ".md") and file.is_file())
    names, known = list(dict.fromkeys(str(finding["name"]) for finding in findings)), load_experiments()
    headings = {name: f"{name}: {known[name].title}" if name in known else name for name in names}
    parts = [_lead(findings), _contents(findings, headings)]
    # A file is of the experiment whose name it begins with; of several of these, of the longest.
    owners = [max((n for n in names if f"{file.stem}-".startswith(f"{n}-")), key=len, default="") for file in shown]
    for name in names:
        mine = [finding for finding in findings if finding["name"] == name]
        own = [file for file, owner in zip(shown, owners, strict=True) if owner == name]
        parts.append(section(headings[name], *map(_finding, mine), *map(_shown, own)))
    if more := [file for file, owner in zip(shown, owners, strict=True) if not owner]:
        parts.append(section("More figures", *map(_shown, more)))
    again = f"humanoid-mjx reproduce {' '.join(names)} --out {path.name}-again"
    parts += [section("Run it again", text(again, "pre")), *_origins(path)]
    return page("The thesis, reproduced", "".join(parts))


def _origins(path: Path) -> Iterable[str]:
    """A section for each machine and commit that findings come from."""
    for run in read_runs(path):
        seconds = sum(times["wall_s"] for times in run["times"].values())
        made = {"experiments": ", ".join(run["times"]), "seconds": f"{seconds:.1f}", "commit": run.get("commit")}
        made |= run.get("machine", {}) | run.get("versions", {})
        yield section("Where it was computed", facts(made.items()))


def _lead(findings: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter(str(finding["verdict"]) for finding in findings)
    known = [*MEANINGS, *(verdict for verdict in counts if verdict not in MEANINGS)]
    items = "".join(text(f"{counts[verdict]} {_words(verdict)}", "li") for verdict in known if counts[verdict])
    words = f"{len(findings)} quantities: what is printed in the source, and what comes out."
    meanings = facts((_words(verdict), words) for verdict, words in MEANINGS.items() if counts[verdict])
    return f'<p class="lead">{text(words, "span")}</p><ul class="counts">{items}</ul>{meanings}'


def _contents(findings: Sequence[Mapping[str, Any]], headings: Mapping[str, str]) -> str:
    """A link to each experiment, and what became of its quantities."""
    items = []
    for name, heading in headings.items():
        counts = Counter(_words(str(finding["verdict"])) for finding in findings if finding["name"] == name)
        found = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        items.append(f"<li>{link(heading, f'#{anchor_of(heading)}')} {text(f'({found})', 'span')}</li>")
    return f"<nav><ul>{''.join(items)}</ul></nav>"


def _finding(finding: Mapping[str, Any]) -> str:
    verdict = str(finding["verdict"])
    kind = verdict if verdict in MEANINGS else "other"
    compared = [("printed", as_text(finding["printed"])), ("comes out", as_text(finding["reproduced"]))]
    if finding["tolerance"] is not None:
        compared.append(("tolerance", as_text(finding["tolerance"])))
    return (
        f'<div class="finding">{text(str(finding["quantity"]), "h4")}{facts(compared)}'
        f'<p><span class="verdict {kind}">{text(_words(verdict), "span")}</span>: '
        f"{text(str(finding['why']), 'span')}</p></div>"
    )


def _words(verdict: str) -> str:
    return verdict.replace("_", " ")


def _shown(file: Path) -> str:
    """A picture, or the table of a Markdown file as `Setting.table` writes it."""
    if file.suffix in MEDIA:
        return f"<figure>{image(file.read_bytes(), file.suffix, file.stem)}{text(file.name, 'figcaption')}</figure>"
    lines = file.read_text(encoding="utf-8").splitlines()
    rows = [line.strip()[2:-2].split(" | ") for line in lines if line.startswith("| ")]
    even = [row for row in rows if len(row) == len(rows[0]) and set(row) != {"---"}]
    return table(even[0], even[1:], caption=file.name) if even else ""
