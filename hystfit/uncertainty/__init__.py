"""What data determine, and how far error bars can be trusted: profiles, other covariances, calibration, input design."""
