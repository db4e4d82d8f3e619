"""Use and measure what was learned: policies, the episodes that they play, and what these are worth.

policy     what a run learned, from a run folder or a file; the same policy in another world
evaluate   held-out episodes beside zero and random agents
episode    one held-out episode, step by step
live       a robot that a person drives
film       a played episode with its words and its pushes
replay     a run just before the step that breaks it
gait       what a body does under commands that stay
"""
