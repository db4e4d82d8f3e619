"""What one process leaves on disk for the next."""

import os
import pwd
import subprocess
import sys

import jax
import numpy as np
import pytest
from small_sweep import assert_same_tables, run_cli, write_config

from humanoid_mjx import compute
from humanoid_mjx.compute import kept
from humanoid_mjx.files import DIGEST
from humanoid_mjx.kernels import cpu_kernel
from humanoid_mjx.tasks import make_task
from humanoid_mjx.tasks.legged.stand import Stand


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "_on", True)
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "xla"))
    yield tmp_path / "xla"
    jax.config.update("jax_compilation_cache_dir", before)


def test_what_is_kept_is_found_as_long_as_nothing_differs(folder, monkeypatch):
    kept.put("a", "this", {"x": 1})
    assert kept.find("a", "this") == {"x": 1}
    assert kept.find("a", "that") is None and kept.find("b", "this") is None
    assert kept.remembered("a", "this", lambda: 2) == {"x": 1}
    monkeypatch.setattr(kept, "_surroundings", lambda: b"other code".ljust(DIGEST))
    assert kept.find("a", "this") is None
    kept.put("a", "this", 3)
    assert kept.find("a", "this") == 3
    assert len(list(folder.iterdir())) == 1  # another version's takes no room


def test_what_is_damaged_or_not_to_be_kept_is_made_anew(folder, monkeypatch):
    kept.put("a", "this", list(range(100)))
    (file,) = folder.iterdir()
    data = bytearray(file.read_bytes())
    for place in (0, DIGEST, len(data) - 1):
        wrong = bytes(data[:place]) + bytes([data[place] ^ 1]) + bytes(data[place + 1 :])
        file.write_bytes(wrong)
        assert kept.find("a", "this") is None
    file.write_bytes(data[:50])
    assert kept.remembered("a", "this", lambda: 7) == 7
    assert kept.find("a", "this") == 7
    kept.put("a", None, 1)
    kept.put("a", "a function at 0x7f", 1)
    kept.put("b", "that", lambda: 1)  # cannot be pickled
    monkeypatch.setattr(kept, "_on", False)
    kept.put("c", "that", 1)
    assert list(folder.iterdir()) == [file]


def test_one_of_another_name_in_the_place_of_one_is_not_used(folder):
    """As where a backup was restored wrongly."""
    kept.put("a", "this", 1)
    kept.put("a", "that", 2)
    one, other = folder.iterdir()
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    assert kept.find("a", "this") is None and kept.find("a", "that") is None
    one.unlink()
    os.mkfifo(one)  # to read it would wait forever, and to write it, too
    assert kept.remembered("a", "this", lambda: 3) == kept.remembered("a", "that", lambda: 3) == 3


def test_a_user_without_a_home_folder_keeps_nothing(monkeypatch):
    """A container may run as a user that its password file lacks."""

    def unknown(number):
        raise KeyError(number)

    for name in ("HOME", "XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", unknown)
    found = {}
    monkeypatch.setattr(jax.config, "update", lambda name, value: found.update({name: value}))
    compute.start()
    assert found["jax_compilation_cache_dir"] is None
    monkeypatch.setenv("HOME", "/home/me")
    compute.start()
    assert found["jax_compilation_cache_dir"] == "/home/me/.cache/humanoid_mjx/xla"


def test_programs_follow_from_structure_and_shapes_and_not_from_values():
    stand, arrays = make_task("stand"), np.zeros(3, np.float32)
    told = kept.about(stand, arrays)
    assert told == kept.about(make_task("stand", mass=1.2), arrays)
    others = make_task("stand", period=0.04), make_task("stand", sensors={"delay": 2})
    assert len({told, kept.about(stand, arrays[:2]), *(kept.about(other, arrays) for other in others)}) == 4

    class Mine(Stand):
        pass

    assert kept.about(Mine(), arrays) is None


@pytest.mark.parametrize(("devices", "damaged"), [("1", False), ("2", True)])
def test_a_second_sweep_traces_nothing_and_finds_the_same(tmp_path, monkeypatch, devices, damaged):
    """A third, after what is kept was damaged, traces again."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "xla"))
    config = write_config(tmp_path)
    first = run_cli("sweep", config, "--out", "first", cwd=tmp_path, devices=devices)
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "xla").glob("*-traced")}
    assert {path.name.split("-")[0] for path in files} == {"run", "bytes", "begin", "advance", "finish"}
    second = run_cli("sweep", config, "--out", "second", cwd=tmp_path, devices=devices)
    assert " tracing" in first.stdout and " tracing" not in second.stdout, second.stdout + second.stderr
    assert_same_tables(tmp_path / "first", tmp_path / "second")
    assert files == {path: path.stat().st_mtime_ns for path in (tmp_path / "xla").glob("*-traced")}
    if damaged:
        for path in files:
            os.truncate(path, path.stat().st_size // 2)
        third = run_cli("sweep", config, "--out", "third", cwd=tmp_path, devices=devices)
        assert " tracing" in third.stdout, third.stdout + third.stderr
        assert_same_tables(tmp_path / "first", tmp_path / "third")


CALLS_A_KERNEL = """
from functools import partial
import jax, numpy as np
from humanoid_mjx.compute import kept
from humanoid_mjx.kernels.cpu_kernel import cpu_kernel

x = np.linspace(-1.0, 1.0, 40, dtype=np.float32)
with kept.keeping():
    stored = kept.find("program", "this")
    if stored is None:
        program, keep = kept.compile_program("program", "this", jax.jit(partial(cpu_kernel, lambda x: x * x)).lower(x))
        keep()
    else:
        program = kept.load_program(stored, (x,), jax.devices()[:1])
np.testing.assert_array_equal(program(x), x * x)
print("found" if stored else "made")
"""


def test_a_program_finds_its_kernels_in_another_process(tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("XLA_FLAGS", "")
    for expected in ("made", "found"):
        found = subprocess.run([sys.executable, "-c", CALLS_A_KERNEL], capture_output=True, text=True, check=False)
        assert found.stdout == f"{expected}\n", found.stderr
    (file,) = tmp_path.glob("*-object")
    file.write_bytes(file.read_bytes()[:-1])  # damaged: compiled anew where it is traced again
    for path in tmp_path.glob("*-traced"):
        path.unlink()
    found = subprocess.run([sys.executable, "-c", CALLS_A_KERNEL], capture_output=True, text=True, check=False)
    assert found.stdout == "made\n", found.stderr


def test_kernels_exchanged_on_disk_are_compiled_again(folder):
    codes = {f"humanoid_mjx_{number}": f"define i32 @call() {{ ret i32 {number} }}" for number in (1, 2)}
    objects = {name: cpu_kernel._compiled(name, code) for name, code in codes.items()}
    one, other = folder.iterdir()
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    assert {name: cpu_kernel._compiled(name, code) for name, code in codes.items()} == objects
    assert len(set(objects.values())) == 2 and one.read_bytes() == content
