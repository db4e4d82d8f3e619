"""The goals of docs/walking.md stand beside what the records say."""

import re
from typing import Any

import numpy as np
from text_claims import NUMBER, RECORDS, ROOT, Claim, greedy_gaits, tables

THESIS = ("table", "oscillators")
"""References of the thesis, by the names that the record has."""


def test_walkings_goals_stand_beside_what_the_records_say():
    """Each row of the page's table, by the record's medians over seeds and the worst of them."""
    here = greedy_gaits(RECORDS["h200_walk_seeds.json"])
    there = greedy_gaits(RECORDS["cpu_2_cores_walk_mujoco.json"])
    slow = [here[f"forward {speed}"] for speed in (0.15, 0.3, 0.5)]
    fast, stand, sudden = here["forward 0.8"], here["stand"], here["sudden turn"]
    goals = [stand, *slow, fast]
    straight = [here[name] for name in here if name.startswith("forward")]
    turns = [here[name] for name in here if name.startswith("turn")]

    def span(figures: list[Any], name: str, which: str = "median") -> list[float]:
        values = [figure[name][which] for figure in figures]
        return [min(values), max(values)]

    training = RECORDS["h200_walk_seeds.json"]["training"]
    seeds = [seed[0] for seed in sudden["turn_success"]["seeds"]]
    lowest = min(figure["success"]["worst"] for figure in there.values())
    assert lowest == there["forward 0.5"]["success"]["worst"]

    def apart(name: str) -> float:
        both = [(here[c][name]["median"], there[c][name]["median"]) for c in here]
        return max(abs(one - two) for one, two in both if one is not None)

    expected = {
        "within 5 minutes": [training["command_s"] / 60],
        "98 % of rollouts": [*(100 * x for x in (span(goals, "success")[0], span(goals, "success", "worst")[0])), 0.5],
        "mean speed error": [
            *span(slow, "speed_error"),
            0.5,
            span(slow, "speed_error", "worst")[1],
            fast["speed_error"]["median"],
            0.8,
        ],
        "heading within": span(straight, "heading_error"),
        "slip at most": [
            *(x for f, v in zip(slow, (0.15, 0.3, 0.5), strict=True) for x in (f["slip"]["median"], v)),
            span(slow, "slip", "worst")[1],
        ],
        "never both feet": [
            100 * span(slow, "flight")[1],
            100 * span(slow, "flight", "worst")[1],
            *(100 * x for x in span(slow, "duty_asymmetry")),
            100 * span(slow, "duty_asymmetry", "worst")[1],
        ],
        "turn rates": [span(turns, "turn_error")[1], span(turns, "turn_error", "worst")[1]],
        "standing still": [100 * stand["drift"]["median"], 100 * stand["drift"]["worst"]],
        "45 degrees": [100 * sudden["turn_success"]["median"], 100 * min(seeds), 100 * max(seeds)],
        "in native MuJoCo": [
            *(100 * min(f["success"]["median"] for f in there.values()), 100 * lowest, 16, 0.5),
            *(apart("forward"), apart("slip"), apart("heading_error"), 100 * there["stand"]["drift"]["median"]),
        ],
    }
    assert fast["success"]["worst"] > span(goals, "success", "worst")[0]
    assert sudden["success"]["median"] == 1.0
    page = (ROOT / "docs" / "walking.md").read_text(encoding="utf-8")
    (rows,) = (rows for rows in tables(page) if rows[0][1] == "reached")
    assert len(rows) == 1 + len(expected)
    for row in rows[1:]:
        (wanted,) = (values for start, values in expected.items() if row[0].startswith(start))
        printed = re.findall(NUMBER, row[1])[: len(wanted)]
        claims = [Claim("walking.md", row[0], text, value) for text, value in zip(printed, wanted, strict=True)]
        assert not [claim for claim in claims if not claim.holds], row


