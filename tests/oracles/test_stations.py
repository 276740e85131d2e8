"""The campaign over several supports in small: a task, and what its tables say of tasks that fall short."""

from oracles.stations import SHOWN, fewest, problem_of, resting_poses, tables, task


def test_a_task_between_supports_is_planned_and_verified(tmp_path):
    (tmp_path / "plans").mkdir()
    row = {"tool": "w", "object": "bottle", "number": 1, **task(tmp_path, 0, 200, "w", "bottle", 1, False)}
    shelf = row["shelf"]
    assert (shelf["status"], shelf["false"]) == ("solved", []), row
    assert len(set(shelf["ends"])) == 2 and shelf["supports"][0] == shelf["ends"][0]
    assert row["table"]["status"] == "solved" and set(row["table"]["supports"]) == {"table"}
    assert len(list((tmp_path / "plans").glob("*.json"))) == 1
    assert "| bottle, w | 1 | 1 | 1 |" in tables([row])


def test_the_exact_search_finds_the_way_over_the_shelf():
    thing, *_ = SHOWN["shelf-between"]
    problem = problem_of("w", thing, "shelf-between")
    ends = [problem.pose(0, support=name) for name in ("rack", "cup")]
    poses = resting_poses("w", thing, "shelf-between", 200, 0)
    assert fewest(problem, poses, *ends) == 1 and fewest(problem, poses, ends[0], ends[0]) == 0


def test_tables_name_what_falls_short():
    good = {"status": "solved", "num_regrasps": 1, "exact": 1, "false": [], "seconds": 0.1, "ends": ["a", "b"]}
    for change, said in (
        ({"false": ["pose 1: it would tip over"]}, "it would tip over"),
        ({"status": "not_found", "num_regrasps": None}, "not_found"),
        ({"num_regrasps": 2}, "'num_regrasps': 2"),
        ({"motion": {"status": "not_found", "reason": "lift", "seconds": 1.0}}, "'reason': 'lift'"),
    ):
        for one, expected in (({**good, **change}, True), (good, False)):
            row = {"tool": "w", "object": "mug", "number": 3, "shelf": one, "table": good}
            assert (f"* ('w', 'mug', 3): {one}" in tables([row]) and said in tables([row])) is expected
