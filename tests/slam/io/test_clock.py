"""Stamps that a recorder garbled: out of order, twice, or by a clock that was set in flight."""

from pathlib import Path

import numpy as np
import pytest

from slam.io.clock import sort_by_time
from slam.io.csv_table import CsvTable

START = 1_600_000_000 * 10**9
HOUR = 3600 * 10**9


def table(stamps_ns, values=None):
    stamps_ns = np.asarray(stamps_ns, dtype=np.int64)
    n = len(stamps_ns)
    values = np.arange(n, dtype=float) if values is None else values
    return CsvTable(Path("data.csv"), stamps_ns, np.asarray(values, float)[:, None], (), np.arange(2, n + 2))


def regular(rate_hz, seconds=60, seed=0, jitter=0.2):
    n = int(rate_hz * seconds)
    steps = np.arange(n) + np.random.default_rng(seed).uniform(-jitter, jitter, n)
    return START + (steps * 1e9 / rate_hz).astype(np.int64)


def one(stamps_ns, **options):
    tables, remarks = sort_by_time({"s": table(stamps_ns)}, **options)
    return tables["s"], list(map(str, remarks))


def test_valid_stamps_are_unchanged():
    stamps = regular(100)
    out, remarks = one(stamps)
    np.testing.assert_array_equal(out.stamps_ns, stamps)
    assert remarks == []


@pytest.mark.parametrize("seed", range(5))
def test_shuffled_rows_are_sorted(seed):
    stamps = regular(50)
    order = np.random.default_rng(seed).permutation(len(stamps))
    out, remarks = one(stamps[order])
    np.testing.assert_array_equal(out.stamps_ns, stamps)
    np.testing.assert_array_equal(order[out.values[:, 0].astype(int)], np.arange(len(stamps)))
    assert len(remarks) == 1
    assert "sorted" in remarks[0]


def test_a_few_swapped_rows_and_blocks_are_sorted_not_shifted():
    stamps = regular(50)
    for order in (
        np.r_[0:10, 500, 11:500, 10, 501:3000],
        np.r_[0:100, 200:300, 100:200, 300:3000],
        np.r_[1500:3000, 0:1500],
        np.arange(3000)[::-1],
    ):
        out, remarks = one(stamps[order])
        np.testing.assert_array_equal(out.stamps_ns, stamps)
        assert len(remarks) == 1, remarks
        assert "sorted" in remarks[0]


def test_repeated_rows_and_equal_stamps_are_counted():
    stamps = regular(50)
    values = np.arange(len(stamps), dtype=float)
    again = np.r_[0 : len(stamps), 300:400]
    tables, remarks = sort_by_time({"s": table(stamps[again], values[again])})
    remarks = list(map(str, remarks))
    np.testing.assert_array_equal(tables["s"].stamps_ns, stamps)
    assert remarks == ["s: 100 repeated rows dropped, one of each is kept"]
    stamps[10] = stamps[9]
    out, remarks = one(stamps)
    assert len(out.stamps_ns) == len(stamps) - 1
    assert remarks == ["s: 1 row with the stamp of another row dropped; check the recorder if they are many"]
    assert 10 not in out.values  # the first is kept


@pytest.mark.parametrize("jump_ns", [HOUR, -HOUR, -2 * 10**9, -20 * 10**9, 50 * HOUR])
@pytest.mark.parametrize("at", [50, 1500, 2900])
def test_a_permanent_jump_is_removed(jump_ns, at):
    stamps = regular(50)
    jumped = stamps.copy()
    jumped[at:] += jump_ns
    out, remarks = one(jumped)
    assert len(out.stamps_ns) == len(stamps)
    np.testing.assert_array_equal(out.values[:, 0], np.arange(len(stamps)))
    assert np.abs(out.stamps_ns - stamps).max() <= 2 * 10**9 / 50
    assert len(remarks) == 1
    assert f"line {at + 2}" in remarks[0]


