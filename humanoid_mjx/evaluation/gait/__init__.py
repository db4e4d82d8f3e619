"""Measure a gait.

samples    one moment of a body, and how near its legs are to each other
tally      running sums over the samples of an episode
figures    what the sums say: speed, slip, steps, symmetry, effort, over episodes and over training seeds
scenarios  held-out episodes under commands that stay
measure    the policies that are asked, and the world that they are asked in
"""
