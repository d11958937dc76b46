"""The layouts of files: kinds by their first bytes, texts by their first lines, and tables by their columns.

Each layout is one module of this room and one entry here; the documentation lists what stands here.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import zipfile
from collections.abc import Callable

from hystfit.errors import DataError
from hystfit.reading.arrangements.adjusted import with_adjusted
from hystfit.reading.arrangements.charge_throughput import with_throughput
from hystfit.reading.arrangements.compact_stamps import with_compact_stamps
from hystfit.reading.arrangements.list_columns import with_list_columns
from hystfit.reading.arrangements.long_format import widened
from hystfit.reading.arrangements.row_loops import with_row_loops
from hystfit.reading.arrangements.scaled_columns import unscaled
from hystfit.reading.arrangements.side_by_side import stacked
from hystfit.reading.arrangements.signed_amplitude import with_signed_amplitude
from hystfit.reading.arrangements.specimens import divided
from hystfit.reading.arrangements.split_clock import with_joined_clock
from hystfit.reading.arrangements.switch_columns import with_switches
from hystfit.reading.arrangements.unit_columns import with_unit_columns
from hystfit.reading.curves.two_branches import unfolded
from hystfit.reading.files.archive import MAGIC
from hystfit.reading.files.file_bytes import FileBytes
from hystfit.reading.files.text_file import Opening, TextFile, text_of
from hystfit.reading.layouts.array_files import HDF, hdf5_arrays, is_hdf, netcdf_arrays, numpy_arrays
from hystfit.reading.layouts.array_table import read_arrays
from hystfit.reading.layouts.assigned_arrays import read_assigned_arrays
from hystfit.reading.layouts.bracket_rows import read_bracketed
from hystfit.reading.layouts.console_log import read_console_log
from hystfit.reading.layouts.drawn_table import read_drawn_table, read_latex_table
from hystfit.reading.layouts.easyexpert import read_easyexpert
from hystfit.reading.layouts.igor_text import read_igor
from hystfit.reading.layouts.json_text import read_json
from hystfit.reading.layouts.key_values import read_key_values
from hystfit.reading.layouts.known_layouts import KnownLayouts
from hystfit.reading.layouts.list_cells import read_list_cells
from hystfit.reading.layouts.magic_tables import read_magic
from hystfit.reading.layouts.markup import read_markup
from hystfit.reading.layouts.matlab import read_matlab
from hystfit.reading.layouts.micromag import read_micromag
from hystfit.reading.layouts.parquet import read_parquet
from hystfit.reading.layouts.pgfplots import read_pgfplots
from hystfit.reading.layouts.sections import read_sections
from hystfit.reading.layouts.snapshots import read_snapshots
from hystfit.reading.layouts.spice_raw import read_spice
from hystfit.reading.layouts.star_loops import read_star
from hystfit.reading.layouts.successive_tables import read_tables
from hystfit.reading.layouts.transposed import read_transposed
from hystfit.reading.layouts.twincat_scope import read_twincat_scope
from hystfit.reading.layouts.unit_cells import read_unit_cells
from hystfit.reading.layouts.workbook import read_older_sheets, read_workbook
from hystfit.reading.layouts.wrapped_blocks import read_wrapped_blocks
from hystfit.reading.table.raw_table import Table
from hystfit.reading.text.plain_text import plain_text

_OLD_EXCEL = b"\xd0\xcf\x11\xe0"


@dataclasses.dataclass(frozen=True)
class Format:
    """A kind of file that is not text.

    Attributes:
        suffixes: usual endings of its name.
        about: what is read of it.
        recognizes: whether a file is of this kind, by its bytes.
        read: its columns.
    """

    suffixes: tuple[str, ...]
    about: str
    recognizes: Callable[[FileBytes], bool]
    read: Callable[[FileBytes, Opening], Table]


def _is_matlab(file: FileBytes) -> bool:
    """MATLAB writes its name, except in version 4, whose first number has NUL bytes."""
    return file.raw.startswith(b"MATLAB") or (file.suffix == ".mat" and (is_hdf(file.raw) or b"\0" in file.raw[:20]))


def _holds(file: FileBytes, member: str, *suffixes: str) -> bool:
    """Whether a file is a zip archive with such a member; of a damaged one, the ending tells."""
    if not file.raw.startswith(MAGIC):
        return False
    try:
        with zipfile.ZipFile(io.BytesIO(file.raw)) as archive:
            return any(name.endswith(member) for name in archive.namelist())
    except Exception:  # zipfile raises several kinds on damaged archives
        return file.suffix in suffixes


FORMATS = (
    Format(
        (".npz", ".npy"),
        "NumPy arrays: each array of a .npz is a column, a matrix gives several, a structured array its fields",
        lambda file: file.raw.startswith(b"\x93NUMPY") or _holds(file, ".npy", ".npz"),
        functools.partial(read_arrays, numpy_arrays),
    ),
    Format(
        (".mat",),
        'MATLAB variables, also within structures: an array of these has a record or a channel each; version 7.3 needs the extra "files"',
        _is_matlab,
        read_matlab,
    ),
    Format(
        (".h5", ".hdf5", ".nc"),
        'HDF5 and netCDF-4 data sets in all groups, and the fields of compound ones; needs the extra "files"',
        lambda file: file.raw.startswith(HDF),
        functools.partial(read_arrays, hdf5_arrays),
    ),
    Format(
        (".nc", ".cdf"),
        "variables of netCDF files of the classic format, with their units",
        lambda file: file.raw.startswith((b"CDF\x01", b"CDF\x02")),
        functools.partial(read_arrays, netcdf_arrays),
    ),
    Format(
        (".parquet",),
        'Parquet tables: columns of numbers, or one loop a row as lists; needs the extra "frames"',
        lambda file: file.raw.startswith(b"PAR1"),
        read_parquet,
    ),
    Format(
        (".xlsx", ".xlsm"),
        'Excel sheets, the first with columns of numbers and those with the same ones, unless `--sheet` names one; needs the extra "files"',
        lambda file: _holds(file, "xl/workbook.xml", ".xlsx", ".xlsm"),
        read_workbook,
    ),
    Format(
        (".xls", ".ods"),
        'sheets of old Excel, LibreOffice and OpenOffice, as those of .xlsx; needs the extra "files"',
        lambda file: file.raw.startswith(_OLD_EXCEL) or _holds(file, "content.xml", ".ods"),
        read_older_sheets,
    ),
)

# Each gives None for text of another layout; the last one reads any.
TEXTS: tuple[Callable[[TextFile], Table | None], ...] = (
    read_bracketed,
    read_json,
    read_markup,
    read_micromag,
    read_magic,
    read_easyexpert,
    read_list_cells,
    read_pgfplots,
    read_assigned_arrays,
    read_snapshots,
    read_key_values,
    read_console_log,
    read_twincat_scope,
    read_igor,
    read_star,
    read_spice,
    read_wrapped_blocks,
    read_sections,
    read_tables,
    read_transposed,
    read_latex_table,
    read_drawn_table,
    read_unit_cells,
    plain_text,
)

# What the columns of a table show, wherever it comes from, in this order; each gives None for a table without it.
ARRANGEMENTS: tuple[Callable[[Table], Table | None], ...] = (
    with_unit_columns,
    with_list_columns,
    with_compact_stamps,
    with_joined_clock,
    unscaled,
    with_switches,
    with_signed_amplitude,
    with_throughput,
    divided,
)
# The same for arrangements whose columns are replaced by others, so that they apply only where the user names none.
REPLACING: tuple[Callable[[Table], Table | None], ...] = (unfolded, with_row_loops, stacked, widened)

_LAYOUTS = KnownLayouts()  # of the texts read by this process


def table_of_file(file: FileBytes, opening: Opening, *, text_only: bool = False) -> Table:
    """The columns of a file, by its content.

    Args:
        text_only: refuse a file that is not text.

    Raises:
        DataError: the file cannot be read.
    """
    if (known := _LAYOUTS.read(file, opening)) is not None:
        return known
    found = None if text_only else next((one for one in FORMATS if one.recognizes(file)), None)
    if found is not None:
        return found.read(file, opening)
    if opening.sheet is not None:
        raise DataError(f"{file.source} is text and has no sheets; leave out sheet=")
    text = text_of(file, opening)
    read, table = next((read, table) for read in TEXTS if (table := read(text)) is not None)
    if read is plain_text:
        _LAYOUTS.learn(file, text, table)
    return table


def arranged(table: Table, *, named: bool, free: bool, adjusted: bool) -> Table:
    """The table as its columns show it to be arranged.

    Args:
        named: the user names input or output.
        free: the user names no column at all, so that columns may be replaced.
        adjusted: see `read`.
    """
    if adjusted or not named:
        table = with_adjusted(table, adjusted=adjusted)
    for arrange in ARRANGEMENTS:
        table = arrange(table) or table
    for arrange in REPLACING if free and table.pair is None and table.part is None else ():
        table = arrange(table) or table
    return table
