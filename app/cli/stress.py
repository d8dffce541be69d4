"""`avatarrex-studio stress`: hostile inputs through every stage. A tool of `avatarrex.measure`, not needed to run the app."""

from __future__ import annotations

from avatarrex.measure.stress.command import add_options, run

__all__ = ["add_options", "run"]
