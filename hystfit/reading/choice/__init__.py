"""Which columns are input and output: points for every ordered pair.

Enters: `Table`.
Leaves: `Choice`.
Open first: `pair_score.py`.
"""
