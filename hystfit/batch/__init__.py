"""Many loops: one model fitted to each of them, with a table of all parameters."""
