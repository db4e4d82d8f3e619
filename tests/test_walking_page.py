"""The goals of docs/walking.md stand beside what the records say."""

import re
from typing import Any

import numpy as np
from text_claims import NUMBER, RECORDS, ROOT, Claim, greedy_gaits, tables


def test_walkings_goals_stand_beside_what_the_records_say():
    """Each row of the page's table, by the record's medians over seeds and the worst of them."""
    here = greedy_gaits(RECORDS["h200_walk_seeds.json"])
    there = greedy_gaits(RECORDS["cpu_2_cores_walk_mujoco.json"])
    slow = [here[f"forward {speed}"] for speed in (0.15, 0.3, 0.5)]
    fast, stand, sudden = here["forward 0.8"], here["stand"], here["sudden turn"]
    straight = [here[name] for name in here if name.startswith("forward")]
    turns = [here[name] for name in here if name.startswith("turn")]

    def span(figures: list[Any], name: str, which: str = "median") -> list[float]:
        values = [figure[name][which] for figure in figures]
        return [min(values), max(values)]

    training = RECORDS["h200_walk_seeds.json"]["training"]
    seeds = [seed[0] for seed in sudden["turn_success"]["seeds"]]
    lowest = min(figure["success"]["worst"] for figure in there.values())
    expected = {
        "within 5 minutes": [training["command_s"] / 60],
        "98 % of rollouts": [0.8, 100 * fast["success"]["median"], 100 * fast["success"]["worst"]],
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
        "turn rates": [span(turns, "turn_error")[1]],
        "standing still": [100 * stand["drift"]["median"], 100 * stand["drift"]["worst"]],
        "45 degrees": [100 * sudden["turn_success"]["median"], 100 * min(seeds), 100 * max(seeds)],
        "in native MuJoCo": [100 * min(f["success"]["median"] for f in there.values()), 100 * lowest],
    }
    assert all(gait["success"]["median"] == 1.0 for gait in (stand, sudden, *slow))
    assert span(turns, "turn_error", "worst")[1] < 0.015
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
    other = {
        gait["scenario"]: gait["figures"]
        for gait in RECORDS["h200_walk_seeds.json"]["results"][1]["gaits"]
        if gait["agent"] == "greedy"
    }
    ppo, training = greedy_gaits(RECORDS["h200_walk_ppo.json"]), RECORDS["h200_walk_ppo.json"]["training"]
    slips = [ppo[f"forward {speed}"]["slip"]["median"] for speed in (0.15, 0.3, 0.5)]
    speeds = [ppo[f"forward {speed}"]["forward"]["median"] for speed in (0.5, 0.8)]
    seconds = [training[name] for name in ("command_s", "first_run_s", "first_training_s")]
    record = RECORDS["h200_walk_gaits.json"]
    gaits = {setting["setting"]: setting["figures"] for setting in record["settings"]}

    def median(gait: str, name: str, command: str) -> float:
        return float(np.median([seed[record["commands"].index(command)] for seed in gaits[gait][name]]))

    page = " ".join((ROOT / "docs" / "walking.md").read_text(encoding="utf-8").split())
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
    sentences = {
        rf"told 0\.5 and 0\.8 m/s it goes at ({NUMBER}) and ({NUMBER})\. -": [
            other[f"forward {speed}"]["forward"]["median"] for speed in (0.5, 0.8)
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
    for sentence, values in sentences.items():
        (printed,) = re.findall(sentence, page)
        printed = [printed] if isinstance(printed, str) else printed
        assert all(Claim("walking.md", sentence, *pair).holds for pair in zip(printed, values, strict=True)), printed
