"""Figures of a gait from its whole motion, slowly and in plain numpy: what the running sums are compared with."""

import numpy as np


def reference(motion, asked, interval, window, mass):
    """Sums are of the samples from 2 s on; `asked` is the command of each.

    `motion` maps the names of a sample's parts to arrays over all samples, `place_0` and the like to what was before.
    """
    count = len(motion["heading"])
    first = next(k for k in range(count) if k * interval > 2.0 - interval / 2)
    later = range(first, count)
    places = np.vstack([motion["place_0"], motion["place"]])
    headings = np.unwrap(np.concatenate([[motion["heading_0"]], motion["heading"]]))
    moves = np.array([seen(places[k + 1] - places[k], (headings[k] + headings[k + 1]) / 2) for k in range(count)])
    moves = np.column_stack([moves, np.diff(headings)])
    loaded = motion["load"] > 0.8
    found = {
        "seconds": count * interval,
        "forward": moves[first:, 0].sum() / (len(later) * interval),
        "left": moves[first:, 1].sum() / (len(later) * interval),
        "turn": moves[first:, 2].sum() / (len(later) * interval),
        "duty": loaded[first:].mean(),
        "duty_asymmetry": abs(np.diff(loaded[first:].mean(axis=0))[0]) / loaded[first:].mean(),
        "flight": (~loaded[first:]).all(axis=1).mean(),
        "crossing": (motion["gap"][first:, 0, 1] < 0.05).mean(),
        "leg_contact": (motion["legs_apart"][first:] <= 0).mean(),
        "peak_torque": np.abs(motion["torque"]).max(),
    }
    found["slip"] = motion["speed"][first:][motion["touching"][first:]].mean()
    found |= errors(moves[first:], asked[first:], works(motion)[first:], interval, window, mass)
    found |= steps(motion, loaded, first, interval)
    return found


def seen(way, heading):
    forward, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    return np.array([way @ forward, way @ left])


def works(motion):
    """Of all joints, from each sample's predecessor to it, J."""
    angles = np.vstack([motion["angles_0"], motion["angles"]])
    torques = np.vstack([np.zeros_like(angles[0]), motion["torque"][:-1]])
    return np.array([sum(abs(t * (b - a))) for t, a, b in zip(torques, angles[:-1], angles[1:], strict=True)])


def errors(moves, asked, work, interval, window, mass):
    parts = [slice(k * window, (k + 1) * window) for k in range(len(moves) // window)]
    means = np.array([moves[part].sum(axis=0) / (window * interval) for part in parts])
    off = means - np.array([asked[part].mean(axis=0) for part in parts])
    way = sum(np.linalg.norm(mean[:2]) * window * interval for mean in means)
    return {
        "speed_error": np.linalg.norm(off[:, :2], axis=1).mean(),
        "turn_error": np.abs(off[:, 2]).mean(),
        "cost_of_transport": work[: len(parts) * window].sum() / (mass * 9.81 * way),
    }


def steps(motion, loaded, first, interval):
    """Touchdowns after at least 40 ms without load."""
    lengths, lifts = [], []
    for foot in (0, 1):
        since = None
        for k in range(len(loaded)):
            if not loaded[k, foot]:
                since = k if since is None else since
                continue
            if since is not None and k - since >= round(0.04 / interval) and k >= first:
                lengths.append(motion["gap"][k, 0, 0] * (1 if foot else -1))
                lifts.append(motion["height"][since:k, foot].max())
            since = None
    seconds = (len(loaded) - first) * interval
    steps = {"step_frequency": len(lengths) / seconds, "step_length": np.mean(lengths)}
    return steps | {"clearance": np.mean(lifts)}
