"""The robots: the leg as a serial chain."""
