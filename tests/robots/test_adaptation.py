"""What workcell files ask of a URDF: links left out, joints locked, the seat of the tool, its default."""

import logging

import numpy as np
import pinocchio as pin
import pytest
from arms import FOREIGN, MIXED, PANDA, arm_urdf

from regrasp_opt.conventions import rotation_rpy
from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import load_robot
from regrasp_opt.scene import load_workcell

TURN = (-2, 2)
BODY = "<collision><geometry><sphere radius='0.05'/></geometry></collision>"
TURNING = ("revolute", "0 0 0.3", "0.1 0.2 0.3", "0.6 0 0.8", TURN)
GRIPPER = (
    "<link name='hand'/><joint name='hand' type='fixed'><parent link='link{n}'/><child link='hand'/></joint>"
    "<link name='tcp'/><joint name='tcp' type='fixed'><parent link='hand'/><child link='tcp'/></joint>"
    "<link name='moved'>{body}</link><joint name='{name}' type='{kind}'><parent link='hand'/><child link='moved'/>"
    "<origin xyz='0 0.01 0.1'/><axis xyz='0 1 0'/><limit lower='-0.1' upper='0.3' velocity='1' effort='1'/>{more}"
    "</joint>"
)


@pytest.fixture
def write(tmp_path):
    def to_file(text, name="arm.urdf"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return to_file


def refusal(path, **options):
    with pytest.raises(WorkcellError) as info:
        load_robot(path, **options)
    assert "\n" not in str(info.value)
    return str(info.value)


def gripper(n=6, name="drive", kind="prismatic", body=BODY, more=""):
    return GRIPPER.format(n=n, name=name, kind=kind, body=body, more=more)


@pytest.mark.parametrize("locked", [{"j1": 0.7}, {"j3": -0.15}, {"j4": 2.9}, {"j1": -1.0, "j5": 2.5}])
def test_a_locked_joint_stays_where_it_is_told(write, locked):
    path = write(arm_urdf(MIXED))
    free, held = load_robot(path), load_robot(path, locked=locked)
    assert held.joint_names == tuple(name for name in free.joint_names if name not in locked)
    rng = np.random.default_rng(0)
    for q in rng.uniform(free.lower, free.upper, (20, free.dof)):
        q[[free.joint_names.index(name) for name in locked]] = list(locked.values())
        moving = [value for name, value in zip(free.joint_names, q, strict=True) if name not in locked]
        np.testing.assert_allclose(held.forward(np.array(moving)), free.forward(q), atol=1e-12)


def test_a_locked_joint_beside_the_arm_moves_its_bodies_and_those_that_mimic_it(write):
    follower = (
        "<link name='other'>{body}</link><joint name='other' type='revolute'><parent link='hand'/>"
        "<child link='other'/><axis xyz='1 0 0'/><limit lower='-3' upper='3' velocity='1' effort='1'/>"
        "<mimic joint='drive' multiplier='2' offset='0.1'/></joint>"
    ).format(body="<collision><origin xyz='0 0 0.2'/><geometry><sphere radius='0.05'/></geometry></collision>")
    path = write(arm_urdf([TURNING] * 6, gripper() + follower))
    neutral, open_ = (load_robot(path, tip="tcp", locked=locked) for locked in (None, {"drive": 0.2}))

    def place(robot, link):
        (item,) = (g for i, g in enumerate(robot.collision.geometryObjects) if robot.link_of(i) == link)
        return item.placement

    np.testing.assert_allclose(
        place(open_, "moved").translation - place(neutral, "moved").translation,
        place(neutral, "moved").rotation @ [0, 0.2, 0],
        atol=1e-12,
    )
    expected = open_.chain.tip[:3, :3] @ (pin.exp3(np.array([0.5, 0, 0])) @ [0, 0, 0.2]) + open_.chain.tip[:3, 3]
    np.testing.assert_allclose(place(open_, "other").translation, expected, atol=1e-12)


BESIDE = (
    "<link name='{name}'>{body}</link><joint name='{name}' type='{kind}'><parent link='{parent}'/>"
    "<child link='{name}'/><axis xyz='0 1 0'/><limit lower='{low}' upper='{high}' velocity='1' effort='1'/>{more}"
    "</joint>"
)
HIGH = BODY.replace("<geometry>", "<origin xyz='0 0 0.5'/><geometry>")


def beside(name, parent="link0", body="", kind="revolute", low=-3, high=3, more=""):
    return BESIDE.format(name=name, parent=parent, body=body, kind=kind, low=low, high=high, more=more)


def centre(robot, link):
    """Return where the first body of `link` is, as a link that does not move."""
    return next(g for i, g in enumerate(robot.collision.geometryObjects) if robot.link_of(i) == link).placement


@pytest.mark.parametrize(
    ("extra", "joint", "leader", "link"),
    [
        (beside("rod", body=BODY, more="<mimic joint='j1'/>"), "rod", "j1", "rod"),
        (beside("rod", body=BODY, more="<mimic joint='j2' multiplier='-1'/>"), "rod", "j2", "rod"),
        (beside("rod", body=BODY, kind="prismatic", more="<mimic joint='j1'/>"), "rod", "j1", "rod"),
        (
            beside("rod", more="<mimic joint='j3'/>") + beside("end", "rod", kind="fixed") + beside("tip", "end", BODY),
            "rod",
            "j3",
            "tip",
        ),
        (
            beside("bar", more="<mimic joint='rod'/>", body=BODY) + beside("rod", more="<mimic joint='j1'/>"),
            "bar",
            "j1",
            "bar",
        ),
    ],
)
def test_bodies_that_move_with_a_joint_of_the_arm_beside_it_are_refused(write, extra, joint, leader, link):
    path = write(arm_urdf([TURNING] * 6, extra))
    said = refusal(path, tip="link6")
    assert f"joint '{joint}' mimics joint '{leader}' of the arm and moves link '{link}', which has <collision>" in said
    assert f"leave out '{joint}' (leave_out), or lock '{joint}' (locked)" in said
    assert load_robot(path, tip="link6", leave_out=[joint]).dof == 6
    assert load_robot(path, tip="link6", locked={joint: 0.1}).dof == 6
    if leader == "j1":
        assert load_robot(path, tip="link6", locked={"j1": 0.4}).joint_names == ("j2", "j3", "j4", "j5", "j6")


def test_links_without_bodies_may_move_beside_the_arm(write):
    extra = beside("rod", more="<mimic joint='j1'/>") + beside("bar", body=BODY, more="<mimic joint='bar'/>")
    robot = load_robot(write(arm_urdf([TURNING] * 6, extra)), tip="link6")
    assert [robot.link_of(i) for i in range(robot.collision.ngeoms)] == ["bar"]


def test_mimics_follow_leaders_that_nobody_locked(write, caplog):
    mimic = "<mimic joint='{}' multiplier='{}' offset='{}'/>"
    extra = beside("lead") + beside("a", body=HIGH, more=mimic.format("lead", 1, -1.5))
    extra += beside("b", body=HIGH, kind="prismatic", more=mimic.format("a", -2, 0.1))
    path = write(arm_urdf([TURNING] * 6, extra))
    with caplog.at_level(logging.WARNING):
        robot = load_robot(path, tip="link6")
    np.testing.assert_allclose(centre(robot, "a").translation, [0.5 * np.sin(-1.5), 0, 0.5 * np.cos(1.5)], atol=1e-12)
    np.testing.assert_allclose(centre(robot, "b").translation, [0, 3.1, 0.5], atol=1e-12)
    assert "outside the limits" not in caplog.text
    assert robot.fingerprint() == load_robot(path, tip="link6", locked={"lead": 0.0}).fingerprint()


def test_mimics_with_wrong_numbers_are_refused(write):
    lead = beside("lead", low=1e300, high=2e300)
    for more, said in (
        ("multiplier='1e300'", "joint 'a' mimics joint 'lead' to inf; give its <mimic> a smaller multiplier"),
        ("offset='x'", "joint 'a' has offset=\"x\"; give 1 number"),
    ):
        extra = lead + beside("a", body=BODY, more=f"<mimic joint='lead' {more}/>")
        assert refusal(write(arm_urdf([TURNING] * 6, extra)), tip="link6").count(said) == 1


@pytest.mark.parametrize(("low", "high", "rest"), [(0.5, 1, 0.5), (-1, -0.25, -0.25), (-1, 1, 0), (0, 0, 0)])
def test_joints_beside_the_arm_rest_within_their_limits(write, caplog, low, high, rest):
    extra = beside("lead", body=HIGH, low=low, high=high)
    extra += beside("a", body=HIGH, more="<mimic joint='lead' multiplier='2' offset='0.5'/>")
    path = write(arm_urdf([TURNING] * 6, extra))
    with caplog.at_level(logging.WARNING):
        robot = load_robot(path, tip="link6")
    np.testing.assert_allclose(centre(robot, "lead").translation[0], 0.5 * np.sin(rest), atol=1e-12)
    np.testing.assert_allclose(centre(robot, "a").translation[0], 0.5 * np.sin(2 * rest + 0.5), atol=1e-12)
    assert (f"the nearest value (lead at {rest:g}); give as locked where they are" in caplog.text) == (rest != 0)
    if low < high:
        caplog.clear()
        robot = load_robot(path, tip="link6", locked={"lead": high})
        np.testing.assert_allclose(centre(robot, "lead").translation[0], 0.5 * np.sin(high), atol=1e-12)
        assert caplog.text.count("locked where they are") == 0


def test_wrong_values_of_locked_joints_are_refused(write):
    path = write(arm_urdf(MIXED))
    assert "joint 'j7' cannot be locked, it does not exist; joints that move: j1" in refusal(path, locked={"j7": 0})
    assert "joint 'j2' cannot be locked, it is fixed" in refusal(path, locked={"j2": 0})
    assert "joint 'j3' cannot be locked at 0.4, its limits are -0.2 to 0.3" in refusal(path, locked={"j3": 0.4})
    assert "joint 'j4' cannot be locked at inf; give a finite" in refusal(path, locked={"j4": np.inf})
    broken = write(arm_urdf(MIXED).replace("0.1 0 0.3", "a 0 0.3"), "b.urdf")
    assert "joint 'j1' has xyz=\"a 0 0.3\"; give 3 numbers" in refusal(broken, locked={"j1": 0})


def test_links_are_left_out_with_all_that_hangs_from_them(write):
    path = write(arm_urdf([TURNING] * 6, gripper(), BODY))
    robot = load_robot(path, leave_out=["hand"])
    assert {f.name for f in robot.model.frames}.isdisjoint({"hand", "tcp", "moved"}) and robot.tip_frame == "link6"
    assert [robot.link_of(i) for i in range(robot.collision.ngeoms)] == ["link0"]
    assert "link 'hnad' cannot be left out, there is none; known: hand" in refusal(path, leave_out=["hnad"])
    assert "link 'link0' cannot be left out, it carries the whole robot" in refusal(path, leave_out=["link0"])


def test_the_tool_sits_where_it_is_told(write):
    path = write(arm_urdf([TURNING] * 6))
    plain = load_robot(path, tip="link6")
    turned = load_robot(path, tip="link6", tip_position=(0.1, 0.2, 0.3), tip_rpy=(0.4, 0.5, 0.6))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_rpy(0.4, 0.5, 0.6), (0.1, 0.2, 0.3)
    q = np.random.default_rng(0).uniform(-2, 2, (5, 6))
    np.testing.assert_allclose(turned.forward(q), plain.forward(q) @ T, atol=1e-12)
    assert turned.fingerprint() != plain.fingerprint() and turned.tip_frame == "link6_tool"
    taken = write(arm_urdf([TURNING] * 6, "", "").replace("'link5'", "'link6_tool'"), "taken.urdf")
    assert load_robot(taken, tip="link6", tip_rpy=(0, 0, 1)).tip_frame == "link6_tool_"


@pytest.mark.parametrize(
    ("extra", "tip", "dof"),
    [
        (gripper(), "moved", 7),  # nothing says that this is a jaw
        (gripper(name="gripper_drive"), "hand", 6),
        (gripper(name="left_finger_joint"), "hand", 6),
        (gripper(more="<mimic joint='j1'/>", body=""), "hand", 6),
    ],
)
def test_an_arm_ends_before_its_jaw(write, caplog, extra, tip, dof):
    with caplog.at_level(logging.WARNING):
        robot = load_robot(write(arm_urdf([TURNING] * 6, extra)))
    said = [r.getMessage() for r in caplog.records if "is taken to end" in r.getMessage()]
    assert (robot.tip_frame, robot.dof) == (tip, dof)
    if dof == 7:
        assert said == []
    else:
        assert len(said) == 1 and "(one of link6, hand, tcp)" in said[0] and "before " in said[0]


def end(name, rpy):
    joint = (
        f"<joint name='{name}' type='fixed'><parent link='link6'/><child link='{name}'/><origin rpy='{rpy}'/></joint>"
    )
    return f"<link name='{name}'/>{joint}"


X_FORWARD, AS_TOOL0 = "0 -1.5707963 -1.5707963", "0 0 0"
ROLL = [("revolute", "0 0 0.3", "0 0 0", "0 0 1", TURN)] * 6


def mounts_said(path, caplog, **options):
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        robot = load_robot(path, **options)
    return robot, [text for text in (r.getMessage() for r in caplog.records) if "the tool is mounted along" in text]


@pytest.mark.parametrize(
    ("axis", "extra", "tip", "across"),
    [
        ("0 0 1", end("flange", X_FORWARD), "flange", True),
        ("0 0 -1", end("flange", X_FORWARD), "flange", True),
        ("0 1 0", end("ee_link", "0 0 1.5707963"), "ee_link", True),
        ("1 0 0", "", "link6", True),
        ("0 0 1", end("flange", AS_TOOL0), "flange", False),
        ("0 0 1", end("flange", "3.1415927 0 0"), "flange", False),
        ("0 0 1", end("flange", X_FORWARD) + end("tool0", AS_TOOL0), "tool0", False),
        ("0 1 0", end("flange", AS_TOOL0), "flange", False),
        ("0 0 1", end("flange", "0 0.7 0"), "flange", False),
    ],
)
def test_a_default_tip_that_points_along_its_x_is_said_to(write, caplog, axis, extra, tip, across):
    path = write(arm_urdf([*ROLL[:5], (*ROLL[0][:3], axis, TURN)], extra))
    robot, said = mounts_said(path, caplog)
    assert robot.tip_frame == tip and len(said) == across
    if across:
        assert f"along +z of '{tip}', the tip that was taken, but 'j6' turns about its x; if the arm" in said[0]
    assert mounts_said(path, caplog, tip=tip)[1] == mounts_said(path, caplog, tip_rpy=[0, 0, 0])[1] == []
    turned, said = mounts_said(path, caplog, tip_rpy=[0, 1.5707963, 0])
    np.testing.assert_allclose(turned.chain.tip[:3, 2], robot.chain.tip[:3, 0], atol=1e-6)
    assert said == []


def test_a_default_tip_after_a_slide_may_point_anywhere(write, caplog):
    slide = ("prismatic", "0 0 0.3", "0 0 0", "1 0 0", (0, 0.2))
    assert mounts_said(write(arm_urdf([*ROLL[:5], slide])), caplog)[1] == []


@pytest.mark.parametrize(
    ("urdf", "tip"),
    [
        (PANDA, "panda_hand"),
        (FOREIGN / "z1_description/urdf/z1.urdf", "gripperStator"),
        (FOREIGN / "kinova_description/robots/kinova.urdf", "j2s6s200_link_6"),
    ],
)
def test_well_known_grippers_are_not_part_of_the_arm(urdf, tip):
    assert load_robot(urdf).tip_frame == tip


SRDF = """<?xml version="1.0"?><robot name="arm"><group name="arm"><joint name="j1"/></group>
<group_state name="ready" group="arm"><joint name="j1" value="0.1"/><joint name="j2" value="-0.2"/></group_state>
<group_state name="ready" group="rest"><joint name="j3" value="0.3"/><joint name="finger" value="1"/></group_state>
<group_state name="half" group="arm"><joint name="j1" value="0.1"/></group_state>
<disable_collisions link1="link0" link2="link2" reason="Never"/>
<disable_collisions link1="link0" link2="elsewhere" reason="Never"/>{more}</robot>"""
THREE = arm_urdf([TURNING] * 3).replace("/><joint", f">{BODY}</link><joint").replace("'></link>", f"'>{BODY}</link>")


def pairs_of(robot):
    return {frozenset((robot.link_of(i), robot.link_of(j))) for i, j in robot.self_collision_pairs()}


def test_an_srdf_says_what_is_not_tested_and_where_the_arm_rests(write):
    path, srdf = write(THREE), write(SRDF.format(more=""), "arm.srdf")
    plain, robot = load_robot(path), load_robot(path, srdf=srdf, home="ready", ignore_collisions=[("link1", "link3")])
    assert pairs_of(plain) - pairs_of(robot) == {frozenset(("link0", "link2")), frozenset(("link1", "link3"))}
    assert robot.home.tolist() == [0.1, -0.2, 0.3]
    assert "state 'half' does not say where j2, j3 is" in refusal(path, srdf=srdf, home="half")
    assert "no state 'raedy' to be at home in; known: ready, half" in refusal(path, srdf=srdf, home="raedy")
    assert "no state 'ready' to be at home in; give an SRDF" in refusal(path, home="ready")


def test_links_that_an_srdf_disables_by_default(write):
    more = '<disable_default_collisions link="link0"/><enable_collisions link1="link0" link2="link3"/>'
    robot = load_robot(write(THREE), srdf=write(SRDF.format(more=more), "arm.srdf"))
    assert frozenset(("link0", "link3")) in pairs_of(robot) and frozenset(("link0", "link2")) not in pairs_of(robot)


def test_files_that_are_not_srdf_are_refused(write, tmp_path):
    path = write(THREE)
    assert "cannot be read; give the path of an SRDF" in refusal(path, srdf=tmp_path / "none.srdf")
    assert "is not valid XML" in refusal(path, srdf=write("<robot>", "a.srdf"))
    assert "is not an SRDF file" in refusal(path, srdf=path)
    text = SRDF.format(more='<group_state name="x"><joint name="j1" value="up"/></group_state>')
    assert "state 'x' has value=\"up\" for joint 'j1'; give one number" in refusal(path, srdf=write(text, "b.srdf"))


def test_states_of_other_groups_do_not_matter_to_the_arm(write):
    path = write(THREE)
    whole = '<group_state name="up" group="arm">{}</group_state>'.format(
        "".join(f'<joint name="j{k}" value="0.{k}"/>' for k in (1, 2, 3))
    )
    other = '<group_state name="up" group="both"><joint name="j1" value="0.9"/></group_state>'
    odom = '<group_state name="up" group="base"><joint name="odom" value="0 0 0"/></group_state>'
    for more in (whole + other + odom, odom + other + whole):
        srdf = write(SRDF.format(more=more), "arm.srdf")
        assert load_robot(path, srdf=srdf, home="up").home.tolist() == [0.1, 0.2, 0.3]
    for more in (whole + whole.replace("0.2", "0.5"), other.replace("0.9", "0.2") + other.replace("both", "right")):
        srdf = write(SRDF.format(more=more), "arm.srdf")
        assert load_robot(path, srdf=srdf, home="ready").home.tolist() == [0.1, -0.2, 0.3]
        said = refusal(path, srdf=srdf, home="up")
        assert "several groups have a state 'up', and put j" in said and "give home as numbers" in said


CELL = """schema = 1
[robot]
model = "arm.urdf"
tip = "link6"
{robot}
[end_effector]
model = "w"
[table]
height = -1.0
center = [0, 0]
size = [1, 1]
[workspace]
x = [-0.3, 0.3]
y = [-0.3, 0.3]
"""


def test_a_workcell_file_has_all_of_it(write):
    write(arm_urdf([TURNING] * 7, gripper(7)))
    write(SRDF.format(more="").replace("ready", "up").replace('"j3"', '"j6"'), "arm.srdf")
    keys = 'locked = {{ j2 = 0.5 }}\nleave_out = ["hand"]\ntip_rpy = [0.0, 1.5, 0.0]\nsrdf = "arm.srdf"\n'
    cell = load_workcell(write(CELL.format(robot=keys.replace("{{", "{").replace("}}", "}")), "cell.toml"))
    assert cell.robot.joint_names == ("j1", "j3", "j4", "j5", "j6") and cell.robot.tip_frame == "link6_tool"
    assert frozenset(("link0", "link2")) in cell.robot.ignored
    with pytest.raises(WorkcellError, match=r"section 'robot': .* state 'up' does not say where"):
        load_workcell(write(CELL.format(robot='home = "up"\nsrdf = "arm.srdf"'), "cell.toml"))
    for wrong, said in (
        ("home = true", "robot.home"),
        ("locked = [1]", "robot.locked"),
        ("tip_rpy = [1]", "robot.tip_rpy"),
    ):
        with pytest.raises(WorkcellError, match=said):
            load_workcell(write(CELL.format(robot=wrong), "cell.toml"))
