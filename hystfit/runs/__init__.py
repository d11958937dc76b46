"""Long runs: tasks in several processes, and their results in a folder from which a later run resumes."""
