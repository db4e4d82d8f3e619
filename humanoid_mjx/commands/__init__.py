"""What the commands of the command line do, and what they print: a module for each command or a few that are alike."""

import sys

from humanoid_mjx.training.progress import PatientConsole

console = PatientConsole(highlight=False, markup=False, emoji=False, width=None if sys.stdout.isatty() else 120)