def test_walkings_sentences_are_those_of_the_records():
    """What is said of the setting that was not chosen, of PPO, of gaits and of the last series."""
    other = greedy_gaits(RECORDS["h200_walk_seeds.json"], 1)
    ppo, training = greedy_gaits(RECORDS["h200_walk_ppo.json"]), RECORDS["h200_walk_ppo.json"]["training"]
    slips = [ppo[f"forward {speed}"]["slip"]["median"] for speed in (0.15, 0.3, 0.5)]
    speeds = [ppo[f"forward {speed}"]["forward"]["median"] for speed in (0.5, 0.8)]
    seconds = [training[name] for name in ("command_s", "first_run_s", "first_training_s")]
    record = RECORDS["h200_walk_gaits.json"]
    gaits = {setting["setting"]: setting["figures"] for setting in record["settings"]}

    def median(gait: str, name: str, command: str) -> float:
        return float(np.median([seed[record["commands"].index(command)] for seed in gaits[gait][name]]))

    own = greedy_gaits(RECORDS["h200_walk_seeds.json"])
    learning = RECORDS["h200_walk_learning.json"]
    swept = [setting for setting in learning["settings"] if setting["series"] == "R"]
    assert sum(setting["seeds"] for setting in swept) == 55 and record["commands"][3] == "forward 0.5"
    (longer,) = (s for s in learning["settings"] if s["setting"] == "learning_rate 0.002, 80M steps")
    assert all(seed[-1] == 1.0 for seed in longer["figures"]["turn_success"])

    def learned(setting: str, name: str, command: str) -> float:
        (found,) = (one["figures"][name] for one in swept if one["setting"] == setting)
        return float(np.median([seed[learning["commands"].index(command)] for seed in found]))

    last = RECORDS["h200_walk_yawing.json"]
    of_last = {setting["setting"]: setting["figures"] for setting in last["settings"]}
    cadences = [
        float(np.median([seed[last["commands"].index("forward 0.5")] for seed in of_last[name]["slip"]]))
        for name in ("cadence .2", "yawing .3")
    ]
    reached = [seed[last["commands"].index("forward 0.8")] for seed in of_last["cadence .2"]["forward"]]
    least = [min(seed[-1] for seed in of_last[name]["turn_success"]) for name in ("yawing -0.3", "yawing 0")]
    upright = [
        min(share for setting in last["settings"] for seed in setting[which]["success"] for share in seed)
        for which in ("averaged", "figures")
    ]
    assert last["commands"][-1] == "sudden turn" and sum(setting["seeds"] for setting in last["settings"]) == 65
    series = ("settings", "stride", "finer", "yawing", "learning", "gaits")
    settings = [one for name in series for one in RECORDS[f"h200_walk_{name}.json"]["settings"]]
    sentences = {
        rf"({NUMBER}) runs in ({NUMBER}) settings, all recorded": [
            sum(one["seeds"] for one in settings),
            len(settings),
        ],
        rf"told 0\.8 m/s it goes at ({NUMBER}), and with every seed at ({NUMBER}) or more when told 0\.5, but slips by "
        rf"({NUMBER}) m/s there": [
            other["forward 0.8"]["forward"]["median"],
            min(seed[0] for seed in other["forward 0.5"]["forward"]["seeds"]),
            other["forward 0.5"]["slip"]["median"],
        ],
        rf"the median of the seeds is ({NUMBER})\. .*? both feet in the air for ({NUMBER}) % of the time": [
            own["forward 0.8"]["forward"]["median"],
            100 * other["forward 0.8"]["flight"]["median"],
        ],
        rf"one of five goes at ({NUMBER}) when told 0\.5, and one falls in ({NUMBER}) % of its episodes there": [
            min(seed[0] for seed in own["forward 0.5"]["forward"]["seeds"]),
            100 - 100 * own["forward 0.5"]["success"]["worst"],
        ],
        rf"up to 0\.5 m/s ({NUMBER}) % stay up with any seed, at 0\.3 m/s they slip by ({NUMBER}) and ({NUMBER}) m/s\. "
        rf"At 0\.8 m/s, .*?, ({NUMBER}) and ({NUMBER}) % stay up in the median": [
            100 * min(share for gait in THESIS for seed in gaits[gait]["success"] for share in seed[:4]),
            *(median(gait, "slip", "forward 0.3") for gait in THESIS),
            *(100 * median(gait, "success", "forward 0.8") for gait in THESIS),
        ],
        rf"it goes at ({NUMBER}), ({NUMBER}), ({NUMBER}) m/s where epsilon decays": [
            learned(name, "forward", "forward 0.8") for name in ("epsilon_decay 0.8", "usual", "epsilon_decay 0.97")
        ],
        rf"does in ({NUMBER})M steps what 0\.001 does in 80M: told 0\.8 m/s it goes at ({NUMBER})\.": [
            learning["settings"][0]["steps"] / 1e6,
            learned("learning_rate 0.002", "forward", "forward 0.8"),
        ],
        rf"the same training again, .*?, gave ({NUMBER}) to ({NUMBER}) %": [
            100 * which(seed[0] for seed in other["sudden turn"]["turn_success"]["seeds"]) for which in (min, max)
        ],
        rf"runs the least share upright under any command is ({NUMBER}), with the last weights ({NUMBER})": [
            min(share for one in swept for seed in one[which]["success"] for share in seed)
            for which in ("figures", "last")
        ],
        rf"It slips by ({NUMBER}), ({NUMBER}), ({NUMBER}) m/s at .*?, and turns at once in ({NUMBER}) s": [
            *slips,
            ppo["sudden turn"]["turn_seconds"]["median"],
        ],
        rf"the least of five seeds turns at once in ({NUMBER}) % of episodes, without it in ({NUMBER}) %": [
            100 * share for share in least
        ],
        rf"feet slip by ({NUMBER}) instead of ({NUMBER}) m/s at 0\.5 m/s, and go at ({NUMBER}) when told 0\.8": [
            *cadences,
            float(np.median(reached)),
        ],
        rf"under any of eight commands is ({NUMBER}) at worst instead of ({NUMBER})": upright,
        rf"PPO's bodies go at ({NUMBER}) and ({NUMBER}),": speeds,
        rf"Five seeds of ({NUMBER})M steps, one after the other in ({NUMBER}) s, the first of them in ({NUMBER}) s "
        rf"with ({NUMBER}) s to its first progress": [training["steps"] / 1e6, *seconds],
        rf"feet slip by ({NUMBER}) m/s instead of ({NUMBER}) at 0\.3 m/s, and a turn at once succeeds in ({NUMBER}) % "
        rf"of episodes instead of ({NUMBER}) %.*? slip ({NUMBER}) m/s, ({NUMBER}) % of turns": [
            *(median(gait, "slip", "forward 0.3") for gait in ("in place", "steps")),
            *(100 * median(gait, "turn_success", "sudden turn") for gait in ("in place", "steps")),
            median("none", "slip", "forward 0.3"),
            100 * median("none", "turn_success", "sudden turn"),
        ],
    }
    check(sentences)


