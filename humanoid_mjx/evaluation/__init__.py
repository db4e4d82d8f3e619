"""Use and measure what was learned: policies, the episodes that they play, and what these are worth.

policy     the policy of a run, from a run folder or a file; the same policy in another world
c_source   a policy as C source code for a robot's processor
evaluate   held-out episodes beside zero and random agents
episode    one held-out episode, step by step
live       a robot that a person drives
film       a played episode with its words and its pushes
replay     a run just before the step that breaks it
gait       what a body does under commands that stay
"""
