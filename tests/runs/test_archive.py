"""Archives of arrays: read by their declared sizes, so that none takes more memory than it may."""

import io
import json
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
from small_sweep import CONFIG

from humanoid_mjx import InputError, sweep
from humanoid_mjx.evaluation.policy import find_policy, read_policy, save_policy
from humanoid_mjx.runs.archive import read_archive

SIZE = 60_000_000
"""Bytes of zeros that a file of some kB holds."""

PEAK = 30_000_000
"""Bytes that a refusal may take, and more than it takes."""


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    """A policy file, and its arrays."""
    folder = tmp_path_factory.mktemp("archive")
    run = sweep(CONFIG | {"sweep": None, "seeds": 1, "episodes": 20}, folder / "run").path
    save_policy(find_policy(run), folder / "good.npz")
    with np.load(folder / "good.npz") as file:
        return folder / "good.npz", dict(file)


def bomb(name, compression=zipfile.ZIP_DEFLATED, dtype="<f4"):
    """An archive whose array `name` is zeros of `SIZE` bytes."""
    array, file = io.BytesIO(), io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": (SIZE // np.dtype(dtype).itemsize,)}
    np.lib.format.write_array_header_1_0(array, header)
    with zipfile.ZipFile(file, "w", compression) as archive, archive.open(f"{name}.npy", "w") as member:
        member.write(array.getvalue())
        for _ in range(100):
            member.write(bytes(SIZE // 100))
    return file.getvalue()


def with_member(data, name, content):
    """An archive with one more member."""
    file = io.BytesIO(data)
    with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return file.getvalue()


def refusal(call):
    """The sentence of an InputError, and the bytes that its way there took."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            call()
        return str(caught.value), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize("lies", [False, True])
def test_a_bomb_is_refused_before_it_is_inflated(tmp_path, compression, lies):
    """Also one whose directory says that it is small, as that of `zipfile` may: a reader that believes it still gets
    all that the stream holds."""
    path, data = tmp_path / "bomb.npz", bomb("point", compression)
    if lies:
        size = SIZE + 128  # and the header of the array
        assert struct.pack("<I", size) in data
        data = data.replace(struct.pack("<I", size), struct.pack("<I", 200))
    path.write_bytes(data)
    assert len(data) < 1_000_000
    words, peak = refusal(lambda: read_archive(path))
    assert words.startswith((f"{path}: this file is ", f"{path}: what it holds does not fit")) and "\n" not in words
    assert peak < PEAK


def test_members_that_nobody_asked_for_are_not_inflated(tmp_path):
    path = tmp_path / "part.npz"
    path.write_bytes(with_member(bomb("curve"), "point.npy", saved(np.arange(3))))
    tracemalloc.start()
    assert read_archive(path, ("point",))["point"].tolist() == [0, 1, 2]
    assert tracemalloc.get_traced_memory()[1] < PEAK
    tracemalloc.stop()


def saved(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def test_a_policy_bomb_is_refused_by_its_shapes(policy, tmp_path):
    """In the place of the weights, beside them, and in the place of the header."""
    good, arrays = policy
    (name,) = (name for name in arrays if name.startswith("policy"))
    path = tmp_path / "policy.npz"
    for member, words in ((name, "does not fit"), ("more", "does not fit"), ("header", "does not fit")):
        kind = "<U250" if member == "header" else "<f4"
        data = bomb(member, dtype=kind)
        for other in arrays.keys() - {member}:
            data = with_member(data, f"{other}.npy", saved(arrays[other]))
        path.write_bytes(data)
        said, peak = refusal(lambda: read_policy(path))
        assert said.startswith(f"{path}: ") and words in said and "\n" not in said and peak < PEAK, said
    assert read_policy(good)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(policy, tmp_path, said, monkeypatch, number):
    _, arrays = policy
    (name,) = (name for name in arrays if name.startswith("policy"))
    monkeypatch.chdir(tmp_path)
    weights = arrays[name].copy()
    weights.flat[-1] = number
    np.savez("bad.npz", **(arrays | {name: weights}))
    for command in (["evaluate", "bad.npz"], ["play", "bad.npz"], ["export", "bad.npz", "x.c"]):
        code, _, err = said(*command)
        assert code == 2 and err.count("\n") == 1, err
        assert err.startswith(f"error: bad.npz: this policy holds numbers that are not finite, in {name}; "), err
    assert not (tmp_path / "x.c").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"point": -5}, "point must be at least 0, got -5"),
        ({"point": 10**30}, "point must be less than"),
        ({"seed": True}, "seed must be a valid integer, got True"),
        ({"seed": 1.5}, "seed must be a valid integer, got 1.5"),
        ({"name": 7}, "name must be text, got 7; put it into quotes"),
        ({"config": "walk"}, "config must be a mapping of keys"),
        ({"more": 1}, "more: unknown key; known are config, format, name, origin, point, seed"),
        ({"origin": [["scores", {}]]}, "origin must be"),
        ({"origin": 3}, "origin must be"),
        ({"origin": {"scores": {}}}, "origin.provenance: this key is required"),
        ({"origin": {"scores": {}, "provenance": []}}, "origin.provenance must be a mapping of keys"),
        (
            {"origin": {"scores": {}, "provenance": {}, "by": "x"}},
            "origin.by: unknown key",
        ),
        (
            {"origin": {"scores": {"final.greedy_return": "9"}, "provenance": {}}},
            "greedy_return must be a valid",
        ),
        ({"origin": {"scores": {"best": 9.0}, "provenance": {}}}, "origin.scores.best"),
    ],
)
def test_a_header_of_other_parts_is_refused(policy, tmp_path, change, words):
    _, arrays = policy
    header, path = json.loads(str(arrays["header"])), tmp_path / "odd.npz"
    np.savez(path, **(arrays | {"header": np.array(json.dumps(header | change))}))
    with pytest.raises(InputError) as caught:
        read_policy(path)
    said = str(caught.value)
    assert said.startswith(f"{path}: header.") and words in said and said.endswith("; export it again from its run.")


def test_an_array_that_no_policy_has_is_refused(policy, tmp_path):
    _, arrays = policy
    np.savez(tmp_path / "more.npz", **arrays, extra=np.zeros(3, np.float32))
    with pytest.raises(InputError, match=r"more\.npz: extra: a policy has no such array; export it again from its run"):
        read_policy(tmp_path / "more.npz")
