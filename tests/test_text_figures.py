"""The figures of README.md are those of the records that it links, to the digits printed."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from text_claims import NUMBER, RECORDS, ROOT, Claim, greedy_gaits, tables

from humanoid_mjx.reproduction import load_experiments

README = (ROOT / "README.md").read_text(encoding="utf-8")


def table_with(markdown: str, heading: str) -> list[list[str]]:
    """The only table whose first cell, or whose first column, has `heading`."""
    (found,) = (rows for rows in tables(markdown) if heading in [row[0] for row in rows])
    return found


# How `walk` walks: a row for each command, a column for each figure of the record.

GAIT = {
    "upright": ("success", 100.0),
    "speed": ("forward", 1.0),
    "turn rate": ("turn", 1.0),
    "slip": ("slip", 1.0),
    "in flight": ("flight", 100.0),
    "steps": ("step_frequency", 1.0),
}
"""By how a column's heading begins: the record's name, and by what it is multiplied."""


def walking(markdown: str, records: Mapping[str, Any]) -> Iterator[Claim]:
    (rows,) = (rows for rows in tables(markdown) if rows[0][0] == "command" and "upright" in rows[0][1])
    (name,) = re.findall(r"bench/(\w+\.json)\)+:\s+\| command ", markdown)
    gaits = records[name]["results"][0]["gaits"]
    for row in rows[1:]:
        command = [0.0, 0.0, 0.0]
        for number, unit in re.findall(rf"({NUMBER}) (m/s|rad/s)", row[0]):
            command[2 if unit == "rad/s" else 1 if re.search("left|right|side", row[0]) else 0] = float(number)
        (gait,) = (
            g for g in gaits if (g["agent"], g["command"]) == ("greedy", command) and g["scenario"] != "sudden turn"
        )
        for heading, cell in zip(rows[0][1:], row[1:], strict=True):
            (known,) = (GAIT[start] for start in GAIT if heading.startswith(start))
            figure, factor = gait["figures"][known[0]], known[1]
            printed = re.findall(NUMBER, cell)
            values = [figure["median"], *figure["seeds"][0][1:]]  # of one seed: with the interval over episodes
            if len(figure["seeds"]) > 1:
                values[1:] = [min(of_seed := [seed[0] for seed in figure["seeds"]]), max(of_seed)]
            for text, value in zip(printed, values, strict=False):
                yield Claim(name, f"walk, {row[0]}, {heading}", text, value * factor)


# Speed: groups of rows below a row that gives the sizes.

SPEED = {
    "`bench physics`": {
        "`chain`": ("chain", "control+physics steps/s"),
        "`mjx-jax`": ("mjx-jax", "control+physics steps/s"),
        "`mjx-jax`, without our XLA flags": ("mjx-jax plain", "control+physics steps/s"),
        "native MuJoCo on all cores, no controller": ("mujoco", "physics steps/s"),
    },
    "the lower body on the ground": {
        "`tree`": ("tree ground", "control+physics steps/s"),
        "`mjx-jax`": ("mjx-jax ground", "control+physics steps/s"),
        "`mjx-jax`, computed torque within the contacts": ("mjx-jax computed torque ground", "control+physics steps/s"),
        "`mjx-warp`": ("mjx-warp ground", "control+physics steps/s"),
        "native MuJoCo on all cores (its own servo)": ("mujoco ground", "control+physics steps/s"),
    },
    "`bench tabular`": {
        "`scan`, what a sweep runs on a CPU": ("scan", "steps/s"),
        "`fused`, what it runs on a GPU": ("fused", "steps/s"),
        "`cuda`, a kernel written by hand with CuPy": ("cuda", "steps/s"),
        "`naive_scan`, `jax.random` in every step": ("naive_scan", "steps/s"),
        "`numba`, all cores": ("numba", "steps/s"),
    },
}
MACHINES = {"2 CPU cores": "cpu_2_cores.json", "one H200": "h200.json"}


def speeds(markdown: str, records: Mapping[str, Any]) -> Iterator[Claim]:
    rows = table_with(markdown, "**`bench physics`**")
    machines = {column: name for column, name in enumerate(rows[0]) if name}
    assert set(machines.values()) == set(MACHINES)
    group, sizes, firsts = "", {}, {}
    for row in rows[1:]:
        if row[0].strip("*") in SPEED:
            group, firsts = row[0].strip("*"), {}
            sizes = {column: int(row[column].split()[0].replace(",", "")) for column in machines}
            continue
        subject, unit = SPEED[group][row[0]]
        for column, machine in machines.items():
            name = MACHINES[machine]
            if not re.match(NUMBER, row[column]):
                assert row[column + 1] == "" and row[column] in ("", "not recorded yet")
                continue
            value = measured(records[name]["records"], SPEED[group].values(), sizes[column], subject, unit)
            yield Claim(name, f"{group}, {row[0]}, {machine}", row[column], value)
            first = firsts.setdefault(column, value)
            for times, sense in re.findall(rf"({NUMBER}) times (slower|faster)", row[column + 1]):
                ratio = first / value if sense == "slower" else value / first
                yield Claim(name, f"{group}, {row[0]}, {machine}, times {sense}", times, ratio)


def measured(found: list[dict[str, Any]], group: Any, size: int, subject: str, unit: str) -> float:
    """The figure of a subject, measured beside the group's first that has this size. Native MuJoCo has its own size."""
    names = {name for name, _ in group}
    begin = next(i for i, record in enumerate(found) if record["subject"] in names and record["batch"] == size)
    return next(r["value"] for r in found[begin:] if (r["subject"], r["unit"]) == (subject, unit))


