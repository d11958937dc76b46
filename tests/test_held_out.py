"""What is held out to judge a fit follows the records."""

import numpy as np
import pytest

from hystfit.data import Record
from hystfit.quality.held_out import FOLDS, Scheme, correlation_length, future, held_out, inner_loops

T = np.arange(2000) / 100


def sine(amplitude=1.0, cycles=20, name="r"):
    u = amplitude * np.sin(2 * np.pi * cycles * np.arange(2000) / 2000)
    return Record(u, u, name=name)


def test_whole_records_inside_the_range_of_the_others_are_held_out():
    groups = held_out([sine(a, name=f"{a}") for a in (0.3, 0.5, 1.0, 1.0)])
    assert groups.scheme is Scheme.RECORDS
    assert all(np.ptp(fold) == 0 for fold in groups.folds)
    assert (
        len({int(fold[0]) for fold in groups.folds}) == groups.count == 4
    )  # the two largest reach as far as each other
    nested = held_out([sine(a, name=f"{a}") for a in (0.3, 0.5, 0.8, 1.2)])
    assert nested.folds[3].max() == -1  # nothing else reaches as far: it stays in every fit


def test_all_records_are_held_out_where_none_lies_inside_the_others():
    apart = [Record(np.linspace(k, k + 1, 50), np.arange(50.0), name=f"{k}") for k in range(3)]
    assert held_out(apart).count == 3


def test_records_are_dealt_out_to_five_groups():
    groups = held_out([sine(name=f"{k}") for k in range(13)])
    sizes = np.bincount([fold[0] for fold in groups.folds])
    assert sizes.size == groups.count == FOLDS
    assert np.ptp(sizes) <= 1


def test_whole_levels_but_the_largest_are_held_out_where_amplitudes_repeat():
    levels = np.repeat([1.0, 0.5, 0.25, 0.75], 500)
    u = levels * np.sin(2 * np.pi * 20 * np.arange(2000) / 2000)
    groups = held_out([Record(u, u)])
    assert groups.scheme is Scheme.LEVELS
    inside = np.abs(np.arange(2000) % 500 - 250) < 150  # away from the steps between levels
    for level in (0.5, 0.25, 0.75):
        assert len(set(groups.folds[0][inside & (levels == level)])) == 1
    assert set(groups.folds[0][inside & (levels == 1.0)]) == {-1}


def test_cycles_are_held_out_in_fifths_but_for_what_leaves_the_range_of_the_others():
    u = sine().u * np.linspace(0.5, 1.5, 2000)
    groups = held_out([Record(u, u)])
    assert groups.scheme is Scheme.CYCLES
    assert groups.folds[0][-20:].max() == -1  # the largest stroke
    for k in range(groups.count):
        held, rest = u[groups.folds[0] == k], u[groups.folds[0] != k]
        assert held.min() >= rest.min() - 0.03
        assert held.max() <= rest.max() + 0.03


@pytest.mark.parametrize("spacing", [1, 7])
def test_runs_of_samples_are_scattered_over_a_single_loop(spacing):
    loop = sine(cycles=1)
    weight = np.where(np.arange(2000) < 500, 0.0, 1.0)
    groups = held_out([loop.replace(weight=weight)], spacing)
    fold = groups.folds[0]
    assert groups.scheme is Scheme.SCATTERED
    assert (fold[:500] == -1).all()  # samples that do not count
    runs = np.diff(np.flatnonzero(np.diff(fold[500:])))
    assert set(runs) == {spacing}
    assert np.bincount(fold[500:]).min() > 250


def test_runs_are_shorter_in_short_records_so_that_each_group_covers_the_loop():
    fold = held_out([Record(u := np.sin(np.linspace(0, 6.2, 100)), u)], 40).folds[0]
    assert np.diff(np.flatnonzero(np.diff(fold))).max() == 2


def windowed(record, stop):
    return record.replace(weight=(np.arange(len(record)) < stop).astype(float))


@pytest.mark.parametrize("kind", ["levels", "cycles", "records"])
def test_samples_that_count_are_held_out_whatever_a_window_leaves(kind):
    """Without one, the error on held-out samples would be that of nothing."""
    u = np.repeat([1.0, 0.6, 0.3, 0.3], 500) * np.cos(2 * np.pi * 20 * np.arange(2000) / 2000)
    records = {
        "levels": [windowed(Record(u, u), 450)],  # of the largest amplitude, which is in no group
        "cycles": [windowed(sine(), 120)],
        "records": [sine(name="a"), windowed(sine(0.5, name="b"), 0), windowed(sine(0.5, name="c"), 0)],
    }[kind]
    groups = held_out(records)
    groups_of = [fold[record.used] for fold, record in zip(groups.folds, records, strict=True)]
    assert len(np.unique(np.concatenate(groups_of))) >= 2
    assert all((fold[~record.used] == -1).all() for fold, record in zip(groups.folds, records, strict=True))


def test_the_future_is_the_fifths_in_order():
    fold = future([sine()]).folds[0]
    assert (np.diff(fold) >= 0).all()
    assert fold.max() == 4


def test_the_correlation_length_is_that_of_a_first_order_filter():
    rng, errors = np.random.default_rng(0), np.zeros(20000)
    for k in range(1, errors.size):
        errors[k] = np.exp(-1 / 12) * errors[k - 1] + rng.normal()
    assert correlation_length(errors) == pytest.approx(12, abs=2)
    assert correlation_length(rng.normal(size=5000)) == 1


def around(amplitude, middle=0.0, cycles=1):
    u = middle + amplitude * np.cos(2 * np.pi * np.arange(200 * cycles + 1) / 200)
    return Record(u, u, name=f"{amplitude} about {middle}")


@pytest.mark.parametrize("middle", [0.0, 0.3])
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_smaller_of_two_loops_is_predicted_from_the_larger(order, middle):
    loops = around(1.0), around(0.4, middle)
    groups = inner_loops([loops[k] for k in order])
    assert groups.count == 1
    assert [set(groups.folds[k]) for k in order] == [{-1}, {0}]
    assert held_out(loops).scheme is Scheme.SCATTERED


def test_a_smaller_loop_within_a_record_is_held_out_without_what_leads_to_it():
    u = np.concatenate([around(1.0).u, 0.7 * np.cos(np.linspace(0, 4 * np.pi, 400)) + 0.3])
    fold = inner_loops([Record(u, u).replace(weight=np.where(np.arange(u.size) < 20, 0.0, 1.0))]).folds[0]
    assert set(fold[:190]) == {-1}
    assert set(fold[320:]) == {0}


@pytest.mark.parametrize(
    "loops",
    [
        (around(1.0),),
        (around(1.0, cycles=3),),
        (around(1.0), around(0.98)),
        (around(1.0), around(0.4, 2.0)),
    ],
    ids=["one loop", "equal cycles", "two of one size", "one outside the other"],
)
def test_loops_of_one_size_and_loops_outside_each_other_have_no_inner_ones(loops):
    assert inner_loops(loops) is None


def test_what_was_put_before_a_record_is_in_no_group():
    groups = held_out([around(1.0)])
    fold = groups.after([groups.folds[0].size + 7]).folds[0]
    assert (fold[:7] == -1).all()
    assert np.array_equal(fold[7:], groups.folds[0])