@pytest.mark.parametrize("jump_ns", [HOUR, -HOUR, -7 * 10**9])
def test_streams_keep_their_alignment_over_a_jump(jump_ns):
    rates = {"imu0": 200, "cam0": 15, "battery0": 5, "gps0": 1}
    true = {name: regular(rate, seed=k) for k, (name, rate) in enumerate(rates.items())}
    moment = START + 33 * 10**9
    jumped = {n: table(np.where(t < moment, t, t + jump_ns)) for n, t in true.items()}
    tables, remarks = sort_by_time(jumped)
    remarks = list(map(str, remarks))
    assert len(remarks) == len(rates)
    off = {name: tables[name].stamps_ns - true[name] for name in rates}
    for name in rates:
        assert (off[name] == off["imu0"][-1])[true[name] >= moment].all(), name
        assert (off[name] == 0)[true[name] < moment].all()
    assert abs(off["imu0"][-1]) <= 2 * 10**9 / 200


@pytest.mark.parametrize("at", [0, 1, 700, 2999])
@pytest.mark.parametrize("outlier", [HOUR, -HOUR, 1 << 59, -START])
def test_a_single_outlying_stamp_is_dropped(at, outlier):
    stamps = regular(50)
    bad = stamps.copy()
    bad[at] += outlier
    out, remarks = one(bad)
    np.testing.assert_array_equal(out.stamps_ns, np.delete(stamps, at))
    assert len(remarks) == 1


def test_a_temporary_jump_of_the_clock_is_repaired():
    stamps = regular(50)
    bad = stamps.copy()
    bad[1000:1400] += HOUR
    out, remarks = one(bad)
    assert len(out.stamps_ns) == len(stamps)
    assert np.abs(out.stamps_ns - stamps).max() < 10**8
    assert len(remarks) == 2


def test_a_pause_is_not_a_jump():
    stamps = regular(50)
    stamps[1000:] += 10 * 10**9
    out, remarks = one(stamps)
    np.testing.assert_array_equal(out.stamps_ns, stamps)
    assert remarks == []


def both(stamps_ns):
    """Return all streams sorted together, and the remarks."""
    tables, remarks = sort_by_time({name: table(s) for name, s in stamps_ns.items()})
    remarks = list(map(str, remarks))
    return {name: t.stamps_ns for name, t in tables.items()}, remarks


@pytest.mark.parametrize("fixes_within", [0, 1, 2, 300])
def test_a_stream_that_pauses_alone_keeps_its_stamps(fixes_within):
    whole = {"imu0": regular(20, 1900, 1), "gps0": regular(1, 1900, 2)}
    since_s = (whole["gps0"] - START) / 1e9
    kept = (since_s < 150) | (since_s > 1750) | ((since_s > 850) & (since_s < 850 + fixes_within))
    stamps = {"imu0": whole["imu0"], "gps0": whole["gps0"][kept]}
    out, remarks = both(stamps)
    np.testing.assert_array_equal(out["gps0"], stamps["gps0"])
    np.testing.assert_array_equal(out["imu0"], stamps["imu0"])
    assert remarks == []


def test_a_stream_that_begins_after_the_clock_was_set_stays_aligned():
    true = {"imu0": regular(200, seed=1), "gps0": regular(1, seed=2)}
    moment = START + 33 * 10**9
    true["gps0"] = true["gps0"][true["gps0"] > moment]
    out, remarks = both({n: np.where(t < moment, t, t + HOUR) for n, t in true.items()})
    moved = (out["imu0"] - true["imu0"])[-1]
    np.testing.assert_array_equal(out["gps0"] - true["gps0"], moved)
    assert abs(moved) <= 2 * 10**9 / 200
    assert len(remarks) == 2


