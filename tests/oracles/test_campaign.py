"""The campaign in small: a plan on an arm with posts in its URDF, its motion, and every kind of damage."""

import pytest

from oracles.campaign import DAMAGE, tables, trial


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    here = tmp_path_factory.mktemp("campaign")
    for name in ("plans", "motions", "damaged"):
        (here / name).mkdir()
    return here


@pytest.fixture(scope="module")
def plan(folder):
    return trial((folder, 0, "plan", ("posts", "bottle", 0)))


def test_a_plan_and_its_motion_are_verified(folder, plan):
    motion = trial((folder, 0, "motion", ("posts", "bottle", 0)))
    assert (plan["status"], plan["false"]) == ("solved", []), plan
    assert (motion["status"], motion["false"]) == ("solved", []), motion
    text = tables([plan, motion])
    assert text.count("| posts | bottle | 1 | 1 | 0 |") == 2


def test_damaged_plans_are_caught_by_check_and_by_the_verifier(folder, plan):
    for number, kind in enumerate(DAMAGE):
        row = trial((folder, 0, "damage", (kind, number)))
        assert row["caught"] and row["verifier"], row
        assert f"| {kind} | 1 | 1 | 1 |" in tables([row])


def test_a_trial_that_fails_is_a_finding(folder):
    row = trial((folder, 0, "plan", ("no such cell", "bottle", 0)))
    assert row["status"].startswith("error") and "error" in tables([row])
