"""Calibration on cases whose answer is known: a right set-up passes, a wrong one fails, runs resume, failures are kept."""

import re
import threading
import tomllib
from contextlib import contextmanager
from pathlib import Path

import distributed
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import DataError, MissingExtraError, ParameterError
from hystfit.inference.priors import LogNormal, priors_around
from hystfit.params.space import ParameterSpace
from hystfit.runs import pool
from hystfit.uncertainty import replicates
from hystfit.uncertainty.calibration import RANKS, Calibration, calibrate

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
PARAMETERS = {"fix": ["rho"], "free": ["h0"]}
U = np.sin(2 * np.pi * 2 * np.arange(300) / 300) * (0.4 + 0.6 * np.arange(300) / 300)
DATA = hf.Record(u=U, y=np.asarray(hf.simulate(TRUTH, U)[0]))


def made(ranks: np.ndarray, failures: int = 0) -> Calibration:
    names = tuple(f"p{k}" for k in range(ranks.shape[1]))
    failed = tuple((k, "the mode was not found") for k in range(failures))
    return Calibration(names, ranks, RANKS, np.zeros(ranks.shape), failed, "laplace", "iid", "iid", "BoucWen")


def test_uniform_ranks_pass_at_the_stated_rate_and_others_fail():
    rng = np.random.default_rng(0)
    alarms = [not made(rng.integers(0, RANKS + 1, (200, 3))).passes(0.05) for _ in range(60)]
    assert np.mean(alarms) < 0.15
    narrow = rng.normal(size=(200, 1)) * 2  # truth twice as far out as the posterior thinks
    ranks = np.clip(np.round((0.5 + 0.5 * np.tanh(narrow * 0.8)) * RANKS), 0, RANKS).astype(int)
    assert not made(ranks).passes()
    shifted = np.minimum(rng.integers(0, RANKS + 1, (200, 1)) + 12, RANKS)
    assert made(shifted).status == "miscalibrated"


def test_a_handful_of_replicates_is_no_verdict():
    rng = np.random.default_rng(0)
    few = made(rng.integers(0, RANKS + 1, (5, 2)))
    assert few.status == "too-few"
    assert made(np.zeros((15, 2), int)).status == "miscalibrated"  # some set-ups are wrong beyond doubt


def test_coverage_counts_central_intervals_and_its_band_is_binomial():
    ranks = np.arange(RANKS + 1)[:, None]
    study = made(ranks)
    assert study.coverage(0.5)[0] == pytest.approx(0.5)
    assert study.coverage(0.95)[0] == pytest.approx(0.95, abs=0.03)
    low, high = made(np.zeros((400, 1), int)).coverage_band(0.95)
    assert 0.91 < low < 0.94 < 0.96 < high < 0.99


def test_too_many_failures_fail_a_study_and_are_listed():
    study = made(np.random.default_rng(0).integers(0, RANKS + 1, (100, 1)), failures=20)
    assert not study.passes()
    assert len(study.to_dict()["failures"]) == 20


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=folder)


def test_a_study_without_one_replicate_says_why_and_gives_no_number():
    nothing = np.zeros((0, 1))
    failed = Calibration(("c",), nothing.astype(int), 99, nothing, ((0, "no fit"),), "laplace", "ou", "ou", "duhem")
    assert failed.status == "failed"
    assert repr(failed) == str(failed)  # with a status that has no number behind it
    assert [(row["p"], row["coverage95"]) for row in failed.table().to_list()] == [(None, None)]
    assert len(failed.to_dict()["failures"]) == 1


def test_a_right_set_up_passes(honest):
    study = honest[1]
    assert study.passes(0.01), str(study)
    assert study.names == ("c", "mu", "tau", "h0", "offset")
    assert len(study.ranks) + len(study.failures) == 60
    low, high = study.coverage_band(0.95, 0.999)
    assert np.all((study.coverage() >= low) & (study.coverage() <= high))
    assert np.abs(study.errors.std(axis=0) - 1).max() < 0.35  # errors are as large as the posterior says


def test_iid_under_slow_noise_fails():
    study = calibrate(TRUTH, DATA, noise="ou", assumed="iid", replicates=40, **PARAMETERS)
    assert not study.passes(), str(study)
    assert study.coverage().mean() < 0.8


def test_a_study_goes_on_from_its_chunks(honest):
    folder, study = honest
    seen: list[str] = []
    (folder / "chunk-00002.npz").unlink()
    (folder / ".chunk-00002.npz").write_bytes(b"half")  # what a kill leaves
    again = calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=folder, progress=seen.append)
    np.testing.assert_array_equal(again.ranks, study.ranks)
    assert len(seen) == 1
    with pytest.raises(DataError, match="another study"):
        calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=folder, seed=1)


@pytest.mark.parametrize("damage", ["empty", "half", "noise"])
def test_a_damaged_chunk_is_made_again(honest, damage):
    folder, study = honest
    file = folder / "chunk-00001.npz"
    whole = file.read_bytes()
    file.write_bytes(
        {"empty": b"", "half": whole[: len(whole) // 2], "noise": b"PK\x03\x04" + bytes(range(200))}[damage]
    )
    seen: list[str] = []
    again = calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=folder, progress=seen.append)
    np.testing.assert_array_equal(again.ranks, study.ranks)
    assert len(seen) == 1
    assert file.read_bytes() != b""


def test_a_chunk_that_breaks_is_told_and_not_kept(honest, tmp_path, monkeypatch):

    run_chunk = replicates.run_chunk

    def breaking(study, number):
        if number == 1:
            raise MemoryError("no memory left")
        return run_chunk(study, number)

    monkeypatch.setattr(replicates, "run_chunk", breaking)
    found = calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=tmp_path)
    assert len(found.failures) == 10
    assert all("chunk broke" in why for _, why in found.failures)
    assert found.broken == ("chunk 1 broke: MemoryError: no memory left",)
    assert not (tmp_path / "chunk-00001.npz").exists()
    assert found.status == "miscalibrated"  # a sixth of the replicates failed
    monkeypatch.setattr(replicates, "run_chunk", run_chunk)
    again = calibrate(TRUTH, DATA, noise="iid", replicates=60, **PARAMETERS, folder=tmp_path)
    np.testing.assert_array_equal(again.ranks, honest[1].ranks)


