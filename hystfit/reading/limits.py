"""Limits that all layouts share: how few rows are no table, what is near, and what jumps."""

from hystfit.data import circulation

FEWEST = 4  # rows of a table, of a branch or a block of it, numbers of an array: fewer are settings or results
OF_RECORD = circulation.FEWEST  # rows of each record of a file that holds several
NEAR = 0.05  # part of a range, within which one branch begins where another ends; calibration points spread as little
JUMP = 5.0  # step to another curve over the steps around it, or of a clock from one run to the next
DEEPEST = 30  # levels of structures within each other: no instrument writes so many
MOST_COLUMNS = 5000  # of a table; a file with more has its samples beside each other
LONGEST = 1000  # characters of a number, a stamp, a name or a setting
MOST = 0.8  # part of a text or of its lines that a layout explains, where the text has that layout
MAJORITY = 0.5  # part of rows, values or names beyond which they are the rule
ABOVE = 30  # lines above the numbers that may hold names
FEW = 3  # lines between names and numbers, rows above a header, points in a row, and the least lines of a wrapped block
BESIDE = 2  # cells in a row of names or numbers beyond its columns: remarks, units
ODD = 0.05  # part of the rows that noise, a failing sensor or another table may make
RARE = 0.01  # part of the rows that are unreadable, or settings beside the first ones (15 in 2500 of an oscilloscope)
MOST_LABELS = 12  # sensors or levels that tell the records of a file apart
MOST_CURVES = 10_000  # of a file
SAMPLE = 1000  # lines or rows that show how all are written
