"""Tables and numbers of README.md and docs/, each made from records in docs/bench.

A page says `<!-- record: NAME -->` and `<!-- end -->`. Between the two `build.py` writes what the function of that name
returns, of `TABLES` here or in `walking_tables.py`.
"""

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from humanoid_mjx.reproduction.findings import MEANINGS
from humanoid_mjx.runs.statistics import estimate

BENCH = Path(__file__).parent / "bench"


def record(name: str) -> Any:
    """Return a record of docs/bench."""
    return json.loads((BENCH / f"{name}.json").read_text(encoding="utf-8"))


def rounded(value: float, places: int | None = None) -> str:
    """Return a number with so many decimal places, by default with two significant digits."""
    if places is None and abs(value) >= 1e6:
        return f"{value:.1e}".replace("e+0", "e").replace("e+", "e")
    if places is None:
        value = float(f"{value:.1e}")
        places = max(0, 1 - math.floor(math.log10(abs(value)))) if value else 0
    return f"{round(value, places) + 0.0:,.{places}f}"


def spread(values: Sequence[float], places: int | None = None, scale: float = 1.0) -> str:
    """Return the median, and in brackets the least and the greatest where they read otherwise."""
    middle, *ends = (rounded(scale * of(values), places) for of in (median, min, max))
    return middle if ends == [middle, middle] else f"{middle} ({' to '.join(ends)})"


