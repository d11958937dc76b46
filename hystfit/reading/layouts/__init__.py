"""Layouts of files, one file each: instruments, programs, workbooks and arrays.

Enters: `TextFile` or `FileBytes`.
Leaves: `Table`; None for text of another layout.
Open first: `micromag.py` as an example; `hystfit.reading.registry` lists all.
"""
