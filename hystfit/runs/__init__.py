"""Long runs: tasks in several processes, and their results in a folder from which a later run resumes.

Enters: a function and its tasks.
Leaves: their results in order, also after an interruption.
Open first: `pool.py`.
"""
