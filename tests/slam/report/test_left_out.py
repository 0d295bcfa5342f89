"""Words for data that a map was made without."""

from slam.report.left_out import reason_in_words


def test_the_words_of_a_match_keep_all_figures_of_its_reason():
    out_of_reach = reason_in_words("out of reach: 2.85 m apart by the poses so far, at most 1.91 m allowed")
    assert out_of_reach.endswith("(2.85 m apart by the poses so far, at most 1.91 m allowed)")
    before_metres = reason_in_words("disagrees by 8.6 sigma (limit 4.7): 0.014 heights, 1.2 deg")
    assert before_metres.endswith("0.014 of the camera's height, 1.2°)"), (
        "no unit that the page does not define"
    )
    disagrees = reason_in_words("disagrees by 8.6 sigma (limit 4.7): 0.14 m, 1.2 deg")
    assert disagrees.endswith("(8.6 standard deviations (limit 4.7): 0.14 m, 1.2°)")
