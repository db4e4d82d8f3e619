"""The command `export`."""

from pathlib import Path

from humanoid_mjx.commands import console
from humanoid_mjx.files import write_text
from humanoid_mjx.spec import InputError, check_folder


def run_export(what: str, file: Path, point: int | None) -> None:
    """`humanoid-mjx export`."""
    if file.suffix not in (".xml", ".npz", ".c", ".onnx"):
        raise InputError(f"{file}: the file must end in .xml, for a robot, or in .npz, .c or .onnx, for a policy.")
    check_folder(file)
    from humanoid_mjx.evaluation.deploy import check_place, contract_of, write_contract, write_onnx, write_robot
    from humanoid_mjx.evaluation.policy import find_policy, save_policy

    paths = [file]
    if file.suffix in (".onnx", ".c"):
        check_place(file)
    if file.suffix == ".npz":
        save_policy(find_policy(what, point), file)
    elif file.suffix == ".onnx":
        paths = write_onnx(find_policy(what, point), file)
    elif file.suffix == ".c":
        from humanoid_mjx.evaluation.c_source import c_source

        trained = find_policy(what, point)
        write_text(file, c_source(trained))
        paths.append(write_contract(contract_of(trained), file))
    else:
        write_robot(what, file, point)
    for path in paths:
        console.print(f"{path}", soft_wrap=True)
