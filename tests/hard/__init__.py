"""Hard use: many generated cases with a known truth, by seed; `python -m tests.hard.reading` runs those of the file reader."""
