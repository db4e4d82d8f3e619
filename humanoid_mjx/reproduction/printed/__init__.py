"""The formulas as the thesis prints them, faults included: for reproduction, not for use.

`errata.yaml` says what each formula should be and what is wrong with it, `formulas` evaluates both, and `dynamics` has
the formulas of section 4.6, appendices F to H and the MATLAB script.
"""
