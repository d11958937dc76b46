"""A page in the browser that shows a model beside a measured loop, with a slider for each parameter.

Enters: a model or a fit, and a record.
Leaves: a local server for the page (`page/`), or a widget in a notebook.
Open first: `session.py`, the state behind both.
"""
