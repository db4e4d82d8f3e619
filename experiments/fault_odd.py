"""Faults of what stands in the place of a file: pipes, links that lead out, archives that inflate, weights of NaN."""

import io
import os
import shutil
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
from fault_trying import TINY, Matrix, Try, begin, command, isolated, whole, write_config

from humanoid_mjx.files import folder as shipped_folder

FILES = ("checkpoint/part-00000.npz", "config.yaml", "provenance.json", "results.parquet", "summary.parquet", ".lock")
KINDS = ("pipe", "link that leads out of the run folder", "archive of 1 GB of zeros in 1 MB")
GIGABYTE = 1_000_000_000


def bomb(name: str, **arrays: np.ndarray) -> bytes:
    """Return an archive of an array of zeros, 1,000 times as large as the file, and of others."""
    header, file = io.BytesIO(), io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (GIGABYTE // 4,)}
    np.lib.format.write_array_header_1_0(header, shape)
    np.savez(file, allow_pickle=False, **arrays)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive, archive.open(f"{name}.npy", "w") as member:
        member.write(header.getvalue())
        for _ in range(1000):
            member.write(bytes(GIGABYTE // 1000))
    return file.getvalue()


def _said(calls: list[tuple[object, ...]]) -> Try:
    """Run commands, each of which must end with one sentence."""
    for call in calls:
        done = command(*call)
        if done.how != "one sentence":
            return done.how, f"{' '.join(map(str, call))}: {done.said}"
    return "one sentence", ""


def _in_run_folder(case: tuple[str, str]) -> Try:
    """Put something odd in the place of a file of a finished run, and read it by every command."""
    kind, name = case
    run, outside = Path.cwd() / "run", Path.cwd() / "outside"
    for old in (run, outside):
        shutil.rmtree(old, ignore_errors=True)
    shutil.copytree(Path.cwd() / "whole", run)
    outside.mkdir()
    if kind == KINDS[0]:
        (run / name).unlink()
        os.mkfifo(run / name)
    elif kind == KINDS[1]:
        (run / name).rename(outside / "file")
        (run / name).symlink_to(outside / "file")
    else:
        (run / name).write_bytes(bomb("point"))
    calls: list[tuple[object, ...]] = [("evaluate", run), ("export", run, "x.npz"), ("export", run, "x.c")]
    calls += [("play", run), ("sweep", write_config(Path.cwd(), TINY), "--out", run, "--resume")]
    if kind != KINDS[2]:
        calls += [("report", run, "--no-motion"), ("plot", run)]
    return _said(calls)


def _as_policy(kind: str) -> Try:
    """Give commands an odd policy file."""
    path = Path.cwd() / "policy.npz"
    path.unlink(missing_ok=True)
    with np.load(shipped_folder("policies") / "posture_switch.npz") as file:
        arrays = dict(file)
    name = next(name for name in arrays if name.startswith("policy"))
    if kind == KINDS[0]:
        os.mkfifo(path)
    elif kind == KINDS[2]:
        path.write_bytes(bomb(name, **{other: array for other, array in arrays.items() if other != name}))
    else:
        arrays[name] = np.full_like(arrays[name], np.inf if kind == "infinity" else np.nan)
        np.savez(path, **arrays)
    calls: list[tuple[object, ...]] = [("evaluate", path), ("play", path), ("export", path, "x.c")]
    return _said(calls)


def odd_files(matrix: Matrix, folder: Path) -> None:
    """Pipes, links, archives that inflate and weights that are not finite, in run folders and as policies."""
    begin(folder)
    isolated(whole, [folder / "whole"], folder)
    for kind in KINDS:
        names = FILES if kind != KINDS[2] else FILES[:1]
        cases = [(kind, name) for name in names]
        matrix.row(kind, "a file of a run folder", partial(isolated, _in_run_folder, cases, folder, 300))
    for kind in (KINDS[0], KINDS[2]):
        matrix.row(kind, "policy file", partial(isolated, _as_policy, [kind], folder, 300))
    matrix.row(
        "weights that are not finite", "policy file", partial(isolated, _as_policy, ["NaN", "infinity"], folder, 300)
    )
