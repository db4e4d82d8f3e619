"""A task of a user's own: walk, and earn something for feet above the ground."""

from humanoid_mjx.spec import traced
from humanoid_mjx.tasks.legged import Walk, WalkRewards


class MyRewards(WalkRewards):
    hop: float = traced(0.1, description="for feet above the ground")

    def terms(self, view):
        return super().terms(view) | {"hop": view.feet.height.min()}


class MyWalk(Walk):
    rewards: MyRewards = MyRewards()
