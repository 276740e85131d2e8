"""The comparison of motions says so where one is wrong, lost, or takes too long."""

import pytest

from oracles.accelerations import table

GOOD = {
    "plan": "a",
    "duration": 10.2,
    "duration_before": 10.0,
    "seconds": 0.5,
    "seconds_before": 0.5,
    "reason": "",
    "problems": [],
    "jump": 1e-9,
    "jump_before": 2.0,
}


def test_good_motions_are_well():
    text, well = table([GOOD, GOOD | {"duration_before": None}])
    assert well and "plans 2, motions 2, of them verified 2" in text and "median 1.0200" in text


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"problems": ["the arm jumps"]}, "a: the arm jumps"),
        ({"duration": 10.4}, "takes 1.0400 as long"),
        ({"duration": 0, "reason": "a wall"}, "no motion any more: a wall"),
    ],
)
def test_faults_are_named(fault, said):
    text, well = table([GOOD, GOOD | fault])
    assert not well and said in text
