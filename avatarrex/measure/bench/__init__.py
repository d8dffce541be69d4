"""Measurements: run time against error, beside named peers, in one run (docs/bench.md)."""
