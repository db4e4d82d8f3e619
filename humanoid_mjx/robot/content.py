"""The digest of a robot: its YAML, its MJCF, and every file that the MJCF names and that decides its physics."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree


def content_of(data: Mapping[str, Any], file: Path) -> str:
    """Return a digest of a robot's keys and of all files of its MJCF, whatever the layout and comments of XML."""
    parts = [json.dumps(dict(sorted(data.items()))) + _canonical(file), *map(_canonical, files_of(file)[1:])]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def files_of(file: Path) -> list[Path]:
    """Return an MJCF and all files that it and its parts name but textures and skins, whose places may be from the file
    that names them or from the main one, in any folder of meshes, with or without their path."""
    found, folders, named = [file.resolve()], {"."}, []
    for path in found:
        text = path.read_bytes().decode(errors="replace") if _is_xml(path) else ""
        folders |= set(re.findall(r"\b(?:mesh|asset)dir\s*=\s*[\"']([^\"']*)", text))
        named += [
            (path.parent, m[2])
            for m in re.finditer(r"<(\w+)\b[^<>]*?\bfile\s*=\s*[\"']([^\"']+)", text)
            if m[1] not in ("texture", "skin")
        ]
        for beside, name in named:
            for place in (base / folder for base in (beside, found[0].parent) for folder in sorted(folders)):
                there = [(place / last).resolve() for last in (name, Path(name).name)]
                found += [path for path in dict.fromkeys(there) if path.is_file() and path not in found]
    return found


def _is_xml(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


def _canonical(path: Path) -> str:
    """The text of an XML file without layout and comments; of any other file a digest."""
    try:
        return ElementTree.canonicalize(path.read_text(encoding="utf-8"), strip_text=True)
    except (ElementTree.ParseError, UnicodeDecodeError):
        return hashlib.sha256(path.read_bytes()).hexdigest()
