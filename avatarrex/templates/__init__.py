"""Parametric meshes: body, hands and face of a person, posed by driving signals (paper sec. 3.1 to 3.3)."""
