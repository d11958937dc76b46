"""Data quality: the shape, noise, drift and lag of measured loops, and which models the data can determine."""
