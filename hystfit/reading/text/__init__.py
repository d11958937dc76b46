"""Tables of numbers in text: delimiters, decimal marks, headers, and what other lines say.

Enters: `TextFile`.
Leaves: `Table`.
Open first: `plain_text.py`.
"""
