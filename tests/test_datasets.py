"""Data sets by name: addresses, checksums, local folders, and what the readers make of the published files."""

import hashlib
import os
import pathlib

import numpy as np
import pytest

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.reading import datasets, published
from hystfit.results.saved import load_records, save_records

MEASURED = {name: entry for name, entry in published.ENTRIES.items() if isinstance(entry, published.Measured)}
BUNDLED = {name: entry for name, entry in published.ENTRIES.items() if isinstance(entry, published.Bundled)}

SHARED = pathlib.Path(os.environ.get("HYSTFIT_DATA", pathlib.Path(__file__).parents[1] / ".." / "shared" / "data"))
needs_data = pytest.mark.skipif(not (SHARED / "piezo_dbo").is_dir(), reason="no measured data: set HYSTFIT_DATA")


@pytest.fixture(autouse=True)
def _no_folder(monkeypatch):
    monkeypatch.delenv("HYSTFIT_DATA", raising=False)


@pytest.fixture
def small(monkeypatch, tmp_path):
    """A measured set of one small file, registered under the name small/one, with the text of that file."""
    text = "0,1\n1,3\n2,5\n1,4\n0,2\n1,3\n2,5\n"
    file = published.DataFile("one.csv", ("some where/one.csv",), hashlib.sha256(text.encode()).hexdigest())
    source = published.Source("small", "owner/name", "c0ffee", "MIT", "nobody", "nothing")
    reader = published.text_reader((0, "drive", "V"), (1, "travel", "um"), rate=10.0)
    monkeypatch.setattr(datasets, "ENTRIES", {"small/one": published.Measured(source, (file,), reader)})
    return text


def put(folder, text):
    (folder / "small").mkdir()
    (folder / "small" / "one.csv").write_text(text)
    return folder


def test_every_entry_has_a_full_revision_checksum_license_and_citation():
    for name, entry in MEASURED.items():
        source = entry.source
        assert name.split("/")[0] in (source.folder, "friction_brfd")
        assert len(source.revision) == 40
        assert int(source.revision, 16) > 0
        assert source.license
        assert source.citation
        assert source.about
        for file in entry.files:
            assert len(file.sha256) == 64
            assert int(file.sha256, 16) > 0
            for address in file.addresses(source):
                assert f"/{source.repository}/{source.revision}/" in address
                assert " " not in address
        text = datasets.describe(name)
        assert source.license in text
        assert entry.files[0].sha256 in text
    assert set(BUNDLED) == {"stage-sine", "stage-sweep", "stage-step", "stage-staircase"}
    assert datasets.names() == (*BUNDLED, *MEASURED)


def test_a_file_in_the_folder_is_read_and_labeled(small, tmp_path, monkeypatch):
    record = datasets.load("small/one", folder=put(tmp_path, small))
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.u, [0, 1, 2, 1, 0, 1, 2])
    np.testing.assert_allclose(record.t, np.arange(7) / 10)
    assert (record.u_unit, record.y_name, record.name) == ("V", "travel", "small/one")
    assert has(record.notes, Code.PREPARED)  # time was computed from the published rate
    assert record.sha256 == hashlib.sha256(small.encode()).hexdigest()
    monkeypatch.setenv("HYSTFIT_DATA", str(tmp_path))
    assert datasets.load("small/one").digest() == record.digest()


def test_a_wrong_checksum_in_the_folder_is_refused(small, tmp_path):
    with pytest.raises(DataError, match=r"SHA-256.*expected"):
        datasets.load("small/one", folder=put(tmp_path, small.replace("5", "6")))


def fake_pooch(monkeypatch, tmp_path, retrieve):
    import pooch

    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    monkeypatch.setattr(pooch, "retrieve", retrieve)


def test_offline_names_the_address_and_the_variable(small, tmp_path, monkeypatch):
    def retrieve(*_args, **_options):
        raise ConnectionError("no route to host")

    fake_pooch(monkeypatch, tmp_path, retrieve)
    with pytest.raises(DataError, match=r"owner/name/c0ffee/some%20where/one\.csv.*no route.*HYSTFIT_DATA"):
        datasets.load("small/one")


def test_a_download_is_verified_and_kept_in_the_cache(small, tmp_path, monkeypatch):
    asked = []

    def retrieve(url, known_hash, fname, path):
        asked.append((url, known_hash))
        path.mkdir(parents=True, exist_ok=True)
        (path / fname).write_text(small)
        return str(path / fname)

    fake_pooch(monkeypatch, tmp_path, retrieve)
    assert len(datasets.load("small/one")) == 7
    assert asked[0][1] == "sha256:" + hashlib.sha256(small.encode()).hexdigest()
    (tmp_path / "cache" / "hystfit" / "small" / "one.csv").write_text("0,0\n")
    with pytest.raises(DataError, match="wrong SHA-256"):
        datasets.load("small/one")


def test_pooch_itself_refuses_other_content(small, tmp_path, monkeypatch):
    import pooch

    other = tmp_path / "other.csv"
    other.write_text("9,9\n")
    real = pooch.retrieve

    def retrieve(url, known_hash, fname, path):
        def copy(_url, output, _pooch):
            pathlib.Path(output).write_bytes(other.read_bytes())

        return real(url, known_hash=known_hash, fname=fname, path=path, downloader=copy)

    fake_pooch(monkeypatch, tmp_path, retrieve)
    with pytest.raises(DataError, match="not the published file"):
        datasets.load("small/one")
    assert not (tmp_path / "cache" / "hystfit" / "small" / "one.csv").exists()


