"""What data determine, and how far error bars can be trusted: profiles, other covariances, calibration, input design.

Enters: a `FitResult`.
Leaves: profiles and regions, covariances of other kinds, coverage by simulation, the next input to measure.
Open first: `profiles.py`.
"""
