"""Estimators: from a problem and starting points to a point in parameter space.

Enters: `Problem`, starting points.
Leaves: `Estimate`.
Open first: `least_squares.py`; `registry.py` lists all.
"""
