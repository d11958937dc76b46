"""Dependencies of other versions: ArviZ before and after 1, and a JAX with which jaxopt no longer imports."""

import os
import subprocess
import sys
import types

import numpy as np
import pytest

import hystfit as hf

from .conftest import ROOT
from .saved_examples import fitted, posterior_of

BLOCKED = """
import sys
sys.modules["jaxopt"] = None
import hystfit as hf
hf.enable_x64()
from tests.saved_examples import loop
result = hf.fit("bouc-wen", loop(), method="lbfgsb", starts=1)
choices = [note for note in result.notes if note.code == "choice" and "jaxopt" in note.text]
print(result.status, len(choices), *(result[name].value for name in ("c", "mu", "tau", "rho")))
"""


def test_bounded_fits_without_jaxopt_reach_the_same_optimum():
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_ENABLE_X64": "1"}
    ended = subprocess.run(
        [sys.executable, "-c", BLOCKED], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )
    assert ended.returncode == 0, ended.stderr
    expected = fitted()
    status, notes, *values = ended.stdout.split()
    assert (status, notes) == ("ok", "1"), ended.stdout
    for name, value in zip(("c", "mu", "tau", "rho"), values, strict=True):
        assert abs(float(value) - expected[name].value) < 0.01 * expected[name].stderr


def new_arviz(monkeypatch) -> None:
    """ArviZ from version 1 on: `from_dict` takes one dictionary of groups, and the name InferenceData is still there."""
    fake = types.ModuleType("arviz")
    fake.InferenceData = dict
    fake.from_dict = lambda data, *, name=None: data
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
