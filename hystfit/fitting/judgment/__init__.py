"""What a fit is worth: standard errors, warnings and its status.

Enters: a `Problem` and an `Estimate`.
Leaves: covariance, `Status`, notes.
Open first: `verdict.py`.
"""
