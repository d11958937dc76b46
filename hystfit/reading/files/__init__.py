"""The bytes of a file, from a path, an archive or memory, and its text in the right encoding.

Enters: a path or bytes.
Leaves: `FileBytes`, `TextFile`.
Open first: `file_bytes.py`.
"""
