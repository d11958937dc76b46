"""Many loops: one model fitted to each of them, with a table of all parameters.

Enters: records, folders of files, tables, or cubes of loops (`sources`), with the name of a model.
Leaves: a row a loop with estimates, standard errors and status; overviews and maps.
Open first: `many.py`, then `fit_map.py` for cubes.
"""
