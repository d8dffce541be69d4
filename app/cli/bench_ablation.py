"""`avatarrex-studio bench ablation`: variants of the training compared. A tool of `avatarrex.measure`, not needed to run the app."""

from __future__ import annotations

from avatarrex.measure.ablation.command import add_options, run

__all__ = ["add_options", "run"]
