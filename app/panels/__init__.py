"""Panels: each reads the studio, draws, and returns commands. None holds the truth."""
