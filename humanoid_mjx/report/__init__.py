"""Figures, comparisons and renderings of what was trained."""
