"""Pages that are made from the package: its registries, enumerations, command line and docstrings."""
