"""The formulas as the thesis prints them, faults included: for reproduction, not for use.

Every file ends in `ERRATA`: what each formula should be, what is wrong with it, and both as functions. Those of
`dynamics` have a file of their own.
"""
