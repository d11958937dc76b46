"""Where one curve ends and the next begins: reversal curves, branches, calibration points, copies.

Enters: `Table` and `Choice`.
Leaves: the rows of each record.
Open first: `split_curves.py`.
"""
