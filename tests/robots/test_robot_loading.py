"""Robots from files: what is read, what is refused and with which words, bodies, fingerprints."""

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from arms import HOME_PANDA, PANDA, TURN, UR5, arm_urdf
from collisions import colliding_links

from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.robots import ROBOT_NAMES, load_robot

JOINT = ("revolute", "0 0 0.3", "0 0 0", "0 1 0", (-2, 2))
LINK_BODY = "<collision><geometry><box size='0.1 0.1 0.1'/></geometry></collision>"


@pytest.fixture
def write(tmp_path):
    def write_arm(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write_arm


def refusal(path, **options):
    with pytest.raises(WorkcellError) as info:
        load_robot(path, **options)
    message = str(info.value)
    assert "\n" not in message
    return message


def test_every_built_in_robot_loads():
    for name in ROBOT_NAMES:
        robot = load_robot(name)
        assert robot.name == name
        assert colliding_links(robot, robot.home) is None
        assert robot.within_limits(robot.home)


def test_the_nova2_is_as_specified(nova2):
    assert nova2.joint_names == tuple(f"joint{i}" for i in range(1, 7))
    np.testing.assert_allclose(nova2.upper, [6.28, 2.618, 2.618, 6.28, 6.28, 6.28])
    np.testing.assert_allclose(nova2.lower, -nova2.upper)
    masses = [inertia.mass for inertia in nova2.model.inertias]
    np.testing.assert_allclose(masses[1:], [0.803, 1.578, 0.999, 0.442, 0.575, 0.124])
    assert len(nova2.collision.geometryObjects) == 2 + 3 + 3 + 3 + 3 + 3 + 1
    for inertia in list(nova2.model.inertias)[1:]:
        moments = np.sort(np.linalg.eigvalsh(inertia.inertia))
        assert moments[0] > 0
        assert moments[2] <= moments[0] + moments[1] + 1e-9


def test_the_nova2_folds_into_itself_only_now_and_then(nova2):
    q = np.random.default_rng(0).uniform(nova2.lower, nova2.upper, (300, 6))
    free = np.mean([colliding_links(nova2, x) is None for x in q])
    assert 0.8 < free < 0.98
    assert colliding_links(nova2, [0, 0, 2.618, 1.5, 0, 0]) == ("link1", "link5")


def test_bodies_keep_their_place_when_joints_are_locked(panda):
    full = pin.buildModelFromUrdf(str(PANDA))
    bodies = pin.buildGeomFromUrdf(full, str(PANDA), pin.GeometryType.COLLISION, package_dirs=str(PANDA.parents[4]))
    q = np.concatenate([HOME_PANDA, np.zeros(full.nq - 7)])
    expected, got = bodies.createData(), panda.collision.createData()
    pin.updateGeometryPlacements(full, full.createData(), bodies, expected, q)
    model = panda.model
    pin.updateGeometryPlacements(model, model.createData(), panda.collision, got, np.array(HOME_PANDA))
    assert len(got.oMg) == len(expected.oMg) > 7
    for a, b in zip(got.oMg, expected.oMg, strict=True):
        np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=1e-12)


def test_tips_are_found(nova2, ur5):
    assert (nova2.tip_frame, ur5.tip_frame) == ("flange", "tool0")
    assert load_robot(PANDA).tip_frame == "panda_hand"


def test_the_tip_can_be_chosen_and_later_joints_are_locked(nova2):
    robot = load_robot("nova2", tip="link3", home=[0.1, 0.2, 0.3])
    assert robot.dof == 3
    q = np.array([0.4, -0.5, 0.6])
    frames = nova2.link_transforms([*q, 0, 0, 0])
    np.testing.assert_allclose(robot.forward(q), frames[2], atol=1e-12)


def test_continuous_joints_have_one_coordinate_and_finite_limits(mixed):
    assert mixed.model.nq == mixed.dof == 4
    np.testing.assert_allclose((mixed.lower[2], mixed.upper[2]), (-2 * np.pi, 2 * np.pi))


def test_home_is_mid_range_where_zero_is_no_position(panda):
    home = load_robot(PANDA, tip="panda_link8").home
    assert home[3] == pytest.approx((panda.lower[3] + panda.upper[3]) / 2)
    np.testing.assert_array_equal(home[[0, 1, 2, 4]], 0.0)


