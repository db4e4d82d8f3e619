"""Measure a gait.

tally      one moment of a body, and running sums over those of an episode
figures    what the sums say: speed, slip, steps, symmetry, effort, over episodes and over training seeds
scenarios  held-out episodes under commands that stay: of which policies, in which world, and what they do
"""
