"""Where hystfit computes, whatever the default device of JAX is: on emulated devices, and on a GPU where JAX finds one."""

import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import jax
import pytest

import hystfit as hf
from hystfit import config
from hystfit.fitting.solvers import lanes

PACKAGE = Path(hf.__file__).parent
# Two devices of the CPU stand for a host and its GPU; the second is the default device of JAX, from before the package is imported.
ON_THE_SECOND = """
import jax, numpy as np
first, second = jax.devices()
jax.config.update("jax_default_device", second)
import hystfit as hf
hf.enable_x64()
where = lambda: sorted({device.id for array in jax.live_arrays() for device in array.devices()})
u, kept = np.sin(np.linspace(0, 20, 300)), []
y = np.asarray(hf.simulate(hf.Linear(), u)[0]) + 1e-2 * np.random.default_rng(0).normal(size=u.size)
for device in ("cpu", "jax"):
    hf.use_device(device)
    kept += [hf.simulate(hf.BoucWen(), u), hf.fit("linear", u, y)]
    print(where(), end=" ")
many = jax.jit(jax.vmap(lambda c: hf.simulate(hf.Linear(k=c), u)[0]))(jax.numpy.ones(3))
print(jax.numpy.ones(3).devices() == {second}, many.devices() == {second})
"""


def python(code: str, **variables: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent), "JAX_PLATFORMS": "cpu", **variables}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tempfile.gettempdir()
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_fits_run_on_the_cpu_whatever_the_default_device_is() -> None:
    """Arrays stay where a fit leaves them; programs of the user's own run where JAX runs them."""
    flags = f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=2"
    assert python(ON_THE_SECOND, XLA_FLAGS=flags) == "[0] [0, 1] True True"


def test_a_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(hf.HystfitError, match="no device of the platform 'abacus'"):
        hf.use_device("abacus")


@pytest.mark.parametrize(
    ("chosen", "there", "taken"), [("auto", 2000, "gpu"), ("auto", 20, "cpu"), ("cpu", 2000, "cpu")]
)
def test_many_loops_go_to_the_gpu_unless_the_cpu_is_chosen(
    chosen: str, there: int, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (config, lanes):
        monkeypatch.setattr(module, "first_device", lambda platform: platform)
    monkeypatch.setattr(config, "_platform", "auto")
    hf.use_device(chosen)
    assert lanes.device_for(there) == taken


@pytest.mark.parametrize("zipped", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_fit_needs_no_installed_metadata(tmp_path: Path, zipped: bool) -> None:
    """The package zipped, and on the path."""
    archive = tmp_path / "hystfit.zip"
    with zipfile.ZipFile(archive, "w") as packed:
        for file in PACKAGE.rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                packed.write(file, file.relative_to(PACKAGE.parent))
    code = """
import importlib.metadata as metadata, sys
found = metadata.version
def missing(name):
    if name == "hystfit":
        raise metadata.PackageNotFoundError(name)
    return found(name)
metadata.version = missing
import numpy as np, hystfit as hf
assert hf.__file__.startswith(PLACE), hf.__file__
hf.enable_x64()
u = np.sin(np.linspace(0, 20, 300))
y = np.asarray(hf.simulate(hf.BoucWen(), u)[0]) + 1e-2 * np.random.default_rng(0).normal(size=u.size)
print(hf.fit("linear", u, y).provenance["versions"]["hystfit"])
"""
    place = archive if zipped else PACKAGE.parent
    assert python(f"PLACE = {str(place)!r}\n{code}", PYTHONPATH=str(place)) == hf.__version__


@pytest.mark.skipif(jax.default_backend() != "gpu", reason="JAX finds no GPU")
def test_a_gpu_is_used_where_it_is_asked_for() -> None:
    hf.use_device("gpu")
    try:
        assert hf.simulate(hf.Linear(), [0.0, 1.0])[0].devices() == {jax.devices("gpu")[0]}
    finally:
        hf.use_device("auto")