# Training of all learners: five seeds of each.

TRAINED = {"steps to 95 %": "steps to 95 %", "success": "success at the end", "episodes a second": "episodes/s"}
"""By how a row's name begins: the unit of the record."""


def trainings(markdown: str, records: Mapping[str, Any]) -> Iterator[Claim]:
    (rows,) = (rows for rows in tables(markdown) if rows[0][1:] == ["`linear_q`", "`deep_q`", "`brax_ppo`"])
    for row in rows[1:]:
        (unit,) = (TRAINED[start] for start in TRAINED if row[0].startswith(start))
        (name,) = re.findall(r"bench/(\w+\.json)\)", row[0])
        for learner, cell in zip(rows[0][1:], row[1:], strict=True):
            of = f"{learner.strip('`')} leg_reach"
            (record,) = (r for r in records[name]["records"] if (r["subject"], r["unit"]) == (of, unit))
            values = [record["value"]]
            if unit == "steps to 95 %":
                assert len(record["by_seed"]) >= 5 and "never" not in cell
                values.append(max(record["by_seed"]))
            elif unit == "success at the end":
                values = [*values, *record["interval"], min(record["by_seed"])]
            printed = re.findall(NUMBER, cell)
            assert len(printed) == len(values), cell
            yield from (Claim(name, f"{row[0]}, {learner}", text, x) for text, x in zip(printed, values, strict=True))


# Sentences: what each pattern's groups must be, from a record.


def of_stand(record: Any) -> list[float]:
    found = record["records"][0]
    success = np.array(found["greedy_success_by_seed"])
    reached = np.maximum.accumulate(success, axis=1) > 0.9
    back = success[:, 1:][reached[:, :-1]].min()
    last = success[:, -1]
    times = "training_begins_s", "command_s"
    speed = found["command_s"], found["training_begins_s"], found["steps_per_s"], found["second_time"][times[0]]
    alone = [of(one[name] for one in found["one_seed"]) for name in times for of in (min, max)]
    return [len(success), found["total_steps"][-1] / 1e6, last.mean(), last.min(), back, *speed, *alone]


def of_stand_on_a_cpu(record: Any) -> list[float]:
    without, mean, *_ = record["records"]
    ends = [np.array(one["greedy_success_by_seed"])[:, -1] for one in (without, mean)]
    minutes = without["one_seed_wall_s"] / 60, without["wall_s"] / 60
    told = [without["total_steps"][-1] / 1e6, minutes[0], without["runs"], len(ends[0]), minutes[1]]
    return [*told, *(float(of(end)) for end in ends for of in (np.median, np.min))]


