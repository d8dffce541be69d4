"""Panels: each reads the studio, draws, and returns commands. None has a state of the session's own."""
