"""Panels: each reads the studio, draws, and returns commands. They hold no truth, only what is typed into a search box."""
