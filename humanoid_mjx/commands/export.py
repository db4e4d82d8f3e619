"""The command `export`."""

from pathlib import Path
from typing import Annotated

from typer import Argument

from humanoid_mjx.commands import Point, Trust, console, trusting


def export(
    what: Annotated[str, Argument(metavar="ROBOT|RUN|POLICY", help="A robot, a run folder or a policy.")],
    file: Annotated[Path, Argument(metavar="FILE", help="An .xml for a robot; .npz, .c or .onnx for a policy.")],
    point: Point = None,
    trust: Trust = False,
) -> None:
    """Write a robot, or that of a policy, as MJCF; or the best policy of a run as .npz, C or ONNX."""
    from humanoid_mjx.files import write_text
    from humanoid_mjx.spec import InputError, check_folder

    if file.suffix not in (".xml", ".npz", ".c", ".onnx"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz, .c or .onnx, for a policy.")
    check_folder(file)
    from humanoid_mjx.evaluation.c_source import c_source
    from humanoid_mjx.evaluation.deploy import check_place, contract_of, write_contract, write_onnx, write_robot
    from humanoid_mjx.evaluation.policy import find_policy, save_policy

    paths = [file]
    with trusting(trust, what):
        if file.suffix in (".onnx", ".c"):
            check_place(file)
        if file.suffix == ".xml":
            write_robot(what, file, point)
        elif file.suffix == ".npz":
            save_policy(find_policy(what, point), file)
        elif file.suffix == ".onnx":
            paths = write_onnx(find_policy(what, point), file)
        else:
            trained = find_policy(what, point)
            write_text(file, c_source(trained))
            paths.append(write_contract(contract_of(trained), file))
    for path in paths:
        console.print(f"{path}", soft_wrap=True)
