"""How the runs of a sweep lie on the devices."""

from collections.abc import Sequence

import jax

from humanoid_mjx.learners import Learner
from humanoid_mjx.learners.base import WholeRunLearner
from humanoid_mjx.types import Device


def arranged(learners: Learner, runs: int, room: int) -> tuple[int, Sequence[Device], int]:
    """How so many runs train side by side, where the devices of this process have `room` for as many at once.

    Returns:
      how many runs each device, or each group of devices that share a run, trains at once; the devices; how many of
      these share a run.
    """
    if isinstance(learners, WholeRunLearner):
        return 1, jax.local_devices()[:1], 1
    share = devices_of_a_run(learners, runs)
    devices = jax.local_devices()[: min(runs, room) * share]
    return min(room * share // len(devices), -(-runs * share // len(devices))), devices, share


def devices_of_a_run(learners: Learner, runs: int) -> int:
    """How many devices share the environments of each run: several where there are fewer runs than GPUs.

    Cores of a CPU share a run's arrays as they are.
    """
    most = 1 if jax.default_backend() == "cpu" else jax.local_device_count() // runs
    return next((share for share in range(most, 1, -1) if learners.can_split(share)), 1)
