"""Posterior draws: samplers in whitened coordinates, diagnostics, and the posterior that holds the draws.

Enters: a `FitResult`, and a sampler with its settings.
Leaves: a `Posterior` with draws in physical units, R-hat, effective draws and a status.
Open first: `sample.py`, then `target.py`, the density in whitened coordinates.
"""