def of_computed_torque(record: Any) -> list[float]:
    (found,) = record["records"]
    last = np.array(found["greedy_success_by_seed"])[:, -1]
    rate, steps = found["steps_per_s"], found["total_steps"][-1] / 1e6
    return [rate, steps, len(last), last.mean(), last.min(), last.max()]


def of_postures(record: Any) -> list[float]:
    subjects = ("chain posture_switch", "mjx-jax posture_switch")
    return [r["value"] for s in subjects for r in record["records"] if (r["subject"], r["unit"]) == (s, "episodes/s")]


def of_one_kernel(record: Any) -> list[float]:
    return [record[kind]["control steps/s of training"] for kind in ("one_kernel", "kernels of XLA")]


def of_walk(record: Any) -> list[float]:
    """What README says of `walk` beside the table."""
    gaits = greedy_gaits(record)
    heading, turns = gaits["forward 0.3"]["heading_error"], gaits["sudden turn"]["turn_success"]
    training = record["training"]
    return [
        *(len(record["results"][0]["policies"]), training["runs"], training["command_s"], training["steps"] / 1e6),
        *(gaits["sideways +0.15"]["left"]["median"], heading["median"], heading["worst"]),
        *(100 * turns["median"], 100 * turns["worst"]),
    ]


def of_ppo(record: Any) -> list[float]:
    """What README says of PPO on `walk`."""
    gaits, training = greedy_gaits(record), record["training"]
    turns = gaits["sudden turn"]["turn_success"]
    assert turns["median"] == turns["worst"]
    speeds = [gaits[f"forward {speed}"]["forward"]["median"] for speed in (0.5, 0.8)]
    slip = gaits["forward 0.3"]["slip"]["median"]
    own = greedy_gaits(record, 1)
    speeds_of_walk = [own[f"forward {speed}"]["forward"]["median"] for speed in (0.5, 0.8)]
    told = training["runs"], training["command_s"], training["steps"] / 1e6
    return [slip, 100 * turns["worst"], *speeds, *told, *speeds_of_walk]


def of_grounded(record: Any) -> list[float]:
    """What README says of `walk` under computed torque within the contacts."""
    gaits = greedy_gaits(record)
    fastest = max(figures["forward"]["median"] for name, figures in gaits.items() if name.startswith("forward"))
    return [fastest, record["training"]["steps"] / 1e6]


def of_experiments(record: Any) -> list[float]:
    """Those that there still are. A study of 41 s that was an experiment, too, when the record was made has left."""
    own = load_experiments().keys()
    gone = sum(seconds for name, seconds in record["wall_s"].items() if name not in own)
    return [len(own), (record["command_s"] - gone) / 60, sum(record["cpu_s"][name] for name in own) / 60]


def of_both_legs(record: Any) -> list[float]:
    (found,) = record["records"]
    runs = np.array([point["greedy_success_by_seed"] for point in found["points"]])
    return [found["episodes"], runs.sum(), runs.size, *runs.shape]


def of_few_agents(record: dict[str, Any]) -> list[float]:
    """numba against this package, with 1,024 agents and with one."""
    rates = {(r["subject"], r["batch"]): r["value"] for r in record["records"] if r["unit"] == "steps/s"}
    return [rates["numba", batch] / rates["scan", batch] for batch in (1024, 1)]


def of_two_devices(record: dict[str, Any]) -> list[float]:
    """Medians of the efficiency of sweeps of tables and of networks, and of environments."""
    return [float(np.median(found["efficiency"])) for found in record["devices"].values() if isinstance(found, dict)]


def of_table_kernel(found: dict[str, Any]) -> list[float]:
    """`fused`, and against CUDA by hand, with its own random numbers and with this package's."""
    fused, *by_hand = [value for name, value in found["table_kernel"]["now"].items() if name != "commit"]
    return [fused, *(fused / rate for rate in by_hand)]


WORDS = {"one": 1, "two": 2, "four": 4, "five": 5, "eight": 8, "ten": 10, "sixteen": 16}

