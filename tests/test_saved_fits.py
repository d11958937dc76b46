"""Opening a fit runs no code of its own, and opens what was saved or refuses it in words."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import h5py
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.errors import DataError, HystfitError, ModelError
from hystfit.models.registry import make_model
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.results.saving.folders import alone

from .conftest import ROOT
from .saved_examples import MINE, change, fitted, loop, posterior_of, reseal


@pytest.fixture(scope="module")
def result() -> hf.FitResult:
    return fitted()


@pytest.fixture
def saved(result, tmp_path) -> Path:
    return result.save(tmp_path / "fit", report=False)


@pytest.fixture(scope="module")
def sampled_once(result, tmp_path_factory) -> Path:
    return posterior_of(result).save(tmp_path_factory.mktemp("draws") / "p")


@pytest.fixture
def sampled(sampled_once, tmp_path) -> Path:
    return shutil.copytree(sampled_once, tmp_path / "p")


def own_model(folder: Path) -> tuple[Path, Path]:
    """A file with a model of the user's, and the file in which it counts how often it was run."""
    marks = folder / "marks"
    file = folder / "my_model.py"
    file.write_text(MINE.format(marks=str(marks)))
    return file, marks


@pytest.fixture(scope="module")
def own_once(tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("own")
    file, _ = own_model(folder)
    return hf.fit(f"{file}:Mine", loop(), starts=1).save(folder / "fit", report=False), file


@pytest.fixture
def own(own_once, tmp_path) -> tuple[Path, Path, Path]:
    """A fit of a model in a file that this process has not run: (folder, file, marks)."""
    once, first = own_once
    file, marks = own_model(tmp_path)
    folder = shutil.copytree(once, tmp_path / "own")
    digest = lambda path: hashlib.sha256(path.read_bytes()).hexdigest()
    change(folder, "model.json", digest(first), digest(file))
    change(folder, "model.json", str(first), str(file))
    reseal(folder)
    return folder, file, marks


# -- code of others ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place", ["this:d", "os:system", "hystfit.models.registry:make_model", "hystfit.cli:run", "antigravity:X"]
)
def test_a_class_that_is_no_model_of_hystfits_is_neither_imported_nor_used(saved, place, monkeypatch):
    change(saved, "model.json", "hystfit.models.bouc_wen:BoucWen", place)
    reseal(saved)
    monkeypatch.delitem(sys.modules, "this", raising=False)
    for trust in (False, True):
        with pytest.raises(ModelError):
            hf.load_fit(saved, trust=trust)
    assert not {"this", "antigravity"} & set(sys.modules)


def test_a_model_file_is_run_on_request_only(own):
    folder, file, marks = own
    with pytest.raises(ModelError) as refusal:
        hf.load_fit(folder)
    assert not marks.exists()
    stored = json.loads((folder / "model.json").read_text())["code"]
    assert list(stored) == [str(file)]
    for shown in (str(file), stored[str(file)], "trust=True"):
        assert shown in str(refusal.value)
    opened = hf.load_fit(folder, trust=True)
    assert opened.name == "Mine"
    assert not has(opened.notes, Code.CHANGED_FILES)
    assert marks.read_text() == "run "
    assert hf.load_fit(folder).name == "Mine"  # this process has the class now
    assert marks.read_text() == "run "


def test_a_model_file_that_has_changed_is_told(own):
    folder, file, marks = own
    before = json.loads((folder / "model.json").read_text())["code"][str(file)]
    file.write_text(file.read_text() + "\n# changed\n")
    with pytest.raises(ModelError, match="CHANGED") as refusal:
        hf.load_fit(folder)
    assert before in str(refusal.value)
    assert not marks.exists()
    assert has(hf.load_fit(folder, trust=True).notes, Code.CHANGED_FILES)


