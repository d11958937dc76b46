"""What a fit returns, and how it is shown and saved."""

from hystfit.results import plots as plots
