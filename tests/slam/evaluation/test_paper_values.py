"""The quoted figures of the IMAV 2011 paper agree with a second typing of its tables and with each other."""

import pytest

from slam.evaluation import paper_values as paper
from slam.evaluation.landmarks import PAPER_DISTANCES_M

SQUARE = ("A-B", "B-C", "C-D", "D-A", "B-D")
EIGHT = ("A-B", "B-C", "C-D", "D-E", "E-F", "F-G", "G-H", "H-A", "B-G")
PRINTED = {
    "table 1, AR.Drone, mean error (m)": (SQUARE, "0.385 0.146 0.608 0.156 0.445"),
    "table 1, AR.Drone, error (%)": (SQUARE, "29.6 11.2 46.8 12.0 24.1"),
    "table 1, USARSim, mean error (m)": (SQUARE, "0.019 0.047 0.026 0.075 0.028"),
    "table 1, USARSim, error (%)": (SQUARE, "1.46 3.62 2.00 5.77 2.15"),
    "table 2, mean error (m)": (SQUARE, "0.031 0.181 0.215 0.254 0.190"),
    "table 2, error (%)": (SQUARE, "2.21 12.93 15.36 18.14 10.27"),
    "table 3, mean error (m)": (EIGHT, "0.220 0.87 0.579 0.220 0.523 0.011 0.244 0.788 0.14"),
    "table 3, error (%)": (EIGHT, "10.48 19.33 27.57 4.89 24.90 0.24 11.62 17.51 2.20"),
    "table 4, mean error (m)": (EIGHT, "0.029 0.689 0.049 0.565 0.013 0.596 0.080 0.720 0.243"),
    "table 4, error (%)": (EIGHT, "1.38 15.31 2.33 12.56 0.62 13.24 3.81 16.0 3.83"),
    "table 5, v (m/s)": (paper.STICKS, "0.4044 0.6284 1.4427 1.7587 2.2094"),
    "table 5, sigma of v (m/s)": (paper.STICKS, "0.096 0.226 0.070 0.126 0.165"),
    "table 5, theta (deg)": (paper.STICKS, "1.4654 2.9025 4.1227 5.7457 7.4496"),
    "table 5, sigma of theta (deg)": (paper.STICKS, "0.455 0.593 0.482 0.552 0.921"),
}
"""Table and row -> columns and the row as the paper prints it."""
QUOTED = {
    "table 1, AR.Drone, mean error (m)": paper.SQUARE_DRONE_M,
    "table 1, AR.Drone, error (%)": paper.SQUARE_DRONE_PERCENT,
    "table 1, USARSim, mean error (m)": paper.SQUARE_M,
    "table 1, USARSim, error (%)": paper.SQUARE_PERCENT,
    "table 2, mean error (m)": paper.WHITE_BALANCE_M,
    "table 2, error (%)": paper.WHITE_BALANCE_PERCENT,
    "table 3, error (%)": paper.STITCHED_PERCENT,
    "table 4, error (%)": paper.EKF_PERCENT,
    "table 5, v (m/s)": paper.SPEED_M_S,
    "table 5, sigma of v (m/s)": paper.SPEED_STD_M_S,
    "table 5, theta (deg)": paper.PITCH_DEG,
    "table 5, sigma of theta (deg)": paper.PITCH_STD_DEG,
}


def printed(row):
    columns, text = PRINTED[row]
    return dict(zip(columns, map(float, text.split()), strict=True))


def rounding(text):
    """Half a unit of the last printed digit."""
    return 0.5 * 10.0 ** -len(text.partition(".")[2])


@pytest.mark.parametrize("row", QUOTED)
def test_a_quoted_row_is_the_printed_row(row):
    assert QUOTED[row] == printed(row)


def test_the_sticks_are_those_of_table_5():
    assert paper.STICKS == (0.05, 0.10, 0.15, 0.20, 0.25)


@pytest.mark.parametrize("table", ["table 3", "table 4"])
def test_percentages_of_the_figure_eight_are_errors_over_distances(table):
    """Within the rounding of both printed figures; F-G of table 3 has two digits and B-G three."""
    columns, errors = PRINTED[f"{table}, mean error (m)"]
    percentages = PRINTED[f"{table}, error (%)"][1].split()
    quoted = QUOTED[f"{table}, error (%)"]
    for pair, error, percent in zip(columns, errors.split(), percentages, strict=True):
        distance = PAPER_DISTANCES_M[pair]
        tolerance = 100 * rounding(error) / distance + 1.01 * rounding(percent)
        assert quoted[pair] == pytest.approx(100 * float(error) / distance, abs=tolerance), pair


@pytest.mark.parametrize(
    ("errors_m", "percentages", "side_m", "diagonal_m", "tolerance"),
    [
        (paper.SQUARE_DRONE_M, paper.SQUARE_DRONE_PERCENT, 1.3, 1.84, 0.10),
        (paper.SQUARE_M, paper.SQUARE_PERCENT, 1.3, 1.3, 0.05),
        (paper.WHITE_BALANCE_M, paper.WHITE_BALANCE_PERCENT, 1.4, 1.84, 0.06),
    ],
)
def test_percentages_of_the_square_are_errors_over_distances(
    errors_m, percentages, side_m, diagonal_m, tolerance
):
    """The paper divided by 1.3 m for a diagonal of table 1 and by 1.4 m for the sides of table 2."""
    for pair, error in errors_m.items():
        distance = diagonal_m if pair == "B-D" else side_m
        assert percentages[pair] == pytest.approx(100 * error / distance, abs=tolerance), pair


def test_largest_errors_are_those_of_the_running_text():
    """Section 4.1: 7.5 cm, 25.4 cm and 60.8 cm on the square, 27.57 % and 16.0 % on the figure eight."""
    assert max(paper.SQUARE_M.values()) == 0.075
    assert max(paper.WHITE_BALANCE_M.values()) == 0.254
    assert max(paper.SQUARE_DRONE_M.values()) == 0.608
    assert max(paper.STITCHED_PERCENT.values()) == 27.57
    assert max(paper.EKF_PERCENT.values()) == 16.0


def test_figures_of_the_running_text_are_the_printed_ones():
    assert (paper.SIDE_M, paper.DIAGONAL_M) == (1.3, 1.84), "section 4.1"
    assert pytest.approx(2**0.5 * paper.SIDE_M, abs=0.005) == paper.DIAGONAL_M
    assert paper.FEATURE_DISTANCE_PX == {"without": 22.1, "with": 32.9, "drone": 32.7}, "section 4.1"
    assert (paper.FIELD_OF_VIEW_DEG, paper.FLOOR_AT_1M_M) == (64, 1.24), "section 3.1"
    assert paper.OVERLAP_SPEED_M_S == {15.0: 9.3, 6.67: 4.13}, "section 3.1"
    assert (paper.TOP_SPEED_M_S, paper.TOP_SPEED_PERCENT) == (5, 83), "section 3.1"
    assert (paper.HOVER_SPEED_M_S, paper.HOVER_SPEED_VARIANCE) == (0.0422, 0.0012), "section 4.2.1"
    assert (paper.HOVER_DRIFT_M, paper.HOVER_DRIFT_VARIANCE) == (0.0707, 0.0012), "section 4.2.1"
    assert (paper.SPEED_A_DEGREE, paper.MAX_TILT_DEG, paper.P_THETA) == (0.2967, 30, 0.057), "section 4.2.2"
