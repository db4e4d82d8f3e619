"""Figures, pages and renderings of what was trained."""
