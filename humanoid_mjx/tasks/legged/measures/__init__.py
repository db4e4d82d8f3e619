"""What a gait is measured by.

samples   one moment of a body, and how near its legs are to each other
tally     running sums over the samples of an episode
figures   what the sums say: speed, slip, steps, symmetry, effort
"""
