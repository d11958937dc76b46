"""Files that are made or damaged to fill the memory, take long, or reach other files: refused, in bounded time and memory."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.errors import DataError
from hystfit.reading import read

PLAIN = "t,u,y\n0,0,10\n0.5,1.25,-0.125\n1,-2.5,3\n1.5,3.5,4.75\n"


def _write(folder: Path, content: str | bytes, name: str = "file.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# -- which files are read ----------------------------------------------------------------------------------------------


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    for name in ("pipe.csv", "zero.csv"):
        with pytest.raises(DataError, match="pipe or a device"):
            read(tmp_path / name)


@pytest.mark.parametrize(
    "name", ["x" * 300 + ".csv", "x" * 5000 + ".csv", "x*" * 3000 + ".csv", "x" * 300 + "+y.csv", "a\0b.csv"]
)
def test_impossible_names_are_refused(name: str) -> None:
    with pytest.raises(DataError, match=r"cannot be read|no file"):
        read(name)


def test_data_of_another_file_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret.bin").write_bytes(np.arange(20.0).tobytes())
    path = tmp_path / "external.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("u", data=np.arange(20.0) ** 2)
        file.create_dataset("y", (20,), dtype="f8", external=[(str(tmp_path / "secret.bin"), 0, 160)])
    with pytest.raises(DataError, match="another file"):
        read(path)


def test_virtual_data_sets_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file.create_dataset("y", data=np.arange(20.0))
    path = tmp_path / "virtual.h5"
    layout = h5py.VirtualLayout((20,), "f8")
    layout[:] = h5py.VirtualSource(str(tmp_path / "source.h5"), "y", shape=(20,))
    with h5py.File(path, "w") as file:
        file.create_dataset("u", data=np.arange(20.0) ** 2)
        file.create_virtual_dataset("y", layout)
    with pytest.raises(DataError, match="another file"):
        read(path)


def test_links_to_other_files_are_not_followed(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file.create_dataset("y", data=np.arange(20.0))
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file.create_dataset("u", data=np.arange(20.0) ** 2)
        file["y"] = h5py.ExternalLink("source.h5", "/y")
    with pytest.raises(DataError, match="an input and an output"):
        read(tmp_path / "link.h5")


# -- sizes -------------------------------------------------------------------------------------------------------------

ZEROS = 2**27  # bytes


def _zeros_in_zip(name: str) -> bytes:
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open(name, "w", force_zip64=True) as file,
    ):
        if name.endswith(".npy"):
            np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (ZEROS // 8,)})
        for _ in range(ZEROS // 2**24):
            file.write(bytes(2**24))
    return stream.getvalue()


def _zeros_in_mat() -> bytes:
    packer = zlib.compressobj(1)
    head = struct.pack("<IIIIIIiiHH4sII", 14, ZEROS, 6, 8, 6, 0, 5, 8, 1, 1, b"u\0\0\0", 9, ZEROS)
    body = (
        packer.compress(head) + b"".join(packer.compress(bytes(2**24)) for _ in range(ZEROS // 2**24)) + packer.flush()
    )
    start = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    return start + struct.pack("<II", 15, len(body)) + body


def _hdf5(shape: tuple[int, ...]) -> bytes:
    h5py = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.create_dataset("u", shape, dtype="f8", chunks=(2**16,), compression="gzip")
    return stream.getvalue()


def _npy(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": dtype, "fortran_order": False, "shape": shape})
    return stream.getvalue() + bytes(64)


BOMBS = {
    "text.csv.gz": lambda: gzip.compress(bytes(ZEROS), 1),
    "text.csv.bz2": lambda: bz2.compress(bytes(ZEROS), 1),
    "text.csv.xz": lambda: lzma.compress(bytes(ZEROS), preset=0),
    "named.csv": lambda: gzip.compress(bytes(ZEROS), 1),
    "array.npz": lambda: _zeros_in_zip("u.npy"),
    "sheet.xlsx": lambda: _zeros_in_zip("xl/workbook.xml"),
    "matrix.mat": _zeros_in_mat,
    "empty.h5": lambda: _hdf5((10**10,)),
    "long.npy": lambda: _npy((10**12,)),
    "overflow.npy": lambda: _npy((2**62, 2**62)),
}

_READ = """
import resource, sys, time
import numpy, h5py, openpyxl, scipy.io  # not counted
from hystfit.errors import DataError
from hystfit.reading import read
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for file in sys.argv[1:]:
    started = time.process_time()
    try:
        read(file)
        print("read")
    except DataError as error:
        print("refused", str(error).replace("\\n", " ")[-400:])
    print(time.process_time() - started, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def _measured(*paths: Path) -> list[tuple[str, float, float]]:
    """What a process of its own says on each file, its processor time [s] and the most memory until then [MiB]."""
    done = subprocess.run(
        [sys.executable, "-c", _READ, *map(str, paths)], capture_output=True, text=True, timeout=120, check=True
    )
    lines = done.stdout.splitlines()
    numbers = (map(float, line.split()) for line in lines[1::2])
    return [(verdict, *pair) for verdict, pair in zip(lines[::2], numbers, strict=True)]


def test_files_that_unpack_to_many_times_their_size_are_refused(tmp_path: Path) -> None:
    found = _measured(*(_write(tmp_path, content(), name) for name, content in BOMBS.items()))
    for name, (verdict, _, memory) in zip(BOMBS, found, strict=True):
        assert verdict.startswith("refused"), name
        assert memory < 300, name


def test_sheets_with_a_cell_far_away_are_refused(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in ((0, 1), (1, 2), (2, 1)):
        book.active.append(row)
    book.active["XFD1048576"] = 1
    book.save(tmp_path / "far.xlsx")
    [(verdict, _, memory)] = _measured(tmp_path / "far.xlsx")
    assert verdict.startswith("refused")
    assert memory < 500


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "trapped"),)

    trap = np.empty(3, dtype=object)
    trap[:] = [Trap()] * 3
    np.savez(tmp_path / "trap.npz", u=trap, y=np.arange(3.0))
    np.save(tmp_path / "trap.npy", trap)
    for name in ("trap.npz", "trap.npy"):
        with pytest.raises(DataError, match="Python objects"):
            read(tmp_path / name)
    assert not (tmp_path / "trapped").exists()


