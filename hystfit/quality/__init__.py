"""Data quality: the shape, noise, drift and lag of measured loops, and which models the data can determine.

Enters: a `Record`, before any fit.
Leaves: findings as notes, and for each model what the data lack (`needs.py`).
Open first: `check.py`.
"""
