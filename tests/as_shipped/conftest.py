"""The kernels that users have, in the place of plain ones: what XLA makes of a program, that worlds, runs and devices
change no bit of each other, how near single precision comes."""

import os

from humanoid_mjx import compute

os.environ["XLA_FLAGS"] = compute.XLA_FLAGS
