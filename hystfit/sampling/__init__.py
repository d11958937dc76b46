"""Posterior draws: likelihood and prior in whitened coordinates, NUTS and an ensemble sampler, diagnostics, and what holds the draws."""