def table(head: str, rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown. `head`: the headings, with bars between them."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join([f"| {head} |", "|---" * (head.count(" | ") + 1) + "|", *lines])


GROUND = {
    "`tree`": "tree",
    "`mjx-jax`, at most four solver iterations": "mjx-jax",
    "`mjx-warp`": "mjx-warp",
    "native MuJoCo on all cores": "mujoco",
}
SPEED: tuple[tuple[str, str, tuple[int, int], dict[str, str]], ...] = (
    ("the lower body, thrown about", "robots", (4096, 32_768), {w: f"lower_body {name}" for w, name in GROUND.items()}),
    ("a dog, thrown about", "robots", (4096, 32_768), {words: f"dog {name}" for words, name in GROUND.items()}),
    (
        "legs in the air, computed torque",
        "legs",
        (1024, 262_144),
        {
            "`chain`": "legs chain",
            "`mjx-jax`": "legs mjx-jax",
            "`mjx-jax`, without our XLA flags": "legs mjx-jax plain",
            "native MuJoCo on all cores, no controller": "legs mujoco",
        },
    ),
    (
        "tabular Q-learning of joint 1",
        "agents",
        (65_536, 1_048_576),
        {
            "`fused`, one kernel, which a sweep runs": "fused",
            "`scan`, a loop of XLA": "scan",
            "`naive_scan`, `jax.random` in every step": "naive_scan",
            "`numba`, all cores": "numba",
        },
    ),
    (
        "training of `posture_switch`, episodes a second",
        "",
        (0, 0),
        {"`chain`": "posture_switch chain", "`mjx-jax`": "posture_switch mjx-jax"},
    ),
)
"""Groups of subjects: what a batch counts, the batch on a CPU and on a GPU, 0 where there is none, and the words for
each subject of the records. The first subject of a group is the one that the others are compared with."""

TRAININGS = {
    "`walk_cpu`, one seed": "walk_cpu",
    "`walk`, five seeds": "walk",
    "`leg_reach_linear`, five seeds": "leg_reach_linear",
    "`leg_reach`, five seeds": "leg_reach",
    "`leg_reach_ppo`, five seeds": "leg_reach_ppo",
}


def speed_records() -> list[Any]:
    """Return the records of `benchmarks/publish.py` on a CPU and on a GPU; of a machine without one its empty lists."""
    names = "speed_cpu", "speed_gpu"
    nothing = {"records": [], "failed": [], "scenes": {}}
    return [record(name) if (BENCH / f"{name}.json").is_file() else nothing for name in names]


def speed_machines() -> str:
    """Return which machines were measured, when the code was at which commit, by which command."""
    rows = []
    for heading, found in zip(machine_names(), speed_records(), strict=True):
        if machine := found.get("machine"):
            cpu = f"{machine['cpu']}, {machine['cpu_count']} cores"
            device = "" if machine["backend"] == "cpu" else f"{machine['device']}; "
            where = f"[{heading}](bench/speed_{machine['backend']}.json)"
            jax, failed = found["versions"]["jax"], str(len(found["failed"]))
            rows.append((where, device + cpu, jax, f"`{found['commit'][:12]}`", f"`{found['command']}`", failed))
        else:
            rows.append((heading, "not measured yet", "", "", "", ""))
    return table("record | machine | jax | commit | command | rows without a figure", rows)


def speed() -> str:
    """Return the rates of both machines, each beside the first of its group."""
    machines, rows = speed_records(), []
    for heading, counted, batches, subjects in SPEED:
        rows.append((f"**{heading}**", *(f"{batch:,} {counted}" * bool(batch) for batch in batches)))
        columns = [_rates(*each, subjects) for each in zip(machines, batches, strict=True)]
        rows += zip(subjects, *columns, strict=True)
    return table(" | ".join(("steps a second", *machine_names())), rows)


def speed_training() -> str:
    """Return the decisions a second of trainings on both machines."""
    columns = [[cell.partition(" (")[0] for cell in _rates(found, 0, TRAININGS)] for found in speed_records()]
    return table(" | ".join(("decisions a second", *machine_names())), zip(TRAININGS, *columns, strict=True))


def speed_startup() -> str:
    """Return how soon a sweep trains, by the clock, with nothing compiled before it and the second time."""
    columns = [
        {row["subject"]: row["value"] for row in found["records"] if row["unit"] == "s to training"}
        for found in speed_records()
    ]
    rows = []
    for config in ("joint1", "leg_reach", "walk_cpu", "walk"):
        cells = [[found[key] for kind in ("cold", "warm") if (key := f"{config} {kind}") in found] for found in columns]
        if any(cells):
            rows.append((f"`{config}`", *(" then ".join(map(rounded, times)) for times in cells)))
    return table(" | ".join(("seconds to training", *machine_names())), rows)


def speed_scenes() -> str:
    """Return the contacts and solver iterations of the scenes on the ground."""
    rows, names = [], {"lower_body": "the lower body", "dog": "the dog"}
    scenes = {name: scene for found in reversed(speed_records()) for name, scene in found["scenes"].items()}
    for name, scene in scenes.items():
        cells = (f"{rounded(scene[n])}, at most {scene[f'most {n}']:.0f}" for n in ("contacts", "solver iterations"))
        rows.append((names[name], *cells))
    return table("scene | contacts of a robot | iterations of MuJoCo's solver a step", rows)


def machine_names() -> list[str]:
    """Return the words for the two machines."""
    words = []
    for name, found in zip(("two CPU cores", "one GPU"), speed_records(), strict=True):
        machine = found.get("machine")
        gpu = machine and machine["backend"] == "gpu"
        words.append(f"one {machine['device'].split()[1]}" if gpu else name)
    return words


def _rates(found: Any, batch: int, subjects: dict[str, str]) -> list[str]:
    """Return the rate of each subject, and how many times slower or faster it is than the first."""
    rates: dict[str, float] = {}
    for row in found["records"]:
        if batch in (0, row["batch"]) or "mujoco" in row["subject"]:  # which has a batch of its own
            rates.setdefault(row["subject"], row["value"])  # of figures of a subject the first is the rate
    why = {row["subject"]: row["why"] for row in reversed(found["failed"])}
    first, cells = rates.get(next(iter(subjects.values()))), []
    for name in subjects.values():
        if name not in rates:
            cells.append("" if name not in why else "not installed" if "not installed" in why[name] else "not measured")
            continue
        times = rates[name] / first if first else 1.0
        apart, sense = rounded(max(times, 1 / times)), "faster" if times > 1 else "slower"
        cells.append(rounded(rates[name]) + f" ({apart} times {sense})" * (apart != "1.0"))
    return cells


def stand() -> str:
    """Return how soon and how well bodies learn to stand."""
    trainings = (
        ("`stand`, one H100", "h100_stand_8_seeds", 0),
        ("the same again", "h100_stand_8_seeds", 1),
        ("a learning rate of 0.002, epsilon_decay 0.9, one H200", "h200_stand_8_seeds", 2),
        ("the same in float32, a learning rate of 0.001", "h200_stand_8_seeds", 0),
        ("the same, a mean of the weights for the policy", "h200_stand_8_seeds", 1),
        ("`stand_cpu`, two CPU cores", "cpu_2_cores_stand", 0),
        ("the same, a mean of the weights for the policy", "cpu_2_cores_stand", 1),
        ("the same, mirrored experience (`task.symmetric`)", "cpu_2_cores_stand", 2),
        ("the same, a learning rate of 0.001 instead of 0.002", "cpu_2_cores_stand", 3),
        ("`stand_mjx`, one H200", "h200_stand_mjx", 0),
    )
    rows = []
    for words, name, place in trainings:
        found = record(name)["records"][place]
        seeds, steps = found["greedy_success_by_seed"], [n / 1e6 for n in found["total_steps"]]
        there = median(min([n for n, x in zip(steps, seed, strict=True) if x >= 0.95] + [math.inf]) for seed in seeds)
        soon = rounded(there) if there < math.inf else "not reached"
        rows.append((words, str(len(seeds)), rounded(steps[-1]), soon, spread([seed[-1] for seed in seeds], 2)))
    return table("training | seeds | steps, millions | steps to 95 % success, millions | success at the end", rows)


def learners() -> str:
    """Return what success on `leg_reach` takes each learner, and how fast it trains on two machines."""
    cpu, gpu = ({(row["subject"], row["unit"]): row for row in found["records"]} for found in speed_records())
    rows = []
    for name, of in (("linear_q", "leg_reach_linear"), ("deep_q", "leg_reach"), ("brax_ppo", "leg_reach_ppo")):
        cells = ["not measured"] * 3
        both = [found for found in (cpu, gpu) if (of, "steps to 95 %") in found]
        if both:
            steps, end = (both[0][of, unit]["by_seed"] for unit in ("steps to 95 %", "success at the end"))
            steps = [math.inf if x is None else x for x in steps]
            interval = " to ".join(rounded(x, 3) for x in estimate(np.array(end), 0.0, 1.0)[1:])
            cells = [spread(steps).replace("inf", "never"), spread(end, 3), interval]
        rates = (found.get((of, "episodes/s"), {}).get("value") for found in (cpu, gpu))
        rows.append((f"`{name}`", *cells, *("not measured" if x is None else rounded(x) for x in rates)))
    head = "learner | steps to 95 % success | success at the end | 95 % interval of its median"
    return table(" | ".join((f"{head} | episodes a second, {machine_names()[0]}", machine_names()[1])), rows)


def other_physics() -> str:
    """Return what policies reach on each physics of their task, with 95 % intervals."""
    rows = []
    for row in record("cpu_2_cores_other_physics")["results"]:
        if agents := row.get("agents"):
            cells = [f"`{row['policy']}`", f"`{row['physics']}`{', its own' * (row['physics'] == row['trained_on'])}"]
            for agent, name, scale in (("greedy", "success", 100), ("greedy", "return", 1), ("random", "success", 100)):
                values = agents[agent][name], *agents[agent][f"{name}_interval"]
                cells.append("{} ({} to {})".format(*(rounded(scale * x, int(scale == 1)) for x in values)))
            rows.append(cells)
    return table("policy of | physics | success, % | return | success of random choices, %", rows)


def faults() -> str:
    """Return what was tried to break trainings, files and configs, and what came of it."""
    rows = []
    for row in record("faults")["rows"]:
        ends = ", ".join(f"{count:,} {words}" for words, count in row["outcomes"].items())
        rows.append((row["fault"], row["subject"], f"{row['tries']:,}", ends))
    return table("fault | tried on | tries | what happened", rows)


def clusters() -> str:
    """Return how long a large sweep takes by simulation, and what it moves."""
    rows = []
    for row in record("scheduler")["rows"]:
        alike, uneven, taken = row["alike"], row["uneven"], row["taken"]
        rows.append((
            f"{row['gpus']}",
            f"{alike['makespan_s'] / 3600:,.2f} h",
            f"{alike['idle_share']:.1%}",
            f"{uneven['makespan_s'] / 3600:,.2f} h, {uneven['ideal_s'] / uneven['makespan_s']:.1%}",
            f"{taken['makespan_s'] / 3600:,.2f} h, {taken['taken']}, {taken['repeated_s'] / 3600:.2f} h",
            f"{row['result_bytes_per_s'] / 1e6:,.1f} MB/s",
        ))  # fmt: skip
    head = "GPUs | all alike | of that idle | speeds differ: time, share of the ideal"
    return table(f"{head} | taken away, too: time, how often, GPU time repeated | results to the driver", rows)


def other_robots() -> str:
    """Return which robots of others the tree takes, and by how much it differs from native MuJoCo."""
    rows = []
    for row in record("other_robots")["rows"]:
        name, refused = f"`{row['model'].removesuffix('.xml')}`", row.get("refused")
        if refused:
            reasons = [reason.split(",")[0].removeprefix("contacts of ") for reason in refused]
            more = [f"{len(reasons) - 3} more"] * (len(reasons) > 4)
            reasons = [*reasons[:3], *more] if more else reasons
            rows.append((name, str(row["degrees of freedom"]), "refused: " + ", ".join(reasons), ""))
        else:
            ground, bodies = (f"{count:,}" for count in row["contacts"])
            worst, lost = max(row["acceleration"], row["velocity"]), row["unsettled"]
            but = f", {lost} of {row['worlds']} states left out" * bool(lost)
            rows.append((name, str(row["degrees of freedom"]), f"{ground}, {bodies}", f"{worst:.0e}{but}"))
    return table("model | degrees of freedom | contacts with the ground, between bodies | largest difference", rows)


def other_robots_taken() -> str:
    """Return how many robots of others the tree takes."""
    rows = record("other_robots")["rows"]
    return f"{sum('refused' not in row for row in rows)} of {len(rows)}"


def unmodified() -> str:
    """Return how often shipped policies stay upright on the robot of the YAML and on its unmodified file."""
    rows = []
    for row in record("cpu_2_cores_unmodified")["evaluations"]:
        if row["agent"] == "greedy":
            name, _, other = row["policy"].partition(", ")
            share = "{} ({} to {})".format(*(rounded(100 * x, 0) for x in (row["success"], *row["success_interval"])))
            rows.append((f"`{name}`", f"`{other or 'mujoco'}`", share, rounded(row["return"], 0)))
    return table("policy | physics | upright to the end, % | return", rows)


COMMANDS = "stand", "forward", "turn"
"""How the commands begin that each seed plays in a robot's own file."""


def _public(ships: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """The rows of public robots as they ship, or of other trials, each with what trained it."""
    for card in ("h100", "h200"):
        for row in record(f"{card}_public_robots")["rows"]:
            if row["robot"] != "t1_stiff" and row.get("ships", False) == ships:  # it is a trial that did not help
                device = row["machine"]["device"] if "machine" in row else card
                yield row.get("cores") or device.upper().removeprefix("NVIDIA ").split()[0], row


def _named(row: dict[str, Any]) -> str:
    return ", ".join([f"`{row['robot']}`", *filter(None, [row.get("gains")])])


def _trained(row: dict[str, Any]) -> tuple[str, str]:
    """The config of a row with its keys, and in how many of all episodes the worst and the best seed stayed upright."""
    seeds = [each["greedy_success"] for each in row["seeds"]]
    words = row.get("words") or "`" + " ".join([row["config"], *(f"--set {each}" for each in row["set"][2:])]) + "`"
    return words, " to ".join(rounded(100 * each, 0) for each in (min(seeds), max(seeds)))


def _ahead(row: dict[str, Any]) -> list[dict[str, Any]]:
    """The commands to go ahead as fast as in training."""
    return [each for words, each in row["gait"].items() if words.startswith("forward ")][:-1]


def _goes(row: dict[str, Any]) -> list[str]:
    return [f"{each['moves'][0]:z.2f} of {each['told'][0]:.2f}" for each in _ahead(row)]


def _best_in_file(row: dict[str, Any]) -> str:
    found = row.get("unmodified", {}).get(f"{row['robot']}, unmodified, greedy")
    return rounded(100 * found[0], 0) if found else ""


def public_robots() -> str:
    """Return how public robots stay upright after a training, here and in their own files."""
    rows = []
    for card, row in _public(ships=True):
        made = row.get("alone", row)
        seconds = f"{rounded(made['command_s'], 0)}, {card}" if made["command_s"] else ""
        played = [each for words, each in row.get("unmodified_gait", {}).items() if words.startswith(COMMANDS)]
        all_seeds = rounded(100 * float(np.mean([each["upright"] for each in played])), 0) if played else ""
        error = rounded(max(each["error"] for each in played)) if played else ""
        words, upright = _trained(row)
        rows.append((_named(row), words, seconds, upright, _best_in_file(row), all_seeds, error))
    own = "own file, %: best | all seeds | error, m/s"
    return table(f"robot | config | s, on | upright, five seeds, % | {own}", rows)


def public_robots_go() -> str:
    """Return how public robots go and turn after a training, and how the worst seed stays upright."""
    rows = []
    for _, row in _public(ships=True):
        ahead = min(each["upright"][1] for each in _ahead(row))
        stand, turn, sudden = (row["gait"][name] for name in ("stand", "turn +1.0", "sudden turn"))
        worst = [rounded(100 * each, 0) for each in (stand["upright"][1], ahead, sudden["upright"][1])]
        rows.append((_named(row), *_goes(row), rounded(turn["moves"][2]), *worst))
    goes, falls = "goes, m/s: slowly | faster | fast", "worst seed upright, %: standing | ahead | sudden turns"
    return table(f"robot | {goes} | turns, of 1 rad/s | {falls}", rows)


def public_robots_tried() -> str:
    """Return what else was tried with public robots."""
    rows = [(_named(row), *_trained(row), *_goes(row), _best_in_file(row)) for _, row in _public(ships=False)]
    return table("robot | config | upright, % | goes, m/s: slowly | faster | fast | own file, best, %", rows)


def _on_cards(config: str, cards: int) -> str:
    """Return how many times as fast as on one card a sweep trains on several."""
    found = {row["cards"]: row["first"] for row in record("h200_scaling")["rows"] if row["config"] == config}
    return rounded(found[cards]["steps_per_s"] / found[1]["steps_per_s"])


def scaling() -> str:
    """Return how much faster sweeps train on several cards of one host, and how long the commands take."""
    found, rows = record("h200_scaling")["rows"], []
    for config in dict.fromkeys(row["config"] for row in found):
        made = {row["cards"]: row["first"] for row in found if row["config"] == config}
        sets = next(row["set"] for row in found if row["config"] == config)
        times = [rounded(made[cards]["steps_per_s"] / made[1]["steps_per_s"]) if cards in made else ""
                 for cards in (2, 4)]  # fmt: skip
        seconds = ", ".join(rounded(one["command_s"], 0) for one in made.values())
        same = "yes" if len({one["tables"] for one in made.values()}) == 1 else "no"
        words = " ".join([config, *(f"--set {each}" for each in sets)])
        rows.append((f"`{words}`", rounded(made[1]["steps_per_s"]), *times, seconds, same))
    columns = "steps/s on one | times as fast on two | on four | command on 1, 2, 4, s | same tables"
    return table(f"`sweep` | {columns}", rows)


def ranges() -> str:
    """Return what the body can do with each column of joint ranges."""
    names = (
        "margin in one sole, the other lifted, leaning up to 1 degrees, mm",
        "margin in one sole, both flat, anywhere, leaning up to 45 degrees, mm",
        "margin in one sole, both flat below the hips, mm",
        "least lean on one foot, degrees",
        "toes in, degrees",
        "toes out, degrees",
        "turn of a foot swept while it stands, rad/s",
        "speed on flat feet, hips level, m/s",
        "speed over the toes, m/s",
    )
    found = record("feasibility")["ranges"]
    rows = ((name, *(rounded(x, 2 if name.endswith("m/s") else 1) for x in found[name].values())) for name in names)
    return table("with the soles flat | `proposed` | `human`", rows)


def verdicts() -> str:
    """Return how many quantities of the thesis have each verdict."""
    counts = record("cpu_2_cores_reproduce")["verdicts"]
    rows = ((f"`{name}`", str(counts[name]), meaning) for name, meaning in MEANINGS.items() if name in counts)
    return table("verdict | quantities | what it says", rows)


def parity() -> str:
    """Return what learners reach on tasks of the literature, with intervals."""
    found, rows = record("parity")["found"], []
    words = {"cliff walking": "`tabular_q`", "mountain car": "`linear_q`", "cart pole": "`deep_q`"}
    for name, figures in found.items():
        task, _, other = name.partition(", ")
        means = ("return while learning, last fifth", "return of the greedy policy")
        cells = ("{} ({} to {})".format(*(rounded(x, 0) for x in figures[key])) for key in means)
        unit = next(unit for unit in ("steps", "episodes") if f"{unit} of a seed" in figures)
        samples = f"{figures[f'{unit} of a seed']:,} {unit}"
        times = (rounded(figures[key], 0) for key in ("processor_s", "wall_s"))
        rows.append((task, other or words[task], *cells, samples, *times))
    head = "task | learner | return while learning | return of the greedy policy | samples of a seed"
    return table(f"{head} | processor time of ten seeds, s | wall time, s", rows)


def methods_tasks() -> str:
    """Return how soon the methods of tables learn the thesis's tasks."""
    rows = []
    for task, found in record("methods")["compare"]["found"].items():
        for way, figures in found["ways"].items():
            chosen = ", ".join(f"{key} {value:g}" for key, value in figures["chosen"].items())
            keys = "steps while learning", "beside q_learning", "greedy steps"
            cells = ("{} ({} to {})".format(*(rounded(x, 1) for x in figures[key])) for key in keys)
            rows.append((task, way, chosen, *cells, "yes" * (way in found["not worse than the best"])))
            task = ""
    head = "task | way | chosen | steps while learning | beside Q-learning | greedy steps at the end"
    return table(f"{head} | as good as the best", rows)


def methods_cliff() -> str:
    """Return what the methods of tables reach on the cliff."""
    rows = []
    for method, figures in record("methods")["walk"]["found"].items():
        if isinstance(figures, dict):
            online = "{} ({} to {})".format(*(rounded(x, 1) for x in figures["return while learning, last fifth"]))
            seeds = sorted(figures["seeds by greedy return"].items(), key=lambda item: -item[1])
            rows.append((f"`{method}`", online, ", ".join(f"{value} ({count} seeds)" for value, count in seeds)))
    return table("method | return while learning, last 100 episodes | return of the greedy policy", rows)


def _exact(policy: str) -> str:
    """Return the exact mean return of a policy on the cliff."""
    return rounded(record("methods")["walk"]["found"][f"exact return of {policy} while exploring"], 1)


def methods_grid() -> str:
    """Return the value of the start of a grid by one table and by two."""
    exact, *learned = record("methods")["overestimate"]["found"].items()
    rows = [(f"`{method}`", "{} ({} to {})".format(*(rounded(x, 1) for x in value))) for method, value in learned]
    return table("method | value of the start", [("exact", rounded(exact[1], 2)), *rows])


def methods_car() -> str:
    """Return the steps of an episode on the mountain car, by step size and part of the training."""
    found = {name: by for name, by in record("methods")["drive"]["found"].items() if isinstance(by, dict)}
    parts = [part for part in next(iter(next(iter(found.values())).values())) if part != "curve"]
    rows = [
        (alpha, learner, *("{} ({} to {})".format(*(rounded(x, 0) for x in figures[part])) for part in parts))
        for alpha, by in found.items()
        for learner, figures in by.items()
    ]
    return table(f"alpha | learner | {' | '.join(f'episodes {part}' for part in parts)}", rows)


def halving() -> str:
    """Return what halving finds of what a whole search finds, and the processor time that it takes."""
    rows = []
    for name in ("maze", "leg_reach", "leg_reach_early"):
        found = record(f"halving_{name}")
        keys, repeats = found["halving"], found["repeats"]
        budget, unit = found["config"].get("episodes"), "episodes"
        budget, unit = (budget, unit) if budget else (found["config"]["total_steps"], "steps")
        size = f"{found['points']} points, {found['config']['seeds']} seeds, {budget:,} {unit}"
        same = sum(each["best"]["random"] == each["best"]["halving"] for each in repeats)
        good = sum(each["found"] for each in repeats)
        ranks = sorted(each["rank_of_halving"] for each in repeats)
        equal = sorted(each["as_good"] for each in repeats)
        shares = sorted(each["seconds"]["halving"] / each["seconds"]["random"] for each in repeats)
        shares = [f"{share:.0%}" for share in shares]
        cells = f"{keys['rungs']} rungs, eta {keys['eta']}", f"{same} of {len(repeats)}", f"{good} of {len(repeats)}"
        rows.append((f"`{found['search']}`", size, *cells, *map(_range, (ranks, equal, shares))))
    head = "search | size | halving | the same best | the best or as good | rank of its best among all"
    return table(f"{head} | points as good as the best | processor time", rows)


def _range(ordered: Sequence[object]) -> str:
    """Return the ends of sorted values in words."""
    return f"{ordered[0]} to {ordered[-1]}" if ordered[0] != ordered[-1] else str(ordered[0])


def methods_proof() -> str:
    """Return how the methods of tables agree with an independent implementation."""
    rows = []
    for found in record("methods")["prove"]["found"]:
        words = (f"`{found[key]}`" for key in ("method", "exploration", "step_size", "decay"))
        differ = str(found["seeds that differ by more than 1e-5"])
        far = rounded(found["largest z of a cell's mean"], 1)
        rows.append((*words, differ, f"{far} of {found['cells']}"))
    head = "`method` | `exploration` | `step_size` | `decay` | from the same numbers: seeds that differ by 1e-5"
    return table(f"{head} | from other numbers: largest distance", rows)


def robot_speeds() -> str:
    """Return how fast robots of others are when thrown about, beside native MuJoCo on a CPU and MJX on a GPU."""
    robots = {"mujoco": record("robot_speeds_cpu")["robots"], "mjx-jax": record("robot_speeds_gpu")["robots"]}
    names = {"lower_body": "the lower body", "go1": "Go1", "h1": "H1", "g1": "G1", "humanoid": "MuJoCo's humanoid"}
    rows = []
    for name, words in names.items():
        cells = []
        for other, found in robots.items():
            tree, beside = (found[name]["subjects"][subject] for subject in ("tree", other))
            if "failed" in tree:
                cells += ["none", "none", tree["failed"]]
                continue
            rate, ratio = tree["steps/s"], tree["steps/s"] / beside["steps/s"]
            start = sum(tree[f"{stage}_s"] for stage in ("trace", "lower", "compile"))
            cells += [rounded(rate), rounded(ratio), rounded(start, 0)]
        rows.append((words, *cells))
    cpu, gpu = "CPU, steps a second | times MuJoCo | start, s", "GPU, steps a second | times MJX | start, s"
    return table(f"robot | {cpu} | {gpu}", rows)


def _own_minutes(key: str) -> str:
    """Return what the commands with which a robot of one's own learns to stand take together."""
    return rounded(sum(each[key] for each in record("cpu_2_cores_your_robot")["commands"]) / 60)


def faster_than_mjx() -> str:
    """Return how many times as fast as MJX the tree is on a GPU, for many robots that are thrown about."""
    rates = {row["subject"]: row["value"] for row in reversed(speed_records()[1]["records"])}
    if not {"lower_body tree", "lower_body mjx-jax"} <= set(rates):
        return "On a GPU it has not been measured"
    times = rounded(rates["lower_body tree"] / rates["lower_body mjx-jax"], 0)
    return f"On {machine_names()[1]} it runs {times} times as fast as MJX"


SWEEPS = (
    "cpu_2_cores_leg_reach_sweep",
    "h200_leg_reach_deep_sweep",
    "h200_stand_linear_sweep",
    "h200_stand_sweep",
    "h100_walk_linear_sweep",
    "h200_walk_sweep",
)
ONE_TASK = tuple(f"cpu_2_cores_posture_switch_{kind}" for kind in ("table", "linear", "deep"))
"""Records of sweeps over epsilon, its decay and the learning rate: of function approximation, of three learners."""
RATES = "cpu_2_cores_leg_reach_ppo", "h200_stand_ppo", "h200_walk_ppo_rates"
"""Records of sweeps over the learning rate."""
SQUATS = "cpu_2_cores_squat", "cpu_2_cores_squat_deep", "h100_squat_mjx", "h200_squat_deep_mjx"
"""Records of trainings of `squat`."""
MUTANTS = ("learners", "control", "tasks", "physics", "runs")
"""Folders into which `benchmarks/mutants.py` puts faults."""


def sweep_times() -> str:
    """Return how many runs each sweep of function approximation has, how fast they train, and how long it takes."""
    rows = []
    for found in map(record, SWEEPS):
        device, beside = found["machine"]["device"], found.get("beside")
        where = "two CPU cores" if device == "cpu" else f"one {device.split()[1]}"
        words = {"linear_q": "tiles", "deep_q": "network"}[found["config"]["learner"]["name"]]
        cells = f"`{found['config']['name']}`", words, str(found["runs"]), where + f" beside {beside}" * bool(beside)
        rows.append((*cells, rounded(found["episodes_per_s"]), rounded(found["wall_s"] / 60)))
    return table("config | learner | runs | on | episodes a second | minutes, compiling included", rows)


def mutants() -> str:
    """Return how many faults put into each folder the tests catch."""
    found = [record(f"mutants_{folder}") | {"folder": f"`{folder}`"} for folder in MUTANTS]
    counts = [[each["folder"], each["sampled"]] for each in found]
    for row, each in zip(counts, found, strict=True):
        row += [round(each[key] * each["sampled"]) for key in ("killed at first", "killed")]
    counts.append(["all", *(sum(column) for column in list(zip(*counts, strict=True))[1:])])
    rows = ((name, str(tried), *(f"{n} ({n / tried:.0%})" for n in caught)) for name, tried, *caught in counts)
    return table("folder | faults tried | caught at first | caught in the end", rows)


def sweeps(names: Iterable[str] = SWEEPS) -> str:
    """Return what each value of epsilon, its decay and the learning rate does."""
    rows = []
    for name in names:
        found, config = record(name)["points"], record(name)["config"]
        words = f"`{config['name']}`, `{config['learner']['name']}`"
        for key in config["sweep"]["axes"]:
            axis = key.removeprefix("learner.")
            for value in sorted({point[key] for point in found}):
                reached = np.array([point["greedy_success"] for point in found if point[key] == value])
                cell = "{:.2f} ({:.2f} to {:.2f})".format(*estimate(reached.mean(axis=0), 0.0, 1.0))
                best = max(min(point["greedy_success"]) for point in found if point[key] == value)
                rows.append((words, axis, f"{value:g}", cell, f"{best:.2f}"))
                words = ""
    head = "sweep | axis | value | greedy success, mean over its points, by seed (95 %) | worst seed of its best point"
    return table(head, rows)


def squat() -> str:
    """Return what tables and networks reach on `squat`."""
    rows = []
    for name in SQUATS:
        found, points = record(name)["config"], record(name)["points"]
        success, returns = ([x for point in points for x in point[f"greedy_{of}"]] for of in ("success", "return"))
        learner = found["learner"]
        unit = next(unit for unit in ("episodes", "total_steps") if unit in found)
        rows.append((
            f"[`{found['name']}`](bench/{name}.json), `{learner['name']}`",
            f"`{found['task']['physics']}`",
            f"{learner.get('envs') or learner['agents']:,}",
            f"{found[unit]:,} {unit.replace('total_steps', 'decisions')}",
            f"{sum(success):.0f} of {len(success)} runs",
            spread(returns, 0),
        ))  # fmt: skip
    head = "config, learner | physics | bodies of a run | training of a run | greedy success"
    return table(f"{head} | return of a greedy episode", rows)


TABLES = {
    of.__name__: of
    for of in (
        sweeps,
        sweep_times,
        mutants,
        squat,
        robot_speeds,
        speed,
        speed_machines,
        speed_scenes,
        speed_startup,
        speed_training,
        stand,
        learners,
        other_physics,
        faults,
        clusters,
        ranges,
        verdicts,
        parity,
        methods_tasks,
        methods_cliff,
        methods_grid,
        methods_car,
        methods_proof,
        halving,
        other_robots,
        other_robots_taken,
        unmodified,
        public_robots,
        public_robots_go,
        public_robots_tried,
        scaling,
        faster_than_mjx,
    )
} | {
    "four_cards": lambda: _on_cards("walk", 4),
    "cluster_hours": lambda: rounded(record("scheduler")["rows"][0]["gpu_hours"]),
    "cluster_results": lambda: rounded(record("scheduler")["rows"][0]["results_bytes"] / 1e9),
    "cluster_start": lambda: rounded(record("scheduler")["start_s"]),
    "cluster_chunk": lambda: rounded(record("scheduler")["rows"][0]["chunk_s"]),
    "exactness": lambda: f"{max(r[k] for r in record('own_robots')['rows'] for k in ('acceleration', 'velocity')):.1e}",
    "one_task": lambda: sweeps(ONE_TASK),
    "rates": lambda: sweeps(RATES),
    "reproduce_minutes": lambda: rounded(record("cpu_2_cores_reproduce")["command_s"] / 60),
    "c_decision": lambda: rounded(1e6 * record("c_policy")["rows"][0]["seconds"]),
    "parity_cliff": lambda: rounded(record("parity")["expected while learning on the cliff"], 1),
    "methods_optimal": lambda: _exact("Q-learning's policy"),
    "methods_soft": lambda: _exact("the best policy"),
    "stand_seconds": lambda: rounded(record("h100_stand_8_seeds")["records"][0]["command_s"]),
    "stand_again_seconds": lambda: rounded(record("h100_stand_8_seeds")["records"][1]["command_s"]),
    "stand_minutes": lambda: rounded(record("h100_stand_8_seeds")["records"][0]["command_s"] / 60),
    "your_robot_zero": lambda: rounded(100 * record("cpu_2_cores_your_robot")["evaluations"][1]["success"]),
    "your_robot_stand": lambda: rounded(100 * min(record("cpu_2_cores_your_robot")["five seeds"]["success"]), 1),
    "your_robot_processor": lambda: _own_minutes("processor_s"),
    "your_robot_wall": lambda: _own_minutes("wall_s"),
    "stand_cpu_minutes": lambda: rounded(record("cpu_2_cores_stand")["records"][0]["one_seed_wall_s"] / 60),
}
