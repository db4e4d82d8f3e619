"""The source: D. Bharadwaj's PhD thesis (2019) on the lower body of a humanoid, its numbers and formulas.

Every constant names its table, equation or section. What was recovered rather than printed says so. Formulas *as
printed*, faults included, live in `reproduction.printed`.
"""