def test_without_download_nothing_is_asked_for(small, tmp_path, monkeypatch):
    fake_pooch(monkeypatch, tmp_path, lambda *_a, **_k: pytest.fail("the network was asked"))
    with pytest.raises(DataError, match="not on this machine"):
        datasets.load("small/one", download=False)


def test_sets_published_in_another_format_say_how_to_get_them(monkeypatch):
    with pytest.raises(DataError, match=r"cannot be downloaded file by file.*HYSTFIT_DATA"):
        datasets.load("friction_brfd/1Hz")


def test_unknown_names_list_the_known_ones():
    with pytest.raises(DataError, match=r"stage-sine.*piezo_dbo/model"):
        datasets.load("piezo")
    with pytest.raises(DataError, match="no data set"):
        datasets.describe("piezo")


def test_bundled_records_are_looked_for_and_missed_clearly(tmp_path):
    (tmp_path / "stage_sine.csv").write_text("t_s,u_V,y_um\n0,0,0\n0.1,1,2\n0.2,0,1\n0.3,1,2\n")
    record = datasets.load("stage-sine", folder=tmp_path)
    assert record.name == "stage-sine"
    assert record.u_unit == "V"
    assert len(record) == 4
    with pytest.raises(DataError, match=r"stage_step\.csv is in none of"):
        datasets.load("stage-step", folder=tmp_path)


def test_every_bundled_record_is_there_and_a_changed_one_is_refused(tmp_path):
    source = pathlib.Path(datasets.__file__).resolve().parents[2] / "data"
    for name, entry in BUNDLED.items():
        record = datasets.load(name)
        assert record.u_unit == "V"
        assert record.y_unit == "um"
        assert np.ptp(record.u) > 50
        assert (source / entry.file).is_file()
    (tmp_path / "checksums.json").write_bytes((source / "checksums.json").read_bytes())
    (tmp_path / "stage_step.csv").write_text((source / "stage_step.csv").read_text().replace("1", "2"))
    with pytest.raises(DataError, match=r"differs from its SHA-256"):
        datasets.load("stage-step", folder=tmp_path)


@needs_data
@pytest.mark.parametrize("name", sorted(MEASURED))
def test_every_published_file_is_read(name, tmp_path):
    data = Dataset.of(datasets.load(name, folder=SHARED, download=False))
    save_records(tmp_path / "records.npz", data)
    for record, stored in zip(data, load_records(tmp_path / "records.npz"), strict=True):
        assert np.ptp(record.u) > 0
        assert np.nanmax(record.y) > np.nanmin(record.y)
        assert stored.notes == record.notes


def tidy(name, *columns, **options):
    return np.genfromtxt(SHARED / "tidy" / name, delimiter=",", names=True, dtype=None, encoding="utf-8", **options)


@needs_data
@pytest.mark.parametrize(("name", "file"), [("model", "piezo_dbo_model.csv"), ("test", "piezo_dbo_test.csv")])
def test_piezo_agrees_with_the_converted_file(name, file):
    record, table = datasets.load(f"piezo_dbo/{name}", folder=SHARED), tidy(file)
    np.testing.assert_allclose(record.t, table["t_s"], atol=1e-9)
    np.testing.assert_array_equal(record.u, table["u_V"])
    np.testing.assert_array_equal(record.y, table["y_um"])


@needs_data
@pytest.mark.parametrize("name", ["M130_27s", "MnZn_ferrite", "MnZn_HP_ferrite"])
def test_magnetic_loops_agree_with_the_converted_file(name):
    loops, table = datasets.load(f"mag_ja_bh/{name}", folder=SHARED), tidy(f"mag_bh_{name}.csv")
    assert len(loops) == table["loop"].max()
    for number, record in enumerate(loops, start=1):
        rows = table["loop"] == number
        np.testing.assert_allclose(record.u, table["H_A_per_m"][rows], rtol=1e-12)
        np.testing.assert_allclose(record.y, table["B_T"][rows], rtol=1e-12)


@needs_data
@pytest.mark.parametrize("name", ["4.1", "4.2"])
def test_damper_agrees_with_the_converted_file(name):
    record, table = datasets.load(f"mr_labcontrol/{name}", folder=SHARED), tidy(f"mr_labcontrol_{name}.csv")
    np.testing.assert_allclose(record.t, table["t_s"], atol=1e-9)
    np.testing.assert_array_equal(record.u, table["x"])
    np.testing.assert_array_equal(record.y, table["F"])


@needs_data
def test_reversal_curves_agree_with_the_converted_file():
    curves, table = datasets.load("mag_forc_pyforc/FeCo", folder=SHARED), tidy("mag_forc_FeCo.csv")
    assert len(curves) == 152
    assert sum(int(record.used.sum()) for record in curves) == 30476
    for number in (1, 76, 152):
        rows = (table["curve"] == number) & (table["kind"] == "forc")
        record = curves[f"curve={number - 1}"]
        assert (record.u_unit, record.y_unit) == ("Oe", "emu")
        np.testing.assert_array_equal(record.u[1:], table["H_Oe"][rows])
        np.testing.assert_array_equal(record.y[1:], table["M_emu"][rows])


@needs_data
def test_columns_and_headers_of_the_structural_files():
    spc1 = datasets.load("struct_slotboom/spc1", folder=SHARED)
    assert np.ptp(spc1.u) == pytest.approx(169.11)
    assert np.ptp(spc1.y) == pytest.approx(103.87)
    assert (len(spc1), len(datasets.load("struct_slotboom/trial2", folder=SHARED))) == (33028, 11287)
