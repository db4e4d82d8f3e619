"""Tables and numbers of how `walk` walks, each made from records in docs/bench."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from statistics import mean, median
from typing import Any, NamedTuple

from chapter_8_verdicts import Record, findings
from tables import record, rounded, spread, table

COMMANDS: list[str] = record("h200_walk_learning")["commands"]
"""Those that all records have: to stand, to go ahead at four speeds, to turn, a curve, a sudden turn."""


class Walk(NamedTuple):
    """Trained policies, one a seed."""

    steps: float
    """Of the training of each."""
    seeds: Callable[[str, str], list[float]]
    """A figure under a command, of each seed."""

    def median(self, figure: str, command: str) -> float:
        return median(self.seeds(figure, command))


def _evaluated(name: str, result: int = 0) -> Walk:
    """Return the policies of a result of `evaluate --gait`."""
    found = record(name)["results"][result]
    gaits = {gait["scenario"]: gait["figures"] for gait in found["gaits"] if gait["agent"] == "greedy"}
    steps = found["policies"][0]["config"]["total_steps"]
    return Walk(steps, lambda figure, command: [seed[0] for seed in gaits[command][figure]["seeds"]])


def walk() -> str:
    """Return how the shipped setting walks, by command."""
    of, rows = _evaluated("h200_walk"), []
    for name in (*COMMANDS[:5], "turn +0.5", *COMMANDS[5:7], "sideways +0.15"):
        ahead, upright = spread(of.seeds("forward", name), 2), spread(of.seeds("success", name), 0, 100)
        moves = (rounded(of.median(figure, name), 2) for figure in ("left", "turn"))
        feet = rounded(of.median("slip", name), 3), rounded(100 * of.median("flight", name), 1)
        rows.append((name, upright, ahead, *moves, *feet, rounded(of.median("step_frequency", name), 1)))
    speeds, feet = "forward, m/s | left, m/s | turn, rad/s", "slip, m/s | in flight, % | steps a second"
    return table(f"command, m/s and rad/s | upright for 20 s, % | {speeds} | {feet}", rows)


def walk_goals() -> str:
    """Return what was aimed for, and what was reached under the hardest of the commands."""
    goals = (
        ("stays up for 20 s, standing and at up to 0.8 m/s, %", "success", COMMANDS[:5], 100, "at least", 98),
        ("mean error of the speed at up to 0.5 m/s, m/s", "speed_error", COMMANDS[1:4], 1, "at most", 0.05),
        ("the same at 0.8 m/s, m/s", "speed_error", COMMANDS[4:5], 1, "at most", 0.05),
        ("heading off after 20 s straight ahead, degrees", "heading_error", COMMANDS[1:5], 1, "at most", 10),
        ("slip at up to 0.5 m/s, m/s", "slip", COMMANDS[1:4], 1, "at most", 0.03),
        ("time with both feet in the air at up to 0.5 m/s, %", "flight", COMMANDS[1:4], 100, "at most", 0),
        ("difference of the sides at up to 0.5 m/s, %", "duty_asymmetry", COMMANDS[1:4], 100, "at most", 10),
        ("error of the turn rate at 1 rad/s, rad/s", "turn_error", ("turn +1.0", "turn -1.0"), 1, "at most", 0.15),
        ("drift while it stands for 20 s, cm", "drift", ("stand",), 100, "at most", 2),
        ("sudden turns by 45 degrees within 1.5 s, %", "turn_success", ("sudden turn",), 100, "at least", 90),
    )
    here, there = _evaluated("h200_walk_seeds"), _evaluated("cpu_2_cores_walk_mujoco")
    rows = []
    for words, figure, commands, scale, sense, aim in goals:
        worst = min if sense == "at least" else max
        middle, last, native = (
            rounded(scale * worst(of(policies.seeds(figure, command)) for command in commands))
            for policies, of in ((here, median), (here, worst), (there, median))
        )
        met = float(middle) >= aim if sense == "at least" else float(middle) <= aim
        rows.append((words, f"{sense} {aim}", middle, last, native, "yes" if met else "**no**"))
    return table("what | aim | median of the seeds | worst seed | median in native MuJoCo | reached", rows)


def _compared(policies: Mapping[str, Walk]) -> str:
    """Return how well policies of several trainings walk: medians over seeds."""
    rows = []
    for words, of in policies.items():
        size = str(len(of.seeds("success", "stand"))), rounded(of.steps / 1e6)
        upright = rounded(100 * min(share for command in COMMANDS for share in of.seeds("success", command)), 0)
        speeds = ", ".join(rounded(of.median("forward", command), 2) for command in COMMANDS[2:5])
        slips = ", ".join(rounded(of.median("slip", command), 3) for command in COMMANDS[2:4])
        rows.append((words, *size, upright, speeds, slips, spread(of.seeds("turn_success", "sudden turn"), 0, 100)))
    told = "speed at 0.3, 0.5, 0.8 m/s | slip at 0.3, 0.5 m/s"
    return table(f"training | seeds | steps, millions | least upright, % | {told} | sudden turns, %", rows)


def walk_learners() -> str:
    """Return how well `walk` is learned by other learners and under another control law."""
    return _compared(
        {
            "`deep_q`, as `walk` is, in bfloat16": _evaluated("h200_walk"),
            "that, slip costs twice as much at most": _evaluated("h100_walk"),
            "turn 0.4, yawing -0.5, as `walk` was": _evaluated("h100_walk_40m"),
            "that, as `walk_quick` is": _evaluated("h100_walk_quick"),
            "that, in float32, twice the steps of the second row": _evaluated("h200_walk_seeds"),
            "that, slip weighs -1.8, not -2.4": _evaluated("h200_walk_seeds", 1),
            "that, under computed torque": _evaluated("h200_walk_control"),
            "`brax_ppo`, as `walk_ppo` is": _evaluated("h200_walk_ppo"),
            "the same, clock and reward of `walk`": _evaluated("h200_walk_ppo", 1),
        }
    )


def _series(name: str) -> str:
    """Return how well the policies of all settings of a record walk."""

    def of(one: dict[str, Any]) -> Walk:
        return Walk(one["steps"], lambda figure, command: [x[COMMANDS.index(command)] for x in one["figures"][figure]])

    return _compared({one["setting"]: of(one) for one in record(name)["settings"]})


def _median(values: Iterable[float | None], places: int) -> str:
    """Return the median of the seeds that walked long enough to have the figure."""
    known = [x for x in values if x is not None]
    return rounded(median(known), places) if known else "none"


def _in_worlds(name: str) -> str:
    """Return how policies of a record walk in its worlds: medians over seeds, with the worst seed in brackets."""
    rows = []
    for row in record(name)["rows"]:
        seeds = range(len(row["success"][0]))
        least = sorted(100 * min(by_seed[seed] for by_seed in row["success"]) for seed in seeds)
        mean = sorted(100 * sum(by_seed[seed] for by_seed in row["success"]) / len(row["success"]) for seed in seeds)
        by_command = {figure: dict(zip(row["commands"], row[figure], strict=True)) for figure in ("forward", "slip")}
        speeds, slips = (
            ", ".join(_median(by_command[figure][f"forward {told}"], places) for told in speeds.split())
            for figure, places, speeds in (("forward", 2, "0.3 0.5 0.8"), ("slip", 3, "0.3 0.5"))
        )
        turns = row["turn_success"][row["commands"].index("sudden turn")]
        turned = spread([100 * (share or 0.0) for share in turns], 0)
        upright = (f"{rounded(median(of), 0)} ({rounded(of[0], 0)})" for of in (mean, least))
        rows.append((row["world"], f"`{row['policy']}`", str(len(seeds)), *upright, speeds, slips, turned))
    told = "speed at 0.3, 0.5, 0.8 m/s | slip at 0.3, 0.5 m/s"
    upright = "upright for 20 s, mean of all commands, % | under the worst command, %"
    return table(f"world | policy | seeds | {upright} | {told} | sudden turns, %", rows)


def chapter_8() -> str:
    """Return the verdicts on what chapter 8 says of the design."""
    found = findings(Record(record("chapter_8")))
    return table(
        "verdict | quantity: of the two bodies | found", ((one.verdict, one.quantity, one.why) for one in found)
    )


def walk_fast() -> str:
    """Return how fast bodies go: of each setting the fastest command under which 90 % stay up."""
    rows = []
    for row in record("walk_fast")["rows"]:
        means = [sum(seeds) / len(seeds) for seeds in row["success"]]
        kept = [at for at, mean in enumerate(means) if mean >= 0.9]
        at = max(kept, key=lambda at, row=row: median(row["forward"][at]), default=None)
        changed = ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in row["changed"].items())
        if at is None:
            rows.append((changed, *["none"] * 7))
            continue
        numbers = (spread(row[name][at], places) for name, places in (("forward", 2), ("froude", 2)))
        feet = (rounded(100 * median(row["flight"][at]), 1), rounded(median(row["slip"][at]), 3))
        cost = rounded(median(row["cost_of_transport"][at]), 2)
        rows.append((changed, row["commands"][at].split()[1], rounded(100 * means[at], 0), *numbers, *feet, cost))
    head = "setting | command | upright, % | speed, m/s | Froude number | in flight, % | slip, m/s | cost of transport"
    return table(head, rows)


def _by_command(name: str, native: str = "") -> str:
    """Return how the policies of a record walk, by command, and how many stay upright by that in native MuJoCo."""
    rows, there = [], _gaits(native) if native else {}
    for scenario, of in _gaits(name).items():
        places = {"forward": 2, "left": 2, "turn": 2, "slip": 3}
        moves = [_median(of[name], to) for name, to in places.items()]
        moves.append(_median([share and 100 * share for share in of["flight"]], 0))
        upright = [spread(each[scenario]["success"], 0, 100) for each in (_gaits(name), there) if each]
        rows.append((scenario, *upright, *moves))
    upright = "upright for 20 s, %" + " | in native MuJoCo, %" * bool(native)
    head = f"command, m/s and rad/s | {upright} | forward, m/s | left, m/s | turn, rad/s | slip, m/s | in flight, %"
    return table(head, rows)


def _gaits(name: str) -> dict[str, dict[str, list[Any]]]:
    """Return the figures of a record's policies, seed by seed, by command."""
    gaits = (gait for gait in record(name)["results"][0]["gaits"] if gait["agent"] == "greedy")
    return {
        gait["scenario"]: {figure: [x[0] for x in of["seeds"]] for figure, of in gait["figures"].items()}
        for gait in gaits
    }


