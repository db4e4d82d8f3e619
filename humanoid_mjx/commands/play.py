"""The command `export`."""

from pathlib import Path

from humanoid_mjx.commands import console
from humanoid_mjx.files import write_text
from humanoid_mjx.spec import InputError, check_folder


def run_export(what: str, file: Path, point: int | None) -> None:
    """`humanoid-mjx export`."""
    if file.suffix not in (".xml", ".npz", ".c"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz or .c, for the policy of a run.")
    check_folder(file)
    if file.suffix == ".npz":
        from humanoid_mjx.evaluation.policy import find_policy, save_policy

        save_policy(find_policy(what, point), file)
    elif file.suffix == ".c":
        from humanoid_mjx.evaluation.c_source import c_source
        from humanoid_mjx.evaluation.policy import find_policy

        write_text(file, c_source(find_policy(what, point)))
    else:
        if point is not None:
            raise InputError(f"--point: {file.name} is of a robot, and only a sweep has points.")
        from humanoid_mjx.robot import make_robot
        from humanoid_mjx.robot.mjcf import checked

        spec = make_robot(what).spec()
        checked(spec.compile)
        write_text(file, spec.to_xml())
    console.print(f"{file}", soft_wrap=True)
