import itertools
import logging

import numpy as np
import pytest

from regrasp_opt.benchmarks.harness.oracle import BLOCK, Oracle, Resolution, build_oracle, grid_poses
from regrasp_opt.benchmarks.harness.planners import fewest_poses
from regrasp_opt.conventions import planar_transform
from regrasp_opt.errors import OptionError


def oracle_of(feasible) -> Oracle:
    feasible = np.asarray(feasible, dtype=bool)
    return Oracle(np.zeros(len(feasible), dtype=np.int64), np.zeros((len(feasible), 3)), feasible, 0.0)


def mask(size, *ids):
    out = np.zeros(size, dtype=bool)
    out[list(ids)] = True
    return out


def least(oracle, start, goal):
    """Return the fewest regrasps between two poses, or None."""
    found = oracle.minimum_table(np.stack([start, goal]))[0, 1]
    return int(found) if np.isfinite(found) else None


def brute_force(feasible, start, goal):
    """Breadth-first search over poses: the number of intermediate poses, or None."""
    frontier, seen, steps = [start], [False] * len(feasible), 0
    while frontier:
        if any((pose & goal).any() for pose in frontier):
            return steps
        reached = []
        for number, pose in enumerate(feasible):
            if not seen[number] and any((pose & other).any() for other in frontier):
                seen[number] = True
                reached.append(pose)
        frontier, steps = reached, steps + 1
    return None


def test_a_chain_of_grasps_needs_one_regrasp_for_each_link():
    chain = oracle_of([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]])
    assert [least(chain, mask(4, 0), mask(4, g)) for g in range(4)] == [0, 1, 2, 3]


def test_grasps_that_no_pose_joins_cannot_be_exchanged():
    assert least(oracle_of([[1, 0], [0, 1]]), mask(2, 0), mask(2, 1)) is None


def test_a_grasp_that_is_feasible_nowhere_on_the_grid_still_moves_the_object_directly():
    assert least(oracle_of([[1, 0]]), mask(2, 1), mask(2, 1)) == 0


@pytest.mark.parametrize("seed", range(8))
def test_minimum_agrees_with_search_over_poses(seed):
    rng = np.random.default_rng(seed)
    feasible = rng.random((25, 12)) < 0.09
    ends = rng.random((8, 12)) < 0.15
    oracle = oracle_of(feasible)
    table = oracle.minimum_table(ends)
    found = set()
    for i, start in enumerate(ends):
        for j, goal in enumerate(ends):
            expected = brute_force(feasible, start, goal) if start.any() and goal.any() else None
            found.add(expected)
            assert table[i, j] == (np.inf if expected is None else expected)
            path = fewest_poses(feasible, start, goal)
            assert (None if path is None else len(path)) == expected
            if path is not None:
                chain = [start, *feasible[path], goal]
                assert all((a & b).any() for a, b in itertools.pairwise(chain))
    assert len(found) > 2


def test_one_step_poses_share_a_grasp_with_both_ends():
    oracle = oracle_of([[1, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert oracle.one_step(mask(3, 0), mask(3, 1)).tolist() == [True, False, False, False]


def test_fewer_grasps_never_make_a_plan_shorter():
    rng = np.random.default_rng(3)
    whole = oracle_of(rng.random((40, 20)) < 0.1)
    ids = np.arange(12)
    ends = rng.random((6, 20)) < 0.2
    part = whole.with_grasps(ids).minimum_table(ends[:, ids])
    assert (part >= whole.minimum_table(ends)).all()


def test_the_paper_grid_holds_both_ends_of_the_workspace():
    numbers, xi = grid_poses(2, np.array([[-0.45, 0.1], [0.45, 0.6]]), Resolution(0.01, 6))
    assert len(xi) == 2 * 91 * 51 * 6 and set(numbers) == {0, 1}
    np.testing.assert_allclose(xi.min(axis=0), [-0.45, 0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(xi.max(axis=0), [0.45, 0.6, 5 * np.pi / 3], atol=1e-12)


def test_a_grid_without_spacing_is_refused():
    with pytest.raises(OptionError, match="spacing"):
        Resolution(0.0, 6)


def test_the_grid_is_checked_exactly_kept_and_mended(bottle_problem, caplog, tmp_path, monkeypatch):
    monkeypatch.setenv("REGRASP_OPT_HOME", str(tmp_path))
    resolution = Resolution(0.15, 2)
    first = build_oracle(bottle_problem, resolution, jobs=1)
    for row in (0, 57, len(first.xi) - 1):
        T = planar_transform(first.xi[row]) @ bottle_problem.placement_poses[first.placements[row]]
        np.testing.assert_array_equal(first.feasible[row], bottle_problem.feasible_grasps(T))
    assert first.feasible.any()

    blocks = sorted((tmp_path / "oracle").rglob("*.npz"))
    assert len(blocks) == -(-len(first.xi) // BLOCK)
    again = build_oracle(bottle_problem, resolution, jobs=1)
    assert again.seconds == first.seconds

    blocks[0].write_bytes(blocks[0].read_bytes()[:-20])
    with caplog.at_level(logging.WARNING):
        mended = build_oracle(bottle_problem, resolution, jobs=1)
    assert "corrupt" in caplog.text
    np.testing.assert_array_equal(mended.feasible, first.feasible)