SENTENCES = [
    (
        "h200_stand_8_seeds.json",
        rf"`stand` with `deep_q`, (\w+) seeds side by side on one H200.*? after ({NUMBER})M control steps is "
        rf"({NUMBER}) in the mean of the seeds and ({NUMBER}) in the worst of them; none that had reached 0\.9 was "
        rf"below ({NUMBER}) later\. The command took ({NUMBER}) s, ({NUMBER}) s of it before .*? makes ({NUMBER}) "
        rf"control steps a second\. The second time, .*? began after ({NUMBER}) s\. Commands of one seed, .*? after "
        rf"({NUMBER}) to ({NUMBER}) s and were done after ({NUMBER}) to ({NUMBER}) s\.",
        of_stand,
    ),
    (
        "cpu_2_cores_stand.json",
        rf"`humanoid-mjx sweep stand_cpu` .*? for ({NUMBER})M control steps.*? ({NUMBER}) minutes for one seed.*? "
        rf"(\w+) runs side by side, (\w+) seeds without and with .*?, take ({NUMBER}) minutes; they end at ({NUMBER}) "
        rf"in the median and ({NUMBER}) in the worst without it, at ({NUMBER}) and ({NUMBER}) with it",
        of_stand_on_a_cpu,
    ),
    (
        "h200_stand_mjx.json",
        rf"`stand_mjx` trains .*?, at ({NUMBER}) control steps a second on one H200\. After ({NUMBER})M of them (\w+) "
        rf"seeds stand through ({NUMBER}) of their episodes in the mean, from ({NUMBER}) in the worst to ({NUMBER}) in",
        of_computed_torque,
    ),
    (
        "h200_walk_seeds.json",
        rf"`walk` is learned by every one of (\w+) seeds.*? (\w+) runs side by side on one H200, takes ({NUMBER}) s "
        rf"for ({NUMBER})M control steps of each.*? sideways at 0\.15 m/s it does, at ({NUMBER})\..*? "
        rf"the heading is off by ({NUMBER}) degrees \(({NUMBER}) with the worst seed\);.*? within 1\.5 s in "
        rf"({NUMBER})% of episodes \(({NUMBER})% with the worst seed\)",
        of_walk,
    ),
    (
        "h200_walk_ppo.json",
        rf"Brax's PPO on the same task.*? slips about as much \(({NUMBER}) m/s at 0\.3 m/s\), and turns at once in "
        rf"({NUMBER})% of episodes.*? at 0\.5 and 0\.8 m/s it goes at ({NUMBER}) and ({NUMBER}) m/s\. Its (\w+) seeds, "
        rf"one after the other, took ({NUMBER}) s for ({NUMBER})M control steps.*? With the clock and the reward of "
        rf"`walk` it goes at ({NUMBER}) and ({NUMBER}) m/s",
        of_ppo,
    ),
    (
        "h200_walk_control.json",
        rf"deep Q-learning stays up as surely and goes no faster than ({NUMBER}) m/s after ({NUMBER})M steps",
        of_grounded,
    ),
    (
        "cpu_2_cores.json",
        rf"`posture_switch` end to end makes on two CPU cores ({NUMBER}) episodes a second on the chain and "
        rf"({NUMBER}) on MJX",
        of_postures,
    ),
    (
        "cpu_2_cores.json",
        rf"`numba` is the faster one with few agents, ({NUMBER}) times with 1,024 and ({NUMBER}) times with one;",
        of_few_agents,
    ),
    (
        "cpu_2_cores_in_turn.json",
        rf"Two CPU devices, .*? a sweep at ({NUMBER}) \(tables\) and ({NUMBER}) \(.*?\) of twice the rate of one, and "
        rf"a run whose environments they share at ({NUMBER})",
        of_two_devices,
    ),
    (
        "h200_in_turn.json",
        rf"In turn with the CUDA kernel it makes ({NUMBER}) steps a second, ({NUMBER}) of what that makes, .*? and "
        rf"({NUMBER}) of what it makes with this",
        of_table_kernel,
    ),
    ("h200.json", rf"`posture_switch` .*? MJX; on one H200 ({NUMBER}) and ({NUMBER})", of_postures),
    (
        "cpu_2_cores_posture_switch_mjx.json",
        rf"`posture_switch_mjx` .*? after ({NUMBER}) episodes ({NUMBER}) of ({NUMBER}) runs, (\w+) points of (\w+) "
        "seeds, reach the goal",
        of_both_legs,
    ),
    (
        "cpu_2_cores_reproduce.json",
        rf"All ({NUMBER}) experiments are done in ({NUMBER}) minutes on two cores, ({NUMBER}) of processor time",
        of_experiments,
    ),
    (
        "h200_one_kernel.json",
        rf"`walk` trains ({NUMBER}) control steps a second where XLA's own kernels made ({NUMBER})",
        of_one_kernel,
    ),
]


