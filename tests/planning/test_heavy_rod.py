"""A rod of 1 kg with its centre of mass at a third: plans, their files, checks and exports follow it."""

import json
import shlex
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles.plans import verify_plan

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.errors import PlanFileError, PoseError
from regrasp_opt.motion.trajectory.scene_export import save_scene
from regrasp_opt.objects import load_object
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.model_store import command_arguments
from regrasp_opt.planning.plan_file import plan_content

THIRD = (0.0, 0.0, -0.05)
ON_END = 4
"""The placement on the heavy end, after four lying ones."""


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    path = tmp_path_factory.mktemp("rod") / "rod.stl"
    trimesh.creation.box((0.028, 0.028, 0.30)).export(path)
    return path


@pytest.fixture(scope="module")
def problem(rod):
    return RegraspProblem.load(rod, mass=1.0, center_of_mass=THIRD)


@pytest.fixture(scope="module")
def plan(problem):
    """The rod is put on its heavy end."""
    found = solve_sequence(problem, problem.pose(0, -0.2, 0.35), problem.pose(ON_END, 0.15, 0.35), "exact")
    assert found.solved
    return found


@pytest.fixture
def saved(plan, tmp_path):
    plan.save(tmp_path / "plan.json")
    return tmp_path / "plan.json"


def test_only_its_heavy_end_is_a_placement(rod, problem):
    assert len(RegraspProblem.load(rod).placements) == 4 and len(problem.placements) == 5
    assert problem.placements[ON_END].pose[2, 2] == pytest.approx(1.0)
    light_below = RegraspProblem.load(rod, center_of_mass=(0.0, 0.0, 0.05))
    assert light_below.placements[ON_END].pose[2, 2] == pytest.approx(-1.0)


def test_the_plan_is_where_its_centre_of_mass_is(problem, plan):
    assert plan.residuals().hold
    for pose, (x, y) in ((plan.poses[0], (-0.2, 0.35)), (plan.poses[-1], (0.15, 0.35))):
        np.testing.assert_allclose((pose @ [*THIRD, 1.0])[:2], (x, y), atol=1e-9)
    for yaw in (0.0, np.pi / 2, np.pi, -np.pi / 2):  # wherever the light end is
        inside, outside = (problem.pose(0, x, 0.35, yaw) for x in (0.4499, 0.4501))
        np.testing.assert_allclose(checked_end(inside, "goal", problem), inside, atol=1e-12)
        with pytest.raises(PoseError, match=r"outside the workspace: the object's centre is at x = 0\.450"):
            checked_end(outside, "goal", problem)


def test_what_stands_on_a_foot_tips_where_its_weight_is_beside_it(tmp_path):
    foot = trimesh.creation.box(bounds=[[-0.014, -0.014, 0.0], [0.014, 0.014, 0.05]])
    bar = trimesh.creation.box(bounds=[[-0.05, -0.014, 0.05], [0.05, 0.014, 0.08]])
    trimesh.boolean.union([foot, bar], engine="manifold").export(tmp_path / "tee.stl")
    problem = RegraspProblem.load(tmp_path / "tee.stl")
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.35, 0.0
    plan = solve_sequence(problem, T, T, "exact")
    assert plan.solved and plan.residuals().hold
    beside = load_object(tmp_path / "tee.stl", center_of_mass=(0.03, 0.0, 0.06))
    with pytest.raises(PoseError, match="would tip over at the start pose"):
        solve_sequence(RegraspProblem.load(beside), T, T, "exact")
    tipping = replace(plan, problem=replace(problem, object=beside))
    assert "the object would tip over at the start" in tipping.residuals().problems
    tipping.save(tmp_path / "plan.json")
    assert any("it would tip over" in text for text in verify_plan(tmp_path / "plan.json"))
    assert any("would tip over" in text for text in RegraspPlan.load(tmp_path / "plan.json").residuals().problems)


def test_its_file_loads_the_same_object(saved):
    again = RegraspPlan.load(saved)
    np.testing.assert_array_equal(again.problem.object.center_of_mass, THIRD)
    assert again.problem.object.mass == 1.0 and again.residuals().hold
    assert verify_plan(saved) == []


def test_another_weight_is_another_object(saved, rod):
    content = json.loads(saved.read_text("utf-8"))
    text = "schema = 1\nmass = {}\n"
    try:
        rod.with_suffix(".toml").write_text(text.format("1.0"), "utf-8")
        assert RegraspPlan.load(saved).solved
        rod.with_suffix(".toml").write_text(text.format("2.0"), "utf-8")
        with pytest.raises(PlanFileError, match=r"'rod' has changed since.*mass of 'rod' is given as 1\.0 but is 2\.0"):
            RegraspPlan.load(saved)
        rod.with_suffix(".toml").write_text("schema = 1\ninertia = [[5e-3, 0, 0], [0, 5e-3, 0], [0, 0, 2e-4]]", "utf-8")
        with pytest.raises(PlanFileError, match="'rod' has changed since"):
            RegraspPlan.load(saved)
    finally:
        rod.with_suffix(".toml").unlink()
    del content["object"]["mass_properties"]
    saved.write_text(json.dumps(content), "utf-8")
    with pytest.raises(PlanFileError, match="'rod' has changed since"):
        RegraspPlan.load(saved)


def test_a_plan_of_an_object_with_nothing_given_is_written_as_before(bottle_plan):
    assert "mass_properties" not in plan_content(bottle_plan)["object"]


def test_the_exported_object_weighs_what_it_weighs(plan, tmp_path):
    save_scene(plan, tmp_path)
    inertial = ET.parse(tmp_path / "object.urdf").getroot().find("link/inertial")
    assert float(inertial.find("mass").get("value")) == 1.0
    np.testing.assert_allclose([float(x) for x in inertial.find("origin").get("xyz").split()], THIRD)
    diagonal = [float(inertial.find("inertia").get(key)) for key in ("ixx", "iyy", "izz")]
    np.testing.assert_allclose(diagonal, np.diag(plan.problem.object.inertia), rtol=1e-6)


def test_the_command_to_prepare_it_names_what_was_given(rod):
    inertia = [[7e-3, 1e-5, 0], [1e-5, 7e-3, 0], [0, 0, 2e-4]]
    body = load_object(rod, mass=1.0, center_of_mass=THIRD, inertia=inertia)
    words = shlex.split(command_arguments(body, RegraspProblem.load("bottle").workcell))
    assert words[words.index("--mass") + 1] == "1.0"
    assert words[words.index("--center-of-mass") + 1] == "0.0,0.0,-0.05"
    assert words[words.index("--inertia") + 1] == "0.007,1e-05,0.0,0.007,0.0,0.0002"
