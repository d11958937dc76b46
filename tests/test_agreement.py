"""Standard errors of one fit by five verbs: equal, or a note says that they differ and why."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.results.estimates import SIMILAR
from hystfit.uncertainty.input_design import design

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)


def driven(correlation: float) -> hf.Record:
    """A Bouc-Wen model in white noise, or in slow noise on top of it."""
    k, rng, slow = np.arange(800), np.random.default_rng(1), np.zeros(800)
    for j in k[1:]:
        slow[j] = correlation * slow[j - 1] + 0.004 * rng.normal()
    u = np.sin(2 * np.pi * k / 200) * (0.4 + 0.6 * k / 800)
    y = np.asarray(hf.simulate(TRUTH, u)[0]) + 0.005 * rng.normal(size=800)
    return hf.Record(u=u, y=y + (slow if correlation else 0.0))


def duhem() -> hf.Record:
    """A Duhem model in white noise."""
    k = np.arange(800)
    u = np.sin(2 * np.pi * k / 200) * (0.4 + 0.6 * k / 800)
    y = np.asarray(hf.simulate(hf.Duhem(), u)[0])
    return hf.Record(u=u, y=y + 0.01 * np.random.default_rng(2).normal(size=800))


def errors_by_verb(fit: hf.FitResult, draws: int | None) -> dict[str, tuple[dict[str, float], tuple]]:
    """Standard errors by parameter, and the notes, of each verb; sampling only where draws are given."""
    limits, made, table = hf.profile(fit), design(fit, samples=300, method="families"), hf.standard_errors(fit)
    halves = {n: (p.upper - p.lower) / (2 * 1.96) for n, p in limits.profiles.items() if p.closed}
    found = {"profile": (halves, limits.notes), "design": (made.present, made.notes)}
    for rule in set(table.errors) - {"fit", "iid"}:
        found[rule] = (dict(zip(fit.free_names, table.errors[rule], strict=True)), table.notes)
    if draws:
        posterior = hf.sample(fit, "nuts", chains=2, draws=draws, warmup=200)
        found["sample"] = ({n: float(posterior[n].std()) for n in fit.free_names}, posterior.notes)
    return found


def unexplained(fit: hf.FitResult, found: dict) -> list[tuple[str, str, float]]:
    """Verb, parameter and ratio to the error of the fit where they differ without a note; the rules of `errors` share their notes."""
    rows = []
    for verb, (errors, notes) in found.items():
        for name, error in errors.items():
            reported = fit[name].stderr
            if error and reported and not has(notes, Code.ERRORS_DIFFER):
                rows.append((verb, name, error / reported))
    return [row for row in rows if not 1 / SIMILAR < row[2] < SIMILAR]


def test_in_white_noise_the_verbs_agree():
    fit = hf.fit(TRUTH, driven(0.0), starts=1)
    found = errors_by_verb(fit, None)
    for verb, tolerance in (("design", 0.01), ("profile", 0.1)):
        for name, error in found[verb][0].items():
            assert error == pytest.approx(fit[name].stderr, rel=tolerance), (verb, name)
    assert not unexplained(fit, found)


RECORDS = {
    "bouc-wen, white noise": lambda _: ("bouc-wen", driven(0.0)),
    "bouc-wen, slow noise": lambda _: ("bouc-wen", driven(0.95)),
    "duhem": lambda _: ("duhem", duhem()),
    "stage sweep": lambda _: ("bouc-wen", hf.datasets.load("stage-sweep")),
    "piezo": lambda folder: (
        "bouc-wen",
        hf.read_csv(folder / "tidy" / "piezo_dbo_model.csv").window(5.0, 10.0),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDS)
def test_errors_of_five_verbs_agree_or_the_difference_is_explained(name, request):
    folder = request.getfixturevalue("measured") if name == "piezo" else None
    model, record = RECORDS[name](folder)
    fit = hf.fit(model, record)
    found = errors_by_verb(fit, 300)
    for parameter in fit.free_names:
        cells = {verb: errors.get(parameter) for verb, (errors, _) in found.items()}
        print(name, parameter, fit[parameter].stderr, cells)
    for verb, (_, notes) in found.items():
        print(name, verb, [note.text for note in notes if note.code is Code.ERRORS_DIFFER])
    assert not unexplained(fit, found)
    for parameter, error in found["design"][0].items():
        if error is not None:
            assert error == pytest.approx(fit[parameter].stderr, rel=0.05), parameter