def _shares(upright: dict[str, list[float]], worlds: Sequence[str], of: Callable[[list[float]], float]) -> list[str]:
    """Return the mean or the median share of the seeds that stay up in each of these worlds, in %."""
    return [rounded(100 * of(upright[world]), 0) if world in upright else "none" for world in worlds]


def _trials(part: str, *worlds: str) -> str:
    """Return which shares of the seeds stay up in these worlds, setting by setting."""
    rows = ((one["setting"], *_shares(one["upright"], worlds, mean)) for one in record("walk_trials")[part])
    return table(f"setting | {' | '.join(worlds)}", rows)


def walk_cpu_trials() -> str:
    """Return the trials of `walk_cpu`: how many seeds stand, and meet all its aims, and how they walk."""
    rows = []
    for one in record("walk_cpu_trials")["trials"]:
        of = one["by_command"]
        stand, ahead, turned = of["stand"]["success"], of["forward 0.3"]["forward"], of["sudden turn"]["turn_success"]
        moving = [min(shares) for shares in zip(*(of[name]["success"] for name in of if name != "stand"), strict=True)]
        speeds, turns = ([x or 0.0 for x in seeds] for seeds in (ahead, turned))
        aims = zip(stand, moving, speeds, turns, strict=True)
        met = sum(up >= 0.95 and stays >= 0.9 and speed >= 0.25 and turn >= 0.8 for up, stays, speed, turn in aims)
        counts = rounded(one["steps"] / 1e6, 0), str(len(stand)), str(sum(up >= 0.95 for up in stand)), str(met)
        walks = rounded(100 * min(moving), 0), spread(speeds, 2), spread(turns, 0, 100)
        rows.append((one["setting"], one["where"], *counts, *walks))
    head = "setting | where | steps, millions | seeds | that stand | that meet all aims | least upright when moving, %"
    return table(f"{head} | speed at 0.3 m/s | sudden turns, %", rows)


