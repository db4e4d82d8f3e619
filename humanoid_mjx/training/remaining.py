"""How long the rest of a sweep will take, from the pace of each run that trains.

Runs of one sweep can differ by a factor of twenty in length: where the reward pays for waiting, episodes last to their
cap. What all of them together make a second says little then: at the end the slow ones train alone.
"""

import heapq
from collections import deque

import numpy as np
from jaxtyping import Float, Int

WINDOW_S = 10.0
"""Seconds over which the pace of a run is taken."""

EVERY_S = 0.5
"""Seconds between two looks that are kept."""

PLAYED_OUT = 2000
"""Waiting runs whose start and end are played out; those beyond them take the mean."""


class Remaining:
    """The time left, by looks at the slots in which runs train."""

    def __init__(self, runs: int):
        """For runs numbered from 0 to `runs` - 1."""
        self._whole = np.full(runs, np.nan, np.float32)
        """Seconds that each run seen so far takes from its beginning to its end."""
        self._looks: deque[tuple[float, np.ndarray, np.ndarray]] = deque(maxlen=int(WINDOW_S / EVERY_S) + 1)

    def look(self, time_s: float, slots: Int[np.ndarray, " slots"], progress: Float[np.ndarray, " slots"]) -> bool:
        """Take note of which run each slot holds, below 0 for none, and how much of it is done.

        `time_s`: of a clock that stands still while nothing can train, s. Whether the last look was long enough ago.
        """
        if self._looks and len(self._looks[-1][1]) != len(slots):
            self._looks.clear()
        if self._looks and time_s - self._looks[-1][0] < EVERY_S:
            return False
        self._looks.append((time_s, slots.copy(), progress.copy()))
        seconds, done = np.zeros(len(slots)), np.zeros(len(slots))
        for earlier_s, earlier_slots, earlier in self._looks:
            fits = (seconds == 0) & (slots == earlier_slots) & (slots >= 0) & (earlier < progress) & (progress < 1.0)
            seconds[fits], done[fits] = time_s - earlier_s, (progress - earlier)[fits]
        known = seconds > 0
        self._whole[slots[known]] = seconds[known] / done[known]
        return True

    def seconds(self, waiting: int) -> float | None:
        """Seconds until the runs in the slots and so many waiting ones are over; None where no pace is known yet.

        Waiting runs are taken to be like those seen so far, and to begin in the order in which slots become free.
        """
        seen = self._whole[np.isfinite(self._whole)]
        if not len(seen):
            return None
        _, slots, progress = self._looks[-1]
        whole = np.where(slots >= 0, self._whole[slots], 0.0)
        whole = np.where(np.isnan(whole), seen.mean(), whole)
        free = (whole * np.clip(1.0 - progress, 0.0, 1.0)).tolist()
        heapq.heapify(free)
        now = min(waiting, PLAYED_OUT)
        for seconds in np.random.default_rng(0).choice(seen, now).tolist():
            heapq.heapreplace(free, free[0] + seconds)
        return max(free) + float(seen.mean()) * (waiting - now) / len(free)
