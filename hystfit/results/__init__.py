"""What a fit returns, and how it is shown and saved.

Enters: an estimate with its covariance, verdict and data.
Leaves: `FitResult`, its report, pictures, quantities of the field, and a folder that opens again.
Open first: `result.py`, then `report/`.
"""

from hystfit.results import plots as plots