@pytest.mark.usefixtures("as_users_run")
def test_settings_that_mean_nothing_are_refused():
    with pytest.raises(ParameterError, match="method must be"):
        calibrate(TRUTH, DATA, method="gibbs")
    with pytest.raises(ParameterError, match="noise must be one of"):
        calibrate(TRUTH, DATA, assumed="pink")
    with pytest.raises(ParameterError, match="at least 1"):
        calibrate(TRUTH, DATA, replicates=0)


@contextmanager
def dask(workers: int, processes: bool):
    settings = {"threads_per_worker": 1, "protocol": "tcp://", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=workers, processes=processes, **settings) as cluster:
        yield cluster


@pytest.mark.parametrize("processes", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_dask_workers_make_the_same_chunks(honest, tmp_path, processes):
    study, again = honest[1], tmp_path / "dask"
    with dask(1, processes=processes) as cluster:
        found = calibrate(
            TRUTH, DATA, noise="iid", replicates=20, **PARAMETERS, folder=again, scheduler=cluster.scheduler_address
        )
    np.testing.assert_array_equal(found.ranks, study.ranks[:20])
    assert len(list(again.glob("chunk-*.npz"))) == 2


@pytest.mark.parametrize(
    ("workers", "leave", "message"),
    [
        (0, None, "has no workers that run"),
        (1, lambda cluster: cluster.scale(0), "has no workers that run"),
        (1, lambda cluster: cluster.close(), "was lost"),
    ],
    ids=["never-any", "left", "scheduler-lost"],
)
def test_dask_workers_that_are_not_there_end_a_study_and_keep_its_chunks(
    monkeypatch, tmp_path, workers, leave, message
):
    # Tasks that no worker takes wait for ever.
    monkeypatch.setattr(pool, "_PATIENCE", 2.0)
    with dask(workers, processes=False) as cluster:
        told = lambda line: threading.Thread(target=leave, args=[cluster]).start() if line.startswith("1 of") else None
        with pytest.raises(DataError, match=message):
            calibrate(
                TRUTH,
                DATA,
                noise="iid",
                replicates=2000,
                **PARAMETERS,
                scheduler=cluster.scheduler_address,
                folder=tmp_path,
                progress=told,
            )
    assert len(list(tmp_path.glob("chunk-*.npz"))) >= workers


@pytest.mark.parametrize("nobody", ["tcp://127.0.0.1:1", "127.0.0.1", "http://127.0.0.1:80", "nonsense"])
def test_an_address_where_nobody_listens_is_told_at_once(monkeypatch, nobody):
    # A client that finds nobody waits for half a minute, and for a whole one when it is thrown away.
    monkeypatch.setattr(distributed, "Client", lambda *a, **k: pytest.fail("asked a client"))
    with pytest.raises(DataError, match="no Dask scheduler answers"):
        calibrate(TRUTH, DATA, noise="iid", replicates=10, scheduler=nobody)


def test_every_extra_that_an_error_names_is_one_of_the_project():
    root = Path(hf.__file__).parents[1]
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    calls = [
        found
        for file in (root / "hystfit").rglob("*.py")
        for found in re.findall(r"optional\(\"(\w+)\", \"(\w+)\"", file.read_text())
    ]
    assert len(calls) >= 14
    for package, extra in calls:
        named = [part.split(">")[0].strip().replace("-", "_") for part in extras[extra]]
        assert package in named, (package, extra)
    assert set(extras["all"][0].partition("[")[2].strip("]").split(",")) == set(extras) - {"all", "test", "docs", "dev"}


def test_a_scheduler_without_dask_names_the_extra(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"hystfit-jax\[batch\]"):
        calibrate(TRUTH, DATA, noise="iid", replicates=1, scheduler="tcp://nowhere:1")


def test_what_a_fit_freed_is_calibrated_too(honest):
    folder, study = honest
    assert "h0" in study.names
    with pytest.raises(DataError, match="another study"):
        calibrate(TRUTH, DATA, noise="iid", replicates=60, fix=["rho"], folder=folder)


def test_weights_of_zero_and_values_on_bounds_have_priors_inside():
    play = hf.PrandtlIshlinskii(w=[[0.5, 0.0]], r=[0.1, 0.3], b=[1.0])
    space = ParameterSpace.of(play)
    around = priors_around(space, space.vector(play))
    assert isinstance(around["w[0,1]"], LogNormal)
    bound = hf.BoucWen(c=1.0, mu=1.0, tau=0.0, rho=-1.0)
    every = priors_around(ParameterSpace.of(bound), ParameterSpace.of(bound).vector(bound))
    for prior in (*around.values(), *every.values()):
        drawn = np.asarray(prior.sample(jax.random.key(0), (50,)))
        assert np.all(np.isfinite([prior.log_density(jnp.asarray(x)) for x in drawn]))


@pytest.mark.parametrize("content", [b"[]", b"{}", b"\xff\xfe", b"half a f"])
def test_a_damaged_label_of_a_study_is_told(tmp_path, content):
    (tmp_path / "study.json").write_bytes(content)
    with pytest.raises(DataError, match="is damaged"):
        calibrate(TRUTH, DATA, noise="iid", replicates=10, folder=tmp_path)
