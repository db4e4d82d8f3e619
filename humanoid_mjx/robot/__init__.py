"""The robots: what a description holds, the leg as a serial chain, the legs and the lower body as MuJoCo models."""

from humanoid_mjx.robot.description import ROBOTS, Robot, RobotKey, make_robot

__all__ = ["ROBOTS", "Robot", "RobotKey", "make_robot"]
