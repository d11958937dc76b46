"""The columns of a file before input and output are chosen, and what their numbers show.

Enters: arrays with names.
Leaves: `Table`.
Open first: `raw_table.py`.
"""
