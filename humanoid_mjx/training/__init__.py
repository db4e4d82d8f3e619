"""Training: from a config to a plan, from a plan to a run folder."""
