"""Dependencies of other versions: ArviZ before and after 1, and a JAX with which jaxopt no longer imports."""

import sys
import types

import numpy as np
import pytest

import hystfit as hf
from hystfit.outcome import Code, Status

from .saved_examples import fitted, loop, posterior_of


def test_bounded_fits_without_jaxopt_reach_the_same_optimum(monkeypatch):
    monkeypatch.setitem(sys.modules, "jaxopt", None)  # an import of it fails
    result, expected = hf.fit("bouc-wen", loop(), method="lbfgsb", starts=1), fitted()
    assert result.status is Status.OK
    assert [note.code for note in result.notes if "jaxopt" in note.text] == [Code.CHOICE]
    for name in ("c", "mu", "tau", "rho"):
        assert abs(result[name].value - expected[name].value) < 0.01 * expected[name].stderr


def new_arviz(monkeypatch) -> None:
    """ArviZ from version 1 on: `from_dict` takes one dictionary of groups, and the name InferenceData is still there."""
    fake = types.ModuleType("arviz")
    fake.InferenceData = dict
    fake.from_dict = lambda data, *, name=None, dims=None, coords=None: data
    monkeypatch.setitem(sys.modules, "arviz", fake)


@pytest.mark.parametrize("version", ["installed", "1"])
def test_draws_go_to_arviz_before_and_after_version_1(version, monkeypatch):
    if version == "1":
        new_arviz(monkeypatch)
    else:
        import warnings

        with warnings.catch_warnings():  # it announces its next version
            warnings.simplefilter("ignore")
            pytest.importorskip("arviz")
    made = posterior_of(fitted())
    groups = made.to_arviz()
    np.testing.assert_array_equal(np.asarray(groups["posterior"]["c"]), made["c"])
    np.testing.assert_array_equal(np.asarray(groups["sample_stats"]["lp"]), made.log_density)
    assert isinstance(made, hf.Posterior)
