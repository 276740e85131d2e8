"""Verifying a sequence: as few checks as possible, the promising grasps and the ends first, and no grasp forgotten."""

from types import SimpleNamespace

import numpy as np
import pytest

from regrasp_opt.planning.verification import PoseFeasibility, enumerate_transition, share_a_grasp, verify_sequence

GRASPS = 40


class Checker:
    """Answers from a table of feasible grasps by pose, and notes what it was asked."""

    def __init__(self, **feasible):
        self.table = {name: np.isin(np.arange(GRASPS), ids) for name, ids in feasible.items()}
        self.grasps = range(GRASPS)
        self.asked = []

    def feasible(self, T, ids):
        self.asked += [(T, int(g)) for g in ids]
        return self.table[T][ids]

    def object_collides(self, T):
        self.asked.append((T, "object"))
        return T == "blocked"

    def poses(self):
        return {name: PoseFeasibility(self, name) for name in self.table}


def test_nothing_is_asked_twice():
    checker = Checker(a=[1, 5])
    pose = checker.poses()["a"]
    assert pose.possible().all()
    assert pose.feasible(np.array([5, 2])).tolist() == [True, False]
    assert pose.feasible(np.array([2, 5, 1])).tolist() == [False, True, True]
    assert checker.asked == [("a", 5), ("a", 2), ("a", 1)]
    assert np.flatnonzero(~pose.possible()).tolist() == [2]
    assert np.flatnonzero(pose.all()).tolist() == [1, 5]
    assert len(checker.asked) == GRASPS
    assert np.flatnonzero(pose.possible()).tolist() == [1, 5]
    assert not pose.object_collides and not pose.object_collides
    assert checker.asked[GRASPS:] == [("a", "object")]
    assert PoseFeasibility(checker, "blocked").object_collides


def test_promising_grasps_are_tried_first_and_one_suffices():
    checker = Checker(a=[7, 30], b=[7, 30])
    a, b = checker.poses().values()
    promise = np.arange(GRASPS, 0.0, -1.0)  # the last grasp first
    assert share_a_grasp(a, b, promise)
    assert [g for T, g in checker.asked if T == "a"] == [*range(39, 31, -1), *range(31, 23, -1)]
    assert [g for T, g in checker.asked if T == "b"] == [30]


def test_a_shared_grasp_is_found_wherever_it_stands():
    for shared in range(GRASPS):
        checker = Checker(a=[shared, 3], b=[shared, 4])
        a, b = checker.poses().values()
        assert share_a_grasp(a, b, np.random.default_rng(shared).random(GRASPS))
    checker = Checker(a=[3], b=[4])
    a, b = checker.poses().values()
    assert not share_a_grasp(a, b, np.zeros(GRASPS))
    assert checker.asked == [*[("a", g) for g in range(8)], ("b", 3), *[("a", g) for g in range(8, GRASPS)]]


def test_grasps_known_to_fail_are_left_out():
    checker = Checker(a=[3], b=[4])
    a, b = checker.poses().values()
    a.all()
    checker.asked.clear()
    assert not share_a_grasp(a, b, np.zeros(GRASPS))
    assert checker.asked == [("b", 3)]


def test_a_sequence_is_verified_from_its_ends_inwards():
    checker = Checker(s=[0], a=[0, 1], b=[1, 2], c=[2, 3], g=[3])
    poses = list(checker.poses().values())
    energies = np.zeros((5, GRASPS))
    assert verify_sequence(poses, energies)
    assert [T for T, _ in checker.asked][:9] == ["s"] * 8 + ["a"]
    order = list(dict.fromkeys(T for T, _ in checker.asked))
    assert order == ["s", "a", "c", "g", "b"]
    for i in range(4):
        table = dict(checker.table)
        name = "sabcg"[i + 1]
        broken = Checker(**{key: [] if key == name else np.flatnonzero(value) for key, value in table.items()})
        assert not verify_sequence(list(broken.poses().values()), energies)


def test_the_sum_of_both_energies_says_where_to_look():
    checker = Checker(a=[20], b=[20])
    energies = np.ones((2, GRASPS))
    energies[0, :8] = 0.5
    energies[1, 20] = 0.25  # 1.25 in all, 1.5 for the first eight
    assert verify_sequence(list(checker.poses().values()), energies)
    assert checker.asked[0] == ("a", 20)


class Arm(Checker):
    """A checker whose arm of one joint has the branches of a table, turned by whole turns where that is allowed."""

    def __init__(self, branches, blocked=(), **feasible):
        super().__init__(**feasible)
        self.rows, self.blocked = branches, blocked
        turn = 2 * np.pi
        robot = SimpleNamespace(dof=1, nearest_equivalent=lambda q, to: np.where(q - to > np.pi, q - turn, q + 0 * to))
        self.workcell = SimpleNamespace(arm=SimpleNamespace(robot=robot, name="left"))

    def poses(self):
        return {name: PoseFeasibility(self, np.full((4, 4), float(ord(name)))) for name in self.table}

    def feasible(self, T, ids):
        return self.table[chr(int(T[0, 0]))][ids]

    def branches(self, T, ids):
        rows = [(q, k) for k, g in enumerate(ids) for q in self.rows[chr(int(T[k, 0, 0])), int(g)]]
        q, pair = zip(*rows, strict=True)
        return SimpleNamespace(q=np.array(q)[:, None], pair=np.array(pair))

    def is_free(self, T, grasp, q):
        return (chr(int(T[0, 0])), grasp, float(q[0])) not in self.blocked

    def clearance(self, T, grasp, q):
        return {"a": 0.02, "b": 0.01}[chr(int(T[0, 0]))] + 0.1 * grasp


def test_a_transition_has_all_shared_grasps_with_the_shortest_free_moves():
    branches = {("a", 2): [0.0, 3.0], ("b", 2): [5.9, 2.4], ("a", 3): [1.0], ("b", 3): [1.5, 0.9]}
    arm = Arm(branches, a=[1, 2, 3], b=[2, 3, 9])
    found = enumerate_transition(arm, *arm.poses().values())
    assert found.grasp_ids.tolist() == [2, 3]
    np.testing.assert_allclose(found.q_pick, [[0.0], [1.0]])
    np.testing.assert_allclose(found.q_place, [[5.9 - 2 * np.pi], [0.9]])
    np.testing.assert_allclose(found.clearance, [0.21, 0.31])
    stopped = Arm(branches, {("a", 2, 0.0), ("b", 3, 0.9)}, a=[1, 2, 3], b=[2, 3, 9])
    found = enumerate_transition(stopped, *stopped.poses().values())
    np.testing.assert_allclose(found.q_pick, [[3.0], [1.0]])
    np.testing.assert_allclose(found.q_place, [[2.4], [1.5]])


def test_a_transition_without_a_shared_grasp_is_empty(bottle_problem):
    far = [PoseFeasibility(bottle_problem.checker, bottle_problem.pose(0, x, 0.35)) for x in (0.2, -0.2)]
    for pose in far:
        pose._known[:] = True
    none = enumerate_transition(bottle_problem.checker, *far)
    assert none.grasp_ids.shape == (0,) and none.clearance.shape == (0,)
    assert none.q_pick.shape == none.q_place.shape == (0, 6)


def test_a_defect_of_the_check_is_not_hidden():
    arm = Arm({("a", 2): [0.0], ("b", 2): [1.0]}, {("a", 2, 0.0)}, a=[2], b=[2])
    with pytest.raises(AssertionError, match="no free pair"):
        enumerate_transition(arm, *arm.poses().values())