def sentences(markdown: str, records: Mapping[str, Any]) -> Iterator[Claim]:
    plain = " ".join(markdown.split())
    for name, pattern, of in SENTENCES:
        found = re.findall(pattern, plain)
        assert len(found) == 1, f"{name}: the sentence that gives its figures: {pattern}"
        for text, value in zip(found[0], of(records[name]), strict=True):
            yield Claim(name, pattern, str(WORDS.get(text.lower(), text)), value)


READERS = (walking, speeds, trainings, sentences)


def claims(markdown: str = README, records: Mapping[str, Any] = RECORDS) -> list[Claim]:
    return [claim for reader in READERS for claim in reader(markdown, records)]


@pytest.mark.parametrize("reader", READERS)
def test_no_figure_of_the_readme_is_contradicted_by_its_record(reader):
    found = list(reader(README, RECORDS))
    assert found and not [claim for claim in found if not claim.holds]


WITHOUT_FIGURES = {"guard.json"}
"""Records that are linked, whose figures are not in a table or sentence of a form that is read here."""


def test_every_record_that_the_readme_links_is_compared_with_it():
    linked = set(re.findall(r"docs/bench/(\w+\.json)", README))
    assert linked - WITHOUT_FIGURES <= {claim.record for claim in claims()}


def test_pages_but_the_readme_print_no_speed():
    """Benchmarks' page says so; then nothing there can contradict a record."""
    for page in (ROOT / "docs").glob("*.md"):
        text = " ".join(page.read_text(encoding="utf-8").split())
        rate = rf"{NUMBER} (?:control |physics )?(?:steps|episodes) (?:a|per) second"
        assert not re.findall(rf"{rate}|{NUMBER} times (?:faster|slower|as fast)", text), page.name


def changed(text: str) -> str:
    """A number with its last printed digit another one."""
    place = max(i for i, letter in enumerate(text.partition("e")[0]) if letter.isdigit())
    return text[:place] + str((int(text[place]) + 2) % 10) + text[place + 1 :]


def test_a_digit_that_changes_is_found():
    for claim in claims():
        assert claim.holds and not claim._replace(printed=changed(claim.printed)).holds, claim
        assert not claim._replace(value=1.2 * claim.value + 1.0).holds, claim


def test_a_figure_that_changes_in_a_copy_of_the_readme_is_found():
    """Those that stand there once, one after another."""
    once = [claim for claim in claims() if README.count(claim.printed) == 1]
    assert len(once) > 10
    for claim in once:
        text = README.replace(claim.printed, changed(claim.printed))
        assert [other for other in claims(text) if not other.holds], claim


def shifted(record: Any) -> Any:
    """A copy of a record whose figures are others; commands, by which figures are found, stay."""
    if isinstance(record, dict):
        return {key: value if key == "command" else shifted(value) for key, value in record.items()}
    if isinstance(record, list):
        return [shifted(value) for value in record]
    return 1.3 * record + 0.1 if isinstance(record, float) else record


@pytest.mark.parametrize("reader", READERS)
def test_a_record_that_changes_is_found(reader):
    for name in {claim.record for claim in reader(README, RECORDS)}:
        changed_records = RECORDS | {name: shifted(RECORDS[name])}
        assert [claim for claim in reader(README, changed_records) if not claim.holds], name
