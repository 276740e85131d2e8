"""What stands still in a robot's URDF is an obstacle to checks, certificates, motions and programs alike."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles.files import DATA

from regrasp_opt import load_workcell
from regrasp_opt.errors import WorkcellError
from regrasp_opt.motion.refinement.bodies import configuration_rows, object_rows
from regrasp_opt.motion.trajectory.collision_context import LEVELS, MotionScene
from regrasp_opt.planning.residuals import _Scene

URDF = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
CELL = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
LINK = """<link name="post"><collision><origin xyz="0 0 0.1"/><geometry>{}</geometry></collision></link>
<joint name="of_post" type="{}"><parent link="{}"/><child link="post"/><origin xyz="{}" rpy="0 0 0.3"/>
<axis xyz="0 0 1"/></joint></robot>"""
OBSTACLE = """
[[obstacles]]
name = "post"
position = [0.15, 0.3, 0.16]
rpy = [0.0, 0.0, 0.3]
"""
POSTS = {
    "box": ('<box size="0.05 0.08 0.3"/>', 'type = "box"\nsize = [0.05, 0.08, 0.3]'),
    "cylinder": ('<cylinder radius="0.03" length="0.3"/>', 'type = "cylinder"\nradius = 0.03\nlength = 0.3'),
    "mesh": ('<mesh filename="post.stl"/>', 'type = "mesh"\nfile = "post.stl"'),
}


def cell_with(folder, geometry="", *, kind="fixed", parent="base_link", at="0.15 0.3 0.06", obstacle="", robot=""):
    trimesh.creation.box((0.05, 0.08, 0.3)).export(folder / "post.stl")
    urdf = URDF.replace("</robot>", LINK.format(geometry, kind, parent, at)) if geometry else URDF
    (folder / "arm.urdf").write_text(urdf, encoding="utf-8")
    home = "home = [-1.913, -0.04, 1.41, 0.2, -1.5708, -0.342]"
    text = CELL.replace('model = "nova2"', f'model = "arm.urdf"\ntip = "flange"\n{home}\n{robot}', 1)
    (folder / "cell.toml").write_text(text + (OBSTACLE + obstacle if obstacle else ""), encoding="utf-8")
    return load_workcell(folder / "cell.toml")


@pytest.fixture(params=POSTS)
def problems(request, tmp_path, bottle_problem):
    """The bottle's problem with a post in the URDF, and with the same post as an obstacle."""
    geometry, obstacle = POSTS[request.param]
    for name in ("own", "other"):
        (tmp_path / name).mkdir()
    own = cell_with(tmp_path / "own", geometry)
    other = cell_with(tmp_path / "other", obstacle=obstacle)
    assert [own.robot.link_of(i) for i in own.robot.obstacles] == ["post"] and not other.robot.obstacles
    return [replace(bottle_problem, workcell=cell, model_folder=None) for cell in (own, other)]


def test_a_post_of_the_urdf_is_what_an_obstacle_is(problems, bottle_plan):
    rng = np.random.default_rng(0)
    q_pick, grasp = bottle_plan.transitions[0].q_pick[0], int(bottle_plan.transitions[0].grasp_ids[0])
    robot, T = problems[0].workcell.robot, bottle_plan.poses[0]
    scenes, verifications = [MotionScene(p) for p in problems], [_Scene(p) for p in problems]
    settings = [(scene.beside(T, (0.02, 0.06)), scene.holding(grasp)) for scene in scenes]
    rows = [configuration_rows(p) for p in problems]
    outcomes = []
    for _ in range(100):
        q = np.clip(q_pick + rng.normal(size=6) * rng.choice([0.2, 0.6, 1.5]), robot.lower, robot.upper)
        free = [p.checker.is_free(T, grasp, q) for p in problems]
        clearances = [p.checker.clearance(T, grasp, q) for p in problems]
        verified = [verification.margins(q, T, grasp)[:2] for verification in verifications]
        assert free[0] == free[1] and clearances[0] == pytest.approx(clearances[1], abs=1e-9)
        np.testing.assert_allclose(*verified, atol=1e-9)
        assert free[0] or verified[0][0] < 1e-6  # which looks at gripper and object too
        for level in (0, len(LEVELS) - 1):
            moving = [[setting.passes(q, level) for setting in pair] for pair in settings]
            assert moving[0] == moving[1]
        margins = [np.array(r.function(q, T, 0.05)).ravel() for r in rows]
        for measured in (True, False):
            least = [m[r.measured == measured].min() for m, r in zip(margins, rows, strict=True)]
            assert least[0] == pytest.approx(least[1], abs=1e-9)
        post = "post" in str(verifications[0].margins(q, T, grasp)[2])
        outcomes.append("free" if free[0] else "post" if post else "other")
    assert min(outcomes.count("free"), outcomes.count("post")) > 5


def test_the_object_keeps_away_from_a_post_of_the_urdf(problems):
    own, other = problems
    rows = [object_rows(p).function for p in problems]
    hit = 0
    for x, y, turn in np.random.default_rng(1).uniform([-0.1, 0.15, -3], [0.4, 0.5, 3], (100, 3)):
        T = own.pose(0, x, y, turn)
        assert own.checker.object_collides(T) == other.checker.object_collides(T)
        hit += own.checker.object_overlaps(T, 0.003) == "the robot's link 'post'"
        assert np.array(rows[0](T)).min() == pytest.approx(np.array(rows[1](T)).min())
    assert 5 < hit < 95


@pytest.mark.parametrize("kind", ["fixed", "revolute", "floating"])
def test_a_body_that_is_always_too_near_is_named_at_home(tmp_path, kind):
    plate, near = '<box size="0.3 0.3 0.05"/>', {"kind": kind, "at": "0 0 0.007"}  # 3.4 mm below the first link
    assert cell_with(tmp_path, plate, kind=kind, at="0 0 0").robot.obstacles
    with pytest.raises(WorkcellError, match="'link1' collides with 'post', or is nearer than its clearance, while"):
        cell_with(tmp_path, plate, **near)
    assert cell_with(tmp_path, plate, **near, robot='ignore_collisions = [["link1", "post"]]').robot.obstacles
