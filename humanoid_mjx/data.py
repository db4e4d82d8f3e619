"""Files that ship with the package: configs and policies, found by name."""

from pathlib import Path

from humanoid_mjx.spec import InputError, known

_PACKAGE = Path(__file__).parent


def folder(name: str) -> Path:
    """The folder `name`: inside the package when installed, beside it in a checkout."""
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name


def names(kind: str, suffix: str) -> list[str]:
    """The names of what ships in a folder."""
    return sorted(path.stem for path in folder(kind).glob(f"*{suffix}") if not path.stem.startswith("_"))


def shipped(kind: str, name: str, suffix: str) -> Path:
    """The file `name`: a path, or the name of a shipped one.

    Raises:
      InputError: there is neither.
    """
    path = Path(name)
    if path.suffix == suffix or path.is_file():
        if not path.is_file():
            raise InputError(f"{name}: there is no such file.")
        return path
    path = folder(kind) / f"{name}{suffix}"
    if path.is_file() and path.stem in names(kind, suffix):
        return path
    raise InputError(f"{name}: neither a file nor a shipped {kind[:-1]}; {known(name, names(kind, suffix))}.")