def walk_turns() -> str:
    """Return the trials of rewards of `walk`: who turns at once, who stays up, and how fast."""
    rows = []
    for one in record("walk_turns")["trials"]:
        turned = f"{rounded(100 * median(one['sudden']), 0)} ({rounded(100 * min(one['sudden']), 0)})"
        most = rounded(100 * mean(share >= 0.85 for share in one["sudden"]), 0)
        speeds = ", ".join(rounded(median(seeds), 2) for seeds in one["forward"].values())
        size = str(len(one["sudden"])), rounded(one["steps"] / 1e6, 0)
        rows.append((one["setting"], *size, turned, most, rounded(100 * min(one["upright"]), 1), speeds))
    turns = "sudden turns, % | seeds that do at least 85 % of them, %"
    return table(f"setting | seeds | steps, millions | {turns} | least upright, % | speed at 0.3, 0.5, 0.8 m/s", rows)


def upright_trials() -> str:
    """Return the trials of `walk_sturdy` by share of slopes and weight of `upright`: who stays up, and how fast."""
    rows = []
    for one in record("walk_trials")["upright"]:
        shares = _shares(one["upright"], ALL, median)
        worst = rounded(100 * min(one["upright"][SLOPING[0]]), 0)
        speeds = (rounded(median(seeds), 2) for seeds in one["forward"].values())
        size = str(one["seeds"]), rounded(one["steps"] / 1e6, 0)
        rows.append((one["setting"], *size, *shares, worst, ", ".join(speeds)))
    of_worlds = f"{' | '.join(ALL)} | the worst seed on the slope"
    return table(f"setting | seeds | steps, millions | {of_worlds} | speed at 0.3, 0.5, 0.8 m/s", rows)