@pytest.mark.parametrize("late", ["imu0", "gps0", "cam0"])
def test_streams_that_come_back_one_after_the_other_show_a_pause(late):
    """A clock that is set interrupts no stream. One that comes back 20 s late was switched off."""
    true = {"imu0": regular(200, seed=1), "cam0": regular(15, seed=2), "gps0": regular(1, seed=3)}
    moment = START + 33 * 10**9
    paused = {n: np.where(t < moment, t, t + HOUR) for n, t in true.items()}
    paused[late] = np.r_[
        true[late][true[late] < moment], paused[late][paused[late] > moment + HOUR + 20 * 10**9]
    ]
    out, remarks = both(paused)
    for name, stamps in paused.items():
        np.testing.assert_array_equal(out[name], stamps)
    assert len(remarks) == 1
    assert "no stream has rows for 3600 s" in remarks[0]
    assert late in remarks[0]


def test_sticks_that_rest_while_the_clock_is_set_are_not_interrupted():
    """They have rows at changes alone."""
    true = {"imu0": regular(200, seed=1), "command0": regular(5, seed=2)}
    moment = START + 33 * 10**9
    true["command0"] = true["command0"][np.abs(true["command0"] - moment) > 10**10]
    out, _ = both({n: np.where(t < moment, t, t + HOUR) for n, t in true.items()})
    for name, stamps in true.items():
        assert np.abs(out[name] - stamps).max() <= 2 * 10**9 / 200, name


def test_a_clock_that_jumps_by_years_was_set_even_where_a_stream_pauses():
    true = {"imu0": regular(200, seed=1), "gps0": regular(1, seed=3)}
    moment, years = START + 33 * 10**9, 20 * 365 * 24 * HOUR
    true["gps0"] = true["gps0"][np.abs(true["gps0"] - moment) > 10**10]
    out, _ = both({n: np.where(t < moment, t - years, t) for n, t in true.items()})
    for name, stamps in true.items():
        assert np.abs(out[name] - (stamps - years)).max() <= 2 * 10**9 / 200


def test_a_stream_whose_clock_alone_is_set_is_moved_back():
    true = {"imu0": regular(200, seed=1), "battery0": regular(5, seed=2)}
    stamps = {**true, "battery0": np.where(true["battery0"] < START + 33 * 10**9, 0, HOUR) + true["battery0"]}
    out, remarks = both(stamps)
    np.testing.assert_array_equal(out["imu0"], true["imu0"])
    assert np.abs(out["battery0"] - true["battery0"]).max() < 2 * 10**9 / 5
    assert len(remarks) == 1


@pytest.mark.parametrize("ahead", [660 * 10**9, -660 * 10**9])
def test_a_jump_that_is_undone_is_repaired_although_others_go_on(ahead):
    true = {"imu0": regular(20, 2400, 1), "gps0": regular(1, 2400, 2)}
    since_s = (true["gps0"] - START) / 1e9
    off = (since_s > 900) & (since_s < 1000)
    out, remarks = both({**true, "gps0": true["gps0"] + np.where(off, ahead, 0)})
    assert np.abs(out["gps0"] - true["gps0"]).max() < 4 * 10**9
    np.testing.assert_array_equal(out["imu0"], true["imu0"])
    assert len(remarks) == 2


@pytest.mark.parametrize("ahead", [700 * 10**9, -700 * 10**9])
def test_an_outlying_stamp_within_a_long_flight_is_dropped(ahead):
    true = {"imu0": regular(20, 2400, 1), "gps0": regular(1, 2400, 2)}
    bad = true["gps0"].copy()
    bad[900] += ahead
    out, _ = both({**true, "gps0": bad})
    np.testing.assert_array_equal(out["gps0"], np.delete(true["gps0"], 900))


def test_trusted_clocks_are_only_sorted():
    stamps = regular(1)
    stamps[20:] += 5 * HOUR
    stamps[40:] += 50 * HOUR
    out, remarks = one(stamps, trust_clock=True)
    np.testing.assert_array_equal(out.stamps_ns, stamps)
    assert remarks == []


def test_tiny_tables():
    for stamps in ([], [5], [5, 5], [9, 5], [0, HOUR], [HOUR, 0, 2 * HOUR]):
        out, _ = one(stamps)
        assert (np.diff(out.stamps_ns) > 0).all()