def test_a_compiled_copy_of_a_model_file_is_not_run(tmp_path):
    """Its checksum would not be that of what runs."""
    import importlib.util
    import py_compile

    file, marks = own_model(tmp_path)
    forged = tmp_path / "forged.py"
    forged.write_text("raise SystemExit('forged')")
    cache = Path(importlib.util.cache_from_source(str(file)))
    py_compile.compile(
        str(forged), cfile=str(cache), dfile=str(file), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH
    )
    assert make_model(f"{file}:Mine").rate_independent
    assert marks.read_text() == "run "


VERBS = {
    "report": [],
    "predict": ["loop.csv"],
    "invert": ["loop.csv", "--output", "y_um"],
    "export": ["--c", "c"],
    "sample": [],
    "profile": [],
    "errors": [],
    "calibrate": [],
    "design": [],
}


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_asks_before_a_model_file_is_run(verb, own, capsys):
    folder, _, marks = own
    assert run([verb, str(folder), *VERBS[verb]]) == 2
    assert "--trust" in capsys.readouterr().err
    assert not marks.exists()


def test_simulate_asks_too(own, tmp_path, capsys):
    folder, _, marks = own
    assert run(["simulate", str(folder), "--out", str(tmp_path / "x.csv")]) == 2
    assert "--trust" in capsys.readouterr().err
    assert not marks.exists()
    assert run(["simulate", str(folder), "--trust", "--out", str(tmp_path / "x.csv")]) == 0
    assert marks.exists()


def test_a_noise_model_in_a_file_is_run_on_request_only(saved, tmp_path):
    noise = tmp_path / "my_noise.py"
    noise.write_text("raise SystemExit('run')")
    change(saved, "result.json", '"name": "auto"', json.dumps("name") + ": " + json.dumps(f"{noise}:Own"))
    reseal(saved)
    with pytest.raises(ModelError, match="trust=True"):
        hf.load_fit(saved)
    with pytest.raises(SystemExit):
        hf.load_fit(saved, trust=True)


def test_a_noise_model_of_a_posterior_is_run_on_request_only(sampled, tmp_path):
    noise = tmp_path / "my_noise.py"
    noise.write_text("raise SystemExit('run')")
    header_of(sampled, noise=f"{noise}:Own")
    with pytest.raises(ModelError, match="trust=True"):
        hf.load_posterior(sampled)


def test_a_class_typed_into_an_interpreter_is_found_while_it_is_there(tmp_path, monkeypatch):
    import __main__

    Typed = type("Typed", (hf.BoucWen,), {"__module__": "__main__", "__doc__": "Own."})
    monkeypatch.setattr(__main__, "Typed", Typed, raising=False)
    monkeypatch.delattr(__main__, "__file__", raising=False)
    folder = hf.fit(Typed(), loop(), starts=1).save(tmp_path / "fit", report=False)
    assert type(hf.load_fit(folder).model) is Typed
    monkeypatch.delattr(__main__, "Typed")
    with pytest.raises(ModelError, match="define it again"):
        hf.load_fit(folder)


def test_no_pickle_is_read(saved, tmp_path):
    from hystfit.runs.chunks import load

    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "bombed"),)

    np.savez(saved / "records.npz", labels=np.array([Bomb()], dtype=object), u0=np.array([Bomb()], dtype=object))
    np.savez(tmp_path / "chunk.npz", q=np.array([Bomb()], dtype=object))
    with pytest.raises(DataError):
        hf.load_fit(saved, trust=True)
    assert load(tmp_path / "chunk.npz") is None
    assert not (tmp_path / "bombed").exists()


# -- data of others ------------------------------------------------------------------------------------------------------


def header_of(folder: Path, **changes) -> None:
    """Change the header of a posterior."""
    with h5py.File(folder / "posterior.nc", "r+") as file:
        header = json.loads(file["posterior"].attrs["hystfit"]) | changes
        file["posterior"].attrs["hystfit"] = json.dumps(header)
    reseal(folder)