@pytest.mark.parametrize("packing", [gzip, bz2, lzma])
def test_packed_text_is_read(packing: object, tmp_path: Path) -> None:
    suffix = {gzip: ".gz", bz2: ".bz2", lzma: ".xz"}[packing]  # type: ignore[index]
    packed = packing.compress(PLAIN.encode())  # type: ignore[attr-defined]
    plain = read(_write(tmp_path, PLAIN, "plain.csv"))
    for name in ("loop.csv" + suffix, "loop.csv"):
        record = read(_write(tmp_path, packed, name))
        assert isinstance(record, Record)
        np.testing.assert_array_equal(record.y, plain.y)  # type: ignore[union-attr]
        assert record.name == "loop"
    for cut in (len(packed) // 2, len(packed) - 5):
        with pytest.raises(DataError, match="copy it again"):
            read(_write(tmp_path, packed[:cut], "cut.csv" + suffix))


# -- time and memory for text of 2 MB ---------------------------------------------------------------------------------

SIZE = 2_000_000


def _filled(line: str, head: str = "t,u,y\n") -> str:
    return head + line * ((SIZE - len(head)) // len(line))


HEAVY = {
    "blanks in the header": lambda: "a" + " " * 16_000 + "b c\n" + PLAIN,
    "blanks in many lines": lambda: ("# " + " " * 50_000 + "x\n") * 190 + PLAIN,
    "brackets in the header": lambda: ("(" * 40_000 + "\n") * 12 + PLAIN,
    "brackets apart": lambda: ("( " * 40_000 + "\n") * 12 + PLAIN,
    "quotes in the header": lambda: ('" ' * 40_000 + "\n") * 12 + PLAIN,
    "long names": lambda: ",".join(["n" + "_ (" * 6000] * 3) + "\n" + PLAIN,
    "colons": lambda: ("a" * 39 + ": " * 25_000 + "\n") * 40 + PLAIN,
    "a million columns": lambda: ",".join(["1"] * 1_000_000) + "\n" + ",".join(["2"] * 1_000_000) + "\n",
    "many columns": lambda: (",".join(["1.5"] * 20_000) + "\n") * 125,
    "groups of thousands": lambda: "u;y\n" + ("1" + ".000" * 20_000 + ";2\n") * 120,
    "a cell of many groups": lambda: "u;y\n1" + ".000" * 200_000 + ";2\n3;4\n",
    "digits": lambda: "u,y\n" + ("1" * 40_000 + ",2\n") * 240,
    "letters": lambda: PLAIN + ("a" * 90_000 + "\n") * 11 + ("a/" * 45_000 + "\n") * 11,
    "blanks in rows": lambda: PLAIN + (" " * 90_000 + "\n") * 22,
    "a unit of brackets": lambda: "u,y\n" + ("( " * 40_000 + ",2\n") * 24,
    "a unit of dashes": lambda: "u,y\n" + ("-" * 80_000 + ",2\n") * 24,
    "short rows": lambda: _filled("1,2,3\n"),
    "short rows with words": lambda: _filled("1,2,OVF\n1,2,3\n"),
    "very short rows": lambda: _filled("1 2\n2 3\n", ""),
    "missing cells": lambda: _filled(",,1\n1,1,\n"),
    "stamps": lambda: (
        "time,u,y\n"
        + "".join(f"2024-01-02 {k // 3600:02d}:{k // 60 % 60:02d}:{k % 60:02d},{k % 7},5\n" for k in range(80_000)) * 4
    ),
    "comments": lambda: PLAIN + "# x\n" * (SIZE // 4),
    "text lines": lambda: PLAIN + "abc def\n" * (SIZE // 8),
    "blank lines": lambda: PLAIN + "\n" * SIZE,
    "blocks": lambda: "t,u,y\n" + "1,2,3\n2,3,4\n\n" * (SIZE // 13),
    "text column": lambda: _filled("1,on,2,3\n2,off,3,1\n", "t,s,u,y\n"),
    "quoted": lambda: _filled('"1.5","2.5","3.5"\n', '"t","u","y"\n'),
    "decimal commas": lambda: _filled("1,5;2,5;3,5\n0,5;1,75;2\n", "t;u;y\n"),
    "thousands": lambda: _filled("1.234,5;2,5;3,5\n0,5;1.001,75;2\n", "t;u;y\n"),
    "widths": lambda: PLAIN + "".join("1," * (k % 40) + "2\n" for k in range(240_000)),
    "control": lambda: PLAIN + "\x01" * SIZE,
    "no line ends": lambda: "1.5 " * (SIZE // 4),
    "minus signs": lambda: "1-" * (SIZE // 2),
    "touching": lambda: _filled("1.5-2.5-3.5\n", "t u y\n"),
    "latin": lambda: b"t,u,y\n" + b"1,2,3 \xe4\xff\n" * (SIZE // 9),
    "eastern": lambda: b"t,u,y\n" + b"1,2,3\n2,3,1\n" + b"\x8d\x8d\xb0\xa1" * (SIZE // 4),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", HEAVY)
def test_two_megabytes_take_neither_long_nor_much_memory(case: str, tmp_path: Path) -> None:
    [(_, taken, memory)] = _measured(_write(tmp_path, HEAVY[case]()))
    assert memory < 250
    assert taken < 10  # 1 s on an idle machine; quadratic expressions take minutes