def test_what_is_said_of_ppo_on_walks_reward_of_computed_torque_and_of_averaging():
    ppo, grounded = greedy_gaits(RECORDS["h200_walk_ppo.json"], 1), greedy_gaits(RECORDS["h200_walk_control.json"])
    turns = [figures for name, figures in grounded.items() if name.startswith("turn")]
    swept = RECORDS["h200_walk_learning.json"]
    (servo,) = (one for one in swept["settings"] if (one["series"], one["setting"]) == ("R", "learning_rate 0.002"))
    assert servo["task"]["rewards"]["slip"] == -1.8
    reached = np.array(servo["figures"]["forward"])[:, swept["commands"].index("forward 0.8")]
    without, mean = RECORDS["h200_stand_8_seeds.json"]["records"]

    plain, _, mirrored, slower = RECORDS["cpu_2_cores_stand.json"]["records"]
    assert (mirrored["symmetric"], slower["learning_rate"]) == (True, 0.001)

    def ends(record: Any) -> list[float]:
        """Success after training, in the median of the seeds and with the worst."""
        last = [seed[-1] for seed in record["greedy_success_by_seed"]]
        return [float(np.median(last)), min(last)]

    def reaching(record: Any) -> float:
        """Control steps to 95 % success, the median over seeds."""
        success = np.array(record["greedy_success_by_seed"])
        return float(np.median(np.array(record["total_steps"])[(success >= 0.95).argmax(axis=1)]))

    assert all(ppo[command]["success"]["worst"] == 1.0 for command in ppo)
    assert ppo["sudden turn"]["turn_success"]["worst"] == 1.0
    assert abs(servo["steps"] - RECORDS["h200_walk_control.json"]["training"]["steps"]) < 1e6
    check({
        rf"five seeds, ({NUMBER}) s by the shell\) that shows more: PPO slips by ({NUMBER}) m/s when told 0\.3 and "
        rf"goes at ({NUMBER}); told 0\.5 and 0\.8 it goes at ({NUMBER}) and ({NUMBER})\.": [
            RECORDS["h200_walk_ppo.json"]["second"]["command_s"],
            ppo["forward 0.3"]["slip"]["median"],
            *(ppo[f"forward {speed}"]["forward"]["median"] for speed in (0.3, 0.5, 0.8)),
        ],
        rf"({NUMBER}) % stay up with the worst seed under any command, turn rates are off by ({NUMBER}) rad/s, feet "
        rf"slip by ({NUMBER}) m/s; but told .*? the bodies go at ({NUMBER}), ({NUMBER}), ({NUMBER}), ({NUMBER})\. "
        rf"Under the servo as many steps reach ({NUMBER}) m/s \(with a weight of slip of -1\.8, not -2\.4\)\. A turn "
        rf"at once succeeds in ({NUMBER}) % of episodes in the median and in ({NUMBER}) % with": [
            100 * min(figures["success"]["worst"] for figures in grounded.values()),
            max(figures["turn_error"]["median"] for figures in turns),
            max(figures["slip"]["median"] for figures in grounded.values()),
            *(grounded[f"forward {speed}"]["forward"]["median"] for speed in (0.15, 0.3, 0.5, 0.8)),
            float(np.median(reached)),
            *(100 * grounded["sudden turn"]["turn_success"][which] for which in ("median", "worst")),
        ],
        rf"it is at 95 % after ({NUMBER})M steps in the median, without it after ({NUMBER})M; at the end its worst "
        rf"seed is at ({NUMBER}), without it at ({NUMBER})\.": [
            *(reaching(one) / 1e6 for one in (mean, without)),
            *(ends(one)[1] for one in (mean, without)),
        ],
        rf"the median is at 95 % after ({NUMBER})M steps, without it after ({NUMBER})M; at the end its worst seed is "
        rf"at ({NUMBER}), without it at ({NUMBER})\. A learning rate of 0\.001 ends at ({NUMBER}) in the median and at "
        rf"({NUMBER}) in the worst, the 0\.002 of the config at ({NUMBER}) and ({NUMBER})\.": [
            *(reaching(one) / 1e6 for one in (mirrored, plain)),
            *(ends(one)[1] for one in (mirrored, plain)),
            *ends(slower),
            *ends(plain),
        ],
    })  # fmt: skip


def check(sentences: dict[str, Any]) -> None:
    """The page has each of these sentences, patterns whose groups are numbers, with these values."""
    page = " ".join((ROOT / "docs" / "walking.md").read_text(encoding="utf-8").split())
    for sentence, values in sentences.items():
        (printed,) = re.findall(sentence, page)
        printed = [printed] if isinstance(printed, str) else printed
        assert all(Claim("walking.md", sentence, *pair).holds for pair in zip(printed, values, strict=True)), printed
