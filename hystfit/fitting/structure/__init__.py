"""The terms of a Prandtl-Ishlinskii model, chosen by cross-validation.

Enters: `Dataset`.
Leaves: a model with the terms that the records show.
Open first: `structure_search.py`.
"""
