"""The ratios of `benchmarks/guard.py`: which one fell, and that each times what it says."""

import json
from collections.abc import Callable, Sequence

import guard
import pytest

from humanoid_mjx import compute


class Clock:
    """Time that passes only where a call says so."""

    now = 0.0

    def __call__(self) -> float:
        return self.now

    def taking(self, *seconds: float) -> Callable[[], None]:
        """A call that takes the first of `seconds`, then the next, and so on; the last for ever."""
        left = list(seconds)

        def call() -> None:
            self.now += left.pop(0) if len(left) > 1 else left[0]

        return call


def pair(subject: Sequence[float], reference: Sequence[float], work: float = 1.0) -> guard.Pair:
    clock = Clock()
    return guard.Pair(clock.taking(*subject), clock.taking(*reference), work, repeats=2, clock=clock)


def test_the_guard_finds_the_ratio_that_fell(capsys):
    ratios = {
        "same": lambda: pair([3.0, 1.0], [8.0, 2.0]),  # the fastest of each: 2
        "slower": lambda: pair([1.0], [1.0], work=5.0),
        "new": lambda: pair([1.0], [1.0]),
    }
    found = guard.run({"same": 2.6, "slower": 7.0}, ratios)
    assert [(ratio.name, ratio.value, ratio.fell) for ratio in found] == [
        ("same", 2.0, False),
        ("slower", 5.0, True),
        ("new", 1.0, False),
    ]
    assert [line.endswith("FELL") for line in capsys.readouterr().out.splitlines()] == [False, True, False]
    assert "fell slower to 0.71;" in guard.verdict(found)
    assert guard.verdict(found[:1]).startswith("None of 1")
    # A machine that is busy for two repeats of three times two: what seems to have fallen is timed again.
    (ratio,) = guard.run({"one": 4.0}, {"one": lambda: pair([9.0, 9.0, 1.0], [4.0])})
    assert ratio.value == 4.0 and not ratio.fell


def test_the_guard_ends_with_one_where_a_ratio_fell(tmp_path, monkeypatch, capsys):
    record = tmp_path / "guard.json"
    monkeypatch.setattr(guard, "RATIOS", {"one": lambda: pair([1.0], [3.0])})
    monkeypatch.setattr(guard, "RECORD", record)
    monkeypatch.setattr(compute, "start", lambda **_: None)
    assert ended("--json", str(record)) == 0 and "not in the record" in capsys.readouterr().out
    written = json.loads(record.read_text())
    assert written["ratios"] == {"one": 3.0} and {"machine", "versions", "commit"} <= set(written)
    assert ended() == 0
    monkeypatch.setattr(guard, "RATIOS", {"one": lambda: pair([2.0], [3.0])})
    capsys.readouterr()
    assert ended() == 1 and "Of its recorded value fell one to 0.50; 0.75 is allowed." in capsys.readouterr().out


def ended(*arguments: str) -> int:
    """The exit code of the guard."""
    with pytest.raises(SystemExit) as ending:
        guard.main(arguments)
    return int(ending.value.code)


def test_the_committed_record_has_every_ratio():
    assert set(json.loads(guard.RECORD.read_text())["ratios"]) == set(guard.RATIOS)
