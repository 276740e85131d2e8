"""`plan --obstacles FILE`: the plan keeps clear of them, and `check` knows them."""

from command import assert_refused, in_process

from regrasp_opt import RegraspPlan

FILE = """
[[obstacles]]
type = "cylinder"
name = "post"
radius = 0.03
length = 0.4
position = [0.2, 0.2, 0.2]
"""


def test_the_command_takes_a_file_of_obstacles(capsys, tmp_path):
    (tmp_path / "obstacles.toml").write_text(FILE, "utf-8")
    plan = tmp_path / "plan.json"
    made = in_process(capsys, "plan", "--obstacles", tmp_path / "obstacles.toml", "--out", plan)
    assert made.code == 0, made.err
    assert in_process(capsys, "check", plan).code == 0
    assert [shape.name for shape in RegraspPlan.load(plan).problem.workcell.obstacles] == ["post"]
    assert_refused(in_process(capsys, "plan", "--obstacles", tmp_path / "none.toml"), "obstacles file")
    (tmp_path / "empty.toml").write_text("", "utf-8")
    assert_refused(in_process(capsys, "plan", "--obstacles", tmp_path / "empty.toml"), "'obstacles' is missing")