def outside(kind: str, file: h5py.File, secret: Path) -> None:
    """Replace the draws of a parameter by data of another file."""
    group, shape = file["posterior"], file["posterior/c"].shape
    del group["c"]
    if kind == "external":
        group.create_dataset("c", shape, "f8", external=[(str(secret), 0, h5py.h5f.UNLIMITED)])
    elif kind == "virtual":
        layout = h5py.VirtualLayout(shape, "f8")
        layout[:] = h5py.VirtualSource(str(secret), "data", shape)
        group.create_virtual_dataset("c", layout)
    elif kind == "link":
        group["c"] = h5py.ExternalLink(str(secret), "data")
    else:
        group.create_dataset("c", (10**7, 10**5), "f8", chunks=(1, 10**5))


@pytest.mark.parametrize("kind", ["external", "virtual", "link", "huge"])
def test_a_posterior_with_data_elsewhere_is_refused(sampled, tmp_path, kind):
    secret = tmp_path / "secret"
    with h5py.File(secret, "w") as file:
        file["data"] = np.zeros((2, 40))
    with h5py.File(sampled / "posterior.nc", "r+") as file:
        outside(kind, file, secret)
    reseal(sampled)
    with pytest.raises(DataError, match=r"posterior\.nc"):
        hf.load_posterior(sampled)


def test_a_header_with_a_number_that_no_float_holds_is_refused(sampled):
    header_of(sampled, convergence={"rhat": [10**400], "bulk": [1.0], "tail": [1.0]})
    with pytest.raises(DataError, match=r"posterior\.nc"):
        hf.load_posterior(sampled)


# -- whole or refused ----------------------------------------------------------------------------------------------------


def test_a_fit_opens_as_it_was_saved(result, saved):
    assert hf.load_fit(saved).to_dict() == result.to_dict()
    assert {path.name for path in saved.iterdir()} == {"result.json", "model.json", "records.npz", "manifest.json"}


@pytest.mark.parametrize(("fix", "models"), [(["offset"], 1), ([], 2)])
def test_records_that_share_all_values_share_a_saved_model(fix, models, tmp_path):
    u = np.cumsum(np.sin(np.linspace(0, 25, 200)))
    records = [hf.Record(u=u, y=0.1 * k + np.tanh(u / 9) + 0.01 * np.cos(7 * u), name=f"r{k}") for k in range(2)]
    fit = hf.fit("bouc-wen", records, fix=fix, starts=1)
    folder = fit.save(tmp_path / "fit", report=False)
    assert len(json.loads((folder / "model.json").read_text())["models"]) == models
    again = hf.load_fit(folder)
    np.testing.assert_array_equal(again.x, fit.x)
    assert all(eqx.tree_equal(*pair) for pair in zip(again.models, fit.models, strict=True))


def test_a_fit_with_weights_near_their_bounds_opens_as_it_was_saved(tmp_path):
    """Its covariance is that of a truncated normal; a saved fit keeps one half of it."""
    made = hf.fit("prandtl-ishlinskii:plays=4", loop(), starts=1)
    assert hf.load_fit(made.save(tmp_path / "fit", report=False)).to_dict() == made.to_dict()


def test_a_damaged_covariance_is_refused_under_a_manifest_that_fits(saved):
    """The reader of .npz files meets damage in one array when that array is read, not when the file is opened."""
    content = (saved / "records.npz").read_bytes()
    place = content.index(b"known.npy")
    damages = {
        "name": content[:place] + b"unown.npy" + content[place + 9 :],
        "content": content[: place + 40] + bytes([content[place + 40] ^ 255]) + content[place + 41 :],
    }
    for damaged in damages.values():
        (saved / "records.npz").write_bytes(damaged)
        reseal(saved)
        with pytest.raises(DataError, match=r"records\.npz"):
            hf.load_fit(saved)


