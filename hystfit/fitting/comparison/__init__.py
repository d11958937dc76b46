"""Models compared by their errors on held-out samples.

Enters: `Dataset`, options.
Leaves: `Comparison`.
Open first: `model_search.py`, the order in which models are tried.
"""
