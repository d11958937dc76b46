"""Arrangements of columns, whatever file they come from: branches or specimens side by side or below each other, charge throughput.

Enters: `Table`.
Leaves: `Table`; None for one that is arranged otherwise.
Open first: `side_by_side.py`; `hystfit.reading.registry` lists all.
"""
