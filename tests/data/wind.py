"""Physics of a user's own: native MuJoCo in a wind that blows along x."""

from humanoid_mjx.physics.native import Native
from humanoid_mjx.spec import traced


class Windy(Native):
    batch = 16

    wind: float = traced(0.5, description="N")

    def pushes(self):
        return super().pushes().at[0].add(self.wind)
