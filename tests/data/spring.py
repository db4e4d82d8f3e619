"""A control law of a user's own: springs without dampers."""

from humanoid_mjx.control import Law
from humanoid_mjx.spec import traced


class Spring(Law):
    stiffness: float = traced(2.0, gt=0, description="N m/rad")

    def __call__(self, reference, state):
        return self.stiffness * (reference.qpos - state.qpos)