def test_self_collision_pairs_leave_out_neighbours_and_ignored_links(nova2):
    joints = [body.parentJoint for body in nova2.collision.geometryObjects]
    pairs = nova2.self_collision_pairs()
    assert all(abs(joints[i] - joints[j]) > 1 for i, j in pairs)
    assert len(set(pairs)) == len(pairs) == 92
    fewer = load_robot("nova2", ignore_collisions=[("link5", "link2")])
    left = {frozenset((fewer.link_of(i), fewer.link_of(j))) for i, j in fewer.self_collision_pairs()}
    assert frozenset(("link2", "link5")) not in left
    assert len(fewer.self_collision_pairs()) == 92 - 3 * 3


def test_colliding_links_are_named(panda):
    folded = load_robot(PANDA, tip="panda_link8")
    assert set(colliding_links(folded, folded.home)) == {"panda_link5", "panda_link7"}
    assert colliding_links(panda, panda.home) is None


def test_robots_travel_between_processes(nova2, ur5):
    for robot in (nova2, ur5):
        again = pickle.loads(pickle.dumps(robot))
        assert again.fingerprint() == robot.fingerprint()
        T = robot.forward(np.linspace(-1, 1, 6))
        np.testing.assert_array_equal(again.solve_ik(T).q, robot.solve_ik(T).q)


def test_fingerprint_follows_what_decides_feasibility(write, ur5):
    text = arm_urdf([JOINT, JOINT, JOINT], geometry=LINK_BODY)
    original = load_robot(write(text)).fingerprint()
    for old, new in (("size='0.1", "size='0.2"), ("0 0 0.3", "0 0 0.31"), ("upper='2'", "upper='1.9'")):
        assert load_robot(write(text.replace(old, new, 1))).fingerprint() != original
    assert load_robot(write(text.replace("name='arm'", "name='other'"))).fingerprint() == original
    assert load_robot(write(text), home=[0.1, 0.1, 0.1]).fingerprint() == original
    ignoring = load_robot(UR5, ignore_collisions=[("base_link", "forearm_link")])
    assert ignoring.fingerprint() != ur5.fingerprint() == load_robot(UR5).fingerprint()


def test_relative_meshes_are_found_beside_the_urdf(write, tmp_path, monkeypatch):
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "body.stl")
    mesh = "<collision><geometry><mesh filename='{}'/></geometry></collision>"
    monkeypatch.chdir("/")
    relative = load_robot(write(arm_urdf([JOINT], geometry=mesh.format("body.stl"))))
    assert len(relative.collision.geometryObjects) == 1
    packaged = write(arm_urdf([JOINT], geometry=mesh.format("package://parts/body.stl")))
    assert "package_dirs" in refusal(packaged)
    (tmp_path / "elsewhere" / "parts").mkdir(parents=True)
    (tmp_path / "body.stl").rename(tmp_path / "elsewhere" / "parts" / "body.stl")
    assert len(load_robot(packaged, package_dirs=[tmp_path / "elsewhere"]).collision.geometryObjects) == 1


def test_unknown_names_list_the_known_ones():
    with pytest.raises(UnknownNameError) as info:
        load_robot("nova3")
    assert info.value.alternatives[0] == "nova2"


def test_files_that_are_no_robot_are_refused(tmp_path, write, capfd):
    assert "cannot be read" in refusal(tmp_path / "none.urdf")
    assert "not valid XML: " in refusal(write("<robot name='a'><link"))
    assert "no <robot>" in refusal(write("<mujoco/>"))
    assert "'gone'" in refusal(write(arm_urdf([JOINT]).replace("parent link='link0'", "parent link='gone'")))
    assert "names the link ''" in refusal(write(arm_urdf([JOINT]).replace("<parent link='link0'/>", "")))
    assert "2 links have no parent" in refusal(write(arm_urdf([JOINT], extra="<link name='loose'/>")))
    bad_number = arm_urdf([JOINT]).replace("xyz='0 0 0.3'", "xyz='0 zero 0.3'")
    assert "Pinocchio" in refusal(write(bad_number))
    assert capfd.readouterr().err == ""


