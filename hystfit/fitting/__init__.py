"""Batch estimators: from a problem and starts to a point in parameter space."""
