"""One self-contained web page: style, script and pictures within it, nothing fetched, all text escaped.

Its content security policy forbids every connection, and every script and style whose hash it does not name: text from
a config or a task could do nothing even if it were written unescaped.
"""

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from string import Template

MEDIA = {
    ".png": "image/png",
    ".gif": "image/gif",
    ".svg": "image/svg+xml",
    ".jpg": "image/jpeg",
    ".mp4": "video/mp4",
    ".webm": "video/webm",
}

_NUMBER = re.compile(r"(-?[\d,.]*\d(e[+-]?\d+)?%?|nan|inf|-inf)( \(.*\))?|")
"""The text of a number, perhaps with an interval, or no text."""


def page(title: str, body: str, *, live: bool = False) -> str:
    """A whole page around a body of HTML; `title` is text. A `live` page may ask its own server."""
    style, script = _file("page.css"), _file("player.js") + _file("page.js")
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}; "
        "base-uri 'none'; form-action 'none'" + live * "; connect-src 'self'"
    )
    return Template(_file("page.html")).substitute(
        title=escape(title), policy=escape(policy), style=style, script=script, body=body
    )


def image(data: bytes, kind: str, alt: str) -> str:
    """A picture within the page; `kind` is one of `MEDIA`."""
    return f'<img src="{data_address(data, MEDIA[kind])}" alt="{escape(alt)}">'


def data_address(data: bytes, media: str) -> str:
    """A URL that holds the data itself, within the page."""
    return f"data:{media};base64,{base64.b64encode(data).decode()}"


def table(headings: Sequence[str], rows: Iterable[Sequence[object]], *, caption: str = "") -> str:
    """A table of texts and numbers, which the reader can sort. Columns of numbers alone are set to the right."""
    cells = [[str(cell) for cell in row] for row in rows]
    right = [all(_NUMBER.fullmatch(row[i]) for row in cells) and bool(cells) for i in range(len(headings))]
    may_break = (re.sub(r"([._])", r"\1<wbr>", escape(words)) for words in headings)  # as in learner.epsilon_decay
    head = "".join(f"<th{_side(r)} scope=col>{words}</th>" for words, r in zip(may_break, right, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td{_side(r)}>{escape(text)}</td>" for text, r in zip(row, right, strict=True)) + "</tr>"
        for row in cells
    )
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(caption or "Table")}">'
        f"<table>{above}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def facts(pairs: Iterable[tuple[str, object]]) -> str:
    """Names and values in two columns."""
    rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(str(value))}</dd>" for name, value in pairs)
    return f"<dl>{rows}</dl>"


def section(title: str, *parts: str) -> str:
    """A part of the page with a heading, and a name that links can lead to (`anchor_of`)."""
    return f'<section id="{anchor_of(title)}"><h2>{escape(title)}</h2>{"".join(parts)}</section>'


def contents(titles: Iterable[str]) -> str:
    """Links to the sections with these titles."""
    links = "".join(f"<li>{link(title, f'#{anchor_of(title)}')}</li>" for title in titles)
    return f'<nav class="contents" aria-label="Contents"><ul>{links}</ul></nav>'


def anchor_of(title: str) -> str:
    """The name of a section that links lead to."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def link(words: str, address: str, file: str = "") -> str:
    """A link within the page; with the name of a `file`, one that saves it."""
    saves = f' download="{escape(file)}"' if file else ""
    return f'<a href="{escape(address)}"{saves}>{escape(words)}</a>'


def text(words: str, kind: str = "p") -> str:
    """A paragraph, or another element, of plain text."""
    return f"<{kind}>{escape(words)}</{kind}>"


def _side(right: bool) -> str:
    return ' class="number"' if right else ""


def _hash(content: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"


def _file(name: str) -> str:
    return (files("humanoid_mjx.report") / name).read_text(encoding="utf-8")