PUSHED = "pushed by 0.5 N s every 3 s", "pushed by 0.8 N s every 3 s", "friction 0.3", "motors of 0.6 N m"
SLOPING = "a slope of 8 degrees", "waves of 10 mm", "stairs of 10 mm"
ALL = *PUSHED[1:], SLOPING[0], SLOPING[2]
"""Worlds of the trials' tables."""

WORLDS = "walk_worlds", "walk_worlds_mujoco", "walk_faults", "walk_observe"
"""Records of policies in worlds."""

TABLES = (
    {of.__name__: of for of in (walk, walk_goals, walk_learners, walk_turns, chapter_8, walk_fast)}
    | {of.__name__: of for of in (upright_trials, walk_cpu_trials)}
    | {name: partial(_in_worlds, name) for name in WORLDS}
    | {
        "walk_dog": lambda: _by_command("cpu_2_cores_walk_dog"),
        "walk_humanoid": lambda: _by_command("h200_walk_humanoid", "h200_walk_humanoid_mujoco"),
        "walk_gaits": lambda: _series("h200_walk_gaits"),
        "walk_slip": lambda: _series("h200_walk_slip"),
        "walk_cpu": lambda: _by_command("h100_walk_cpu"),
        "walk_trials": lambda: _trials("trials", *PUSHED),
        "one_policy": lambda: _trials("one_policy", *ALL),
        "terrain_trials": lambda: _trials("terrain", *SLOPING),
        "walk_learning": lambda: _series("h200_walk_learning"),
        "walk_sturdy_minutes": lambda: rounded(record("walk_worlds")["trained"]["walk_sturdy"]["command_s"] / 60),
        "walk_cpu_minutes": lambda: rounded(median(record("walk_cpu_trials")["command_s"]) / 60),
        "walk_dog_seconds": lambda: rounded(record("h200_walk_dog")["training"]["command_s"]),
        "walk_humanoid_seconds": lambda: rounded(record("h200_walk_humanoid")["training"]["command_s"]),
        "walk_seconds": lambda: rounded(record("h200_walk")["training"]["command_s"]),
        "walk_minutes": lambda: rounded(record("h200_walk")["training"]["command_s"] / 60),
        "two_settings_minutes": lambda: rounded(record("h200_walk_seeds")["training"]["command_s"] / 60),
    }
)
