"""Files of saved fits, and the folders that hold them.

Enters: `FitResult`.
Leaves: JSON, arrays and a manifest.
Open first: `stored_fit.py`; `hystfit.results.saved` opens and writes whole fits.
"""
