"""Posterior draws: samplers in whitened coordinates, diagnostics, and the posterior that holds the draws."""
