"""Errors in code of a user: the file and the line at fault, and the name that was perhaps meant."""

import builtins
import difflib
import os
import re
import sysconfig
import traceback
from collections.abc import Iterable
from pathlib import Path

NOT_THEIRS = str(Path(__file__).parent) + os.sep, sysconfig.get_path("stdlib") + os.sep, "<"
"""Beginnings of the paths of this package, of Python's library and of code without a file."""

INSTALLED = {"site-packages", "dist-packages"}


def place(error: BaseException) -> str:
    """Return file, line and text of the innermost frame of an error in a user's code, in brackets; "" if none is."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if not frame.filename.startswith(NOT_THEIRS) and INSTALLED.isdisjoint(path.parts):
            return f" ({path.name}, line {frame.lineno}: {frame.line})"
    return ""


def in_words(error: BaseException) -> str:
    """Return an error's kind and message with the user's file, line and text, and a name that was perhaps meant."""
    message = " ".join(f"{type(error).__name__}: {error}".partition("\n\n")[0].split()).rstrip(".") + _meant(error)
    return message if isinstance(error, SyntaxError) else message + place(error)  # a SyntaxError names its place


def _meant(error: BaseException) -> str:
    """Words that name what an unknown name is near to; empty if nothing is."""
    wrong = getattr(error, "name", None) or next(iter(re.findall(r"unexpected.*'(\w+)'", str(error))), None)
    if not isinstance(wrong, str):
        return ""
    close = difflib.get_close_matches(wrong, list(map(str, _names(error))), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def _names(error: BaseException) -> Iterable[object]:
    """Names that an unknown name of an error may stand for."""
    if isinstance(error, AttributeError):
        return dir(error.obj)
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    if isinstance(error, NameError):
        return {*frames[-1].f_locals, *frames[-1].f_globals, *dir(builtins)}
    called = str(error).partition("(")[0].partition(".")[0]  # `State.__new__() got an unexpected keyword argument`
    tuples = frames[-1].f_locals.get("self"), frames[-1].f_globals.get(called)
    return [name for each in tuples for name in getattr(each, "_fields", ())]