def test_arms_that_are_no_serial_chain_are_refused(write):
    floating = ("floating", "0 0 0", "0 0 0", "0 0 1", None)
    assert "'j1' on the way to the tip is floating" in refusal(write(arm_urdf([floating, JOINT])))
    mimic = arm_urdf([JOINT, JOINT]).replace("<axis", "<mimic joint='j1'/><axis", 1)
    assert "mimics" in refusal(write(mimic))
    assert "no moving joint" in refusal(write(arm_urdf([("fixed", "0 0 1", "0 0 0", "0 0 1", None)])))
    twice = "<joint name='x' type='fixed'><parent link='link0'/><child link='link2'/></joint>"
    assert "two parent joints" in refusal(write(arm_urdf([JOINT, JOINT], extra=twice)))


def test_lengths_that_are_no_metres_are_refused(write):
    for length, said in (("400", "joints 400 m apart"), ("-1e308", "joints 1e+308 m apart")):
        assert said in refusal(write(arm_urdf([JOINT, (JOINT[0], f"0 {length} 0.3", *JOINT[2:])])))


def test_links_and_joints_of_one_name(write, nova2):
    text = Path(nova2.urdf_path).read_text("utf-8")
    assert 'name="flange_joint"' in text
    finger = (
        "<link name='{0}'/><joint name='{0}' type='{1}'><parent link='flange'/><child link='{0}'/><axis xyz='0 0 1'/>"
    )
    limit = "<limit lower='0' upper='0.1' velocity='1' effort='1'/>"
    extra = finger.format("left", "prismatic") + limit + "</joint>"
    extra += finger.format("right", "prismatic") + limit + "<mimic joint='left'/></joint>"
    extra += finger.format("flange_joint", "floating") + "</joint>"
    same = load_robot(
        write(text.replace("flange_joint", "flange").replace("</robot>", extra + "</robot>")), tip="flange"
    )
    assert same.joint_names == nova2.joint_names
    np.testing.assert_array_equal(same.forward(nova2.home), nova2.forward(nova2.home))
    same = load_robot(write(text.replace('"joint2"', '"flange"').replace('"flange_joint"', '"x"')), tip="flange")
    assert same.joint_names == ("joint1", "flange", "joint3", "joint4", "joint5", "joint6")
    np.testing.assert_array_equal(same.forward(nova2.home), nova2.forward(nova2.home))
    assert same.self_collision_pairs() == nova2.self_collision_pairs()


@pytest.mark.parametrize("limits", [None, (1, 1), (2, -2), ("nan", 1), (0, "inf"), ("x", 1)])
def test_joints_without_proper_limits_are_refused(write, limits):
    assert "'j1' needs a <limit>" in refusal(write(arm_urdf([(*JOINT[:4], limits)])))


def test_options_that_do_not_fit_the_robot_are_refused():
    message = refusal(UR5, tip="tool1")
    assert "no link 'tool1' for the tip; known: tool0" in message
    message = refusal("nova2", home=[0, 0, 3, 0, 0, 0])
    assert "joint3 at 3, outside its limits -2.618 to 2.618" in message
    assert "has 2 values; give 6" in refusal("nova2", home=[0, 0])
    assert "joint1 at nan" in refusal("nova2", home=[np.nan] * 6)
    assert "known: link5" in refusal("nova2", ignore_collisions=[("link55", "link1")])


def test_limits_of_a_joint_that_never_reaches_zero(write):
    path = write(arm_urdf([(*JOINT[:4], (3.5, 8.0)), (*JOINT[:4], TURN), (*JOINT[:4], TURN)]))
    robot = load_robot(path)
    assert robot.home[0] == pytest.approx(5.75)
    solutions = robot.solve_ik(robot.forward([7.0, 0.4, 0.9]))
    assert len(solutions.q)
    assert (solutions.q[:, 0] >= 3.5).all()


def test_joints_that_form_a_loop_are_refused(write):
    joint = "<joint name='{0}{1}' type='fixed'><parent link='{0}'/><child link='{1}'/></joint>"
    loop = "".join(joint.format(*pair) for pair in ("ab", "ba", "bt"))
    links = "".join(f"<link name='{name}'/>" for name in ("base", "a", "b", "t"))
    said = refusal(write(f"<robot name='arm'>{links}{loop}</robot>"), tip="t")
    assert "the joints form a loop at link 'b'; a robot must be a tree" in said