def test_a_posterior_opens_as_it_was_saved(result, sampled):
    made, opened = posterior_of(result), hf.load_posterior(sampled)
    np.testing.assert_array_equal(opened.draws, made.draws)
    assert opened.to_dict() == made.to_dict()
    assert opened.result.to_dict() == result.to_dict()


@pytest.mark.parametrize("name", ["result.json", "model.json", "records.npz", "manifest.json"])
def test_a_file_that_is_missing_or_changed_is_named(saved, name):
    content = (saved / name).read_bytes()
    (saved / name).write_bytes(content[:-2])
    with pytest.raises(DataError, match=name):
        hf.load_fit(saved)
    (saved / name).unlink()
    with pytest.raises(DataError, match=name):
        hf.load_fit(saved)


@pytest.mark.parametrize("name", ["result.json", "posterior.nc", "fit/manifest.json", "fit/model.json"])
def test_a_file_of_a_posterior_that_is_missing_or_changed_is_named(sampled, name):
    with (sampled / name).open("ab") as file:
        file.write(b" ")
    with pytest.raises(DataError, match=name.rpartition("/")[2]):
        hf.load_posterior(sampled)


def test_files_of_two_fits_are_no_fit(saved, tmp_path):
    other = fitted(offset=3.0).save(tmp_path / "other", report=False)
    shutil.copy(other / "model.json", saved / "model.json")
    for trust in (False, True):  # a mixture is no edit
        with pytest.raises(DataError):
            hf.load_fit(saved, trust=trust)


def test_an_intended_edit_opens_with_a_note(saved):
    change(saved, "result.json", '"status": "ok"', '"status": "rough"')
    with pytest.raises(DataError, match=r"result\.json.*trust=True"):
        hf.load_fit(saved)
    opened = hf.load_fit(saved, trust=True)
    assert (opened.status, has(opened.notes, Code.CHANGED_FILES)) == ("rough", True)
    again = hf.load_fit(opened.save(saved.parent / "again", report=False))
    assert has(again.notes, Code.CHANGED_FILES)


def test_results_of_earlier_versions_are_refused_in_words(saved, sampled):
    for folder, kind, load in ((saved, "fit", hf.load_fit), (sampled, "sample", hf.load_posterior)):
        (folder / "manifest.json").unlink()
        (folder / "result.json").write_text(json.dumps({"schema": f"hystfit.{kind}/2"}))
        with pytest.raises(DataError, match="earlier version"):
            load(folder)


WRONG = {
    "status": ("status", "fine"),
    "notes": ("notes", [{"code": "poor-fit"}]),
    "number": ("residuals", {"sigma": "0.1", "correlation_time_samples": 1.0, "error_ratio_to_iid": 1.0}),
    "truth": ("method", {"name": "lm", "starts": True, "in_best_basin": 1}),
    "covariance": ("covariance", [[1.0]]),
    "variance": ("covariance", (-np.eye(5)).tolist()),
    "parameters": ("parameters", {"c": 1.0}),
    "names": ("free_names", ["c"]),
    "metrics": ("metrics", {"train": None, "test": None}),
    "versions": ("provenance", {"date": "", "python": "", "versions": [], "seed": 0, "records": []}),
}


@pytest.mark.parametrize("case", WRONG)
def test_every_value_has_its_type(saved, case):
    name, value = WRONG[case]
    stored = json.loads((saved / "result.json").read_text())
    (saved / "result.json").write_text(json.dumps({**stored, name: value}))
    reseal(saved)
    with pytest.raises(DataError, match=r"result\.json"):
        hf.load_fit(saved)


@pytest.mark.parametrize(
    "content", ["[" * 100_000, '{"schema": "hystfit.fit/3", "schema": "x"}', "\x00", '{"a": NaN}', "3"]
)
def test_what_is_no_result_is_refused(saved, content):
    (saved / "result.json").write_text(content)
    reseal(saved)
    with pytest.raises(DataError, match=r"result\.json"):
        hf.load_fit(saved)


# -- one writer, and only over one's own ---------------------------------------------------------------------------------


