"""What a fit returns, and how it is shown and saved.

Enters: an estimate with its covariance, verdict and data.
Leaves: `FitResult`, its report, pictures, quantities of the field, and a folder that opens again.
Open first: `result.py`, then `report/`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["plots"])
