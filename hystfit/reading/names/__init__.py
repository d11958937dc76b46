"""What the names of columns say: quantities, units, roles.

Enters: a name as it stands in a file.
Leaves: a name, a unit, a quantity.
Open first: `column_names.py`; the words are in `column_names.toml`.
"""