def test_a_run_that_is_refused_leaves_no_folder(result, tmp_path):
    with pytest.raises(HystfitError, match="nonsense"):
        hf.sample(result, noise="iid", priors={"nonsense": hf.priors.Normal(0.0, 1.0)}, folder=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_second_run_in_a_folder_is_refused(result, tmp_path):
    hold = (
        "import sys\nfrom hystfit.results.saving.folders import alone\n"
        "with alone(sys.argv[1]):\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    first = subprocess.Popen(
        [sys.executable, "-c", hold, str(tmp_path / "run")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
    )
    try:
        assert first.stdout.readline() == b"held\n"
        with pytest.raises(HystfitError, match="another process"):
            hf.sample(result, draws=50, chains=1, warmup=50, folder=tmp_path / "run")
        with pytest.raises(HystfitError, match="another process"):
            hf.calibrate(result.model, result.data, replicates=10, folder=tmp_path / "run")
    finally:
        first.kill()
        first.wait()
        first.stdin.close()
        first.stdout.close()
    with alone(tmp_path / "run"):  # a process that was killed keeps nobody out
        pass
    assert list((tmp_path / "run").iterdir()) == []


def test_what_a_killed_run_left_is_removed(result, saved):
    (saved / ".hystfit-new-abc").mkdir()
    (saved / ".hystfit-new-abc" / "result.json").write_text("{")
    result.save(saved, report=False)
    assert {path.name for path in saved.iterdir()} == {"result.json", "model.json", "records.npz", "manifest.json"}


def test_a_folder_of_other_content_is_found_before_any_work(result, saved, sampled, tmp_path, capsys, monkeypatch):
    from hystfit.fitting import fit as fit_module

    monkeypatch.setattr(fit_module, "fit", lambda *_, **__: pytest.fail("computed before the check"))
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "result.json").write_text('{"mine": 1}')
    blocked = tmp_path / "blocked"
    (blocked / "result.json").mkdir(parents=True)
    file = tmp_path / "file"
    file.write_text("")
    before = (sampled / "result.json").read_bytes()
    for target in (foreign, blocked, file, sampled):
        assert run(["fit", "stage-sine", "--model", "bouc-wen", "--out", str(target)]) == 2
        assert str(target) in capsys.readouterr().err
        with pytest.raises(HystfitError):
            result.save(target)
    assert (foreign / "result.json").read_text() == '{"mine": 1}'
    assert (sampled / "result.json").read_bytes() == before
    with pytest.raises(HystfitError, match="holds a fit"):
        posterior_of(result).save(saved)


def test_a_clash_of_names_moves_nothing(result, saved):
    before = {name: (saved / name).read_bytes() for name in ("result.json", "model.json", "manifest.json")}
    (saved / "records.npz").unlink()
    (saved / "records.npz").mkdir()
    with pytest.raises(HystfitError, match=r"records\.npz"):
        fitted(offset=3.0).save(saved, report=False)
    assert {name: (saved / name).read_bytes() for name in before} == before


def test_the_covariance_of_many_parameters_is_kept_beside_the_records(tmp_path):
    """As text it takes a hundred megabytes for two thousand parameters."""
    u = np.sin(np.linspace(0, 40, 900)) * np.linspace(1.0, 0.1, 900)
    y = np.asarray(hf.simulate(hf.ParametricPreisach(), u)[0])
    result = hf.fit("preisach:n=24", hf.Record(u, y + 0.01 * np.random.default_rng(0).normal(size=u.size)))
    assert len(result.free_names) > 200
    result.save(tmp_path / "fit", report=False)
    assert json.loads((tmp_path / "fit" / "result.json").read_text())["covariance"] is None
    opened = hf.load_fit(tmp_path / "fit")
    np.testing.assert_allclose(opened.covariance, result.covariance, rtol=1e-8)  # symmetric up to rounding
    assert opened["offset"].stderr == result["offset"].stderr
