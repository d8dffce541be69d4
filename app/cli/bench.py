"""`avatarrex-studio bench`: run time against error, stage by stage. A tool of `avatarrex.measure`, not needed to run the app."""

from __future__ import annotations

from avatarrex.measure.bench.command import add_options, run

__all__ = ["add_options", "run"]
