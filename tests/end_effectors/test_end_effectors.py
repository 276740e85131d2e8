from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from regrasp_opt.end_effectors import END_EFFECTOR_NAMES, EndEffector, load_end_effector
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, surface_points

PARALLEL = ("w", "r140", "r85")
SUCTION = ("s1", "s2", "s3")

PAPER = {  # TCP offset, stroke, outer half width of the open jaw, fingertip depth [m]
    "w": (0.16, 0.104, 0.0605, 0.1785),
    "r140": (0.20, 0.140, 0.101, 0.206),
    "r85": (0.15, 0.085, 0.074, 0.163),
}

VALID = """
kind = "parallel"
tcp_offset = 0.16
max_opening = 0.1
[[body]]
name = "palm"
box = { x = [-0.04, 0.04], y = [-0.04, 0.04], z = [0.0, 0.08] }
[[finger]]
name = "finger"
box = { x = [-0.01, 0.01], y = [0.0, 0.01], z = [0.08, 0.17] }
"""


def extent(boxes: tuple[Box, ...]) -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([surface_points(box) for box in boxes])
    return points.min(axis=0), points.max(axis=0)


@pytest.mark.parametrize("name", PARALLEL)
def test_parallel_grippers_fill_their_stated_envelope(name: str) -> None:
    gripper = load_end_effector(name)
    tcp, stroke, outer, tip = PAPER[name]
    assert (gripper.tcp_offset, gripper.max_opening, gripper.pre_opening) == (tcp, stroke, 0.005)
    low, high = extent(gripper.finger_boxes(stroke))
    np.testing.assert_allclose([low[1], high[1], high[2]], [-outer, outer, tip], atol=1e-12)
    assert low[2] == pytest.approx(max(surface_points(body)[:, 2].max() for body in gripper.body))


@pytest.mark.parametrize(
    ("name", "width", "ends"),
    [("w", 0.025, (0.086, 0.1785)), ("r140", 0.027, (0.141, 0.206)), ("r85", 0.020, (0.128, 0.163))],
)
def test_pads_are_as_large_as_stated(name: str, width: float, ends: tuple[float, float]) -> None:
    pad = load_end_effector(name).pad
    np.testing.assert_allclose([*pad.x, *pad.z], [-width / 2, width / 2, *ends], atol=1e-12)


def read(path: Path, text: str) -> EndEffector:
    path.write_text(text)
    return load_end_effector(path)


def test_the_pad_is_the_inner_face_of_the_fingertip_unless_given(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    tip = '[[finger]]\nname = "tip"\nbox = { x = [-0.006, 0.008], y = [0.0, 0.004], z = [0.15, 0.18] }\n'
    back = '[[finger]]\nname = "back"\nbox = { x = [-0.02, 0.02], y = [0.004, 0.01], z = [0.14, 0.18] }\n'
    given = "[pad]\nx = [-0.002, 0.001]\nz = [0.1, 0.12]\n"
    for text, pad in (
        (VALID, [[-0.01, 0.01], [0.08, 0.17]]),
        (VALID + tip, [[-0.006, 0.008], [0.15, 0.18]]),
        (VALID + back + tip, [[-0.006, 0.008], [0.15, 0.18]]),
        (VALID + given, [[-0.002, 0.001], [0.1, 0.12]]),
    ):
        np.testing.assert_allclose(read(path, text).pad, pad, atol=1e-12)


def test_only_a_pad_that_is_not_the_default_is_part_of_the_fingerprint(tmp_path: Path) -> None:
    plain = read(tmp_path / "plain.toml", VALID).fingerprint()
    same = read(tmp_path / "same.toml", VALID + "[pad]\nx = [-0.01, 0.01]\nz = [0.08, 0.17]\n").fingerprint()
    other = read(tmp_path / "other.toml", VALID + "[pad]\nx = [-0.01, 0.01]\nz = [0.08, 0.16]\n").fingerprint()
    assert plain == same != other


@pytest.mark.parametrize(("name", "tcp", "radius"), [("s1", 0.05, 0.015), ("s2", 0.046, 0.0125), ("s3", 0.03, 0.01)])
def test_suction_cup_ends_one_lip_short_of_the_tcp(name: str, tcp: float, radius: float) -> None:
    cup = load_end_effector(name)
    assert (cup.tcp_offset, cup.cup_radius, cup.max_opening, cup.pre_opening) == (tcp, radius, 0.0, 0.0)
    mount, lip = cup.body
    assert isinstance(lip, Cylinder) and lip.radius == radius
    assert surface_points(lip)[:, 2].max() == pytest.approx(tcp - 0.002)
    assert surface_points(lip)[:, 2].min() == pytest.approx(surface_points(mount)[:, 2].max())
    assert cup.finger == () and cup.finger_boxes(0.0) == ()


@pytest.mark.parametrize("name", END_EFFECTOR_NAMES)
def test_tcp_transforms_are_inverse(name: str) -> None:
    tool = load_end_effector(name)
    np.testing.assert_allclose(tool.T_flange_tcp @ tool.T_tcp_flange, np.eye(4), atol=1e-15)
    assert tool.T_flange_tcp[2, 3] == tool.tcp_offset


@given(name=st.sampled_from(PARALLEL), width=st.floats(0, 0.08), swept=st.floats(0, 0.02))
def test_fingers_keep_their_inner_faces_and_sweep_outward(name: str, width: float, swept: float) -> None:
    gripper = load_end_effector(name)
    boxes = gripper.finger_boxes(width, swept)
    half = len(boxes) // 2
    right, left = extent(boxes[:half]), extent(boxes[half:])
    thickness = max(box.size[1] for box in gripper.finger)
    np.testing.assert_allclose([right[0][1], right[1][1]], [width / 2, width / 2 + swept + thickness], atol=1e-12)
    np.testing.assert_allclose([left[0][1], left[1][1]], [-right[1][1], -right[0][1]], atol=1e-12)
    for a, b in zip(boxes[:half], boxes[half:], strict=True):
        assert np.linalg.det(b.pose) == pytest.approx(1.0) and np.array_equal(a.size, b.size)


def test_points_of_the_tool_follow_its_width() -> None:
    effector, widths = load_end_effector("r140"), np.array([0.0, 0.03, 0.11])
    fingers = [surface_points(box) for box in effector.finger_boxes(0.0, 0.01)]
    fixed = [surface_points(shape) for shape in effector.body]
    points = effector.points_at_widths(fixed, fingers, widths)
    for width, found in zip(widths, points, strict=True):
        there = [surface_points(box) for box in effector.finger_boxes(width, 0.01)]
        np.testing.assert_allclose(found, np.concatenate([*fixed, *there]), atol=1e-12)
    cup = load_end_effector("s1")
    body = [surface_points(shape) for shape in cup.body]
    np.testing.assert_array_equal(cup.points_at_widths(body, [], widths), np.tile(np.concatenate(body), (3, 1, 1)))


def test_fingerprints_differ_and_follow_geometry_only() -> None:
    tools = [load_end_effector(name) for name in END_EFFECTOR_NAMES]
    assert len({tool.fingerprint() for tool in tools}) == len(tools)
    w = tools[0]
    renamed = EndEffector(**{**vars(w), "name": "other", "source": "elsewhere"})
    deeper = EndEffector(**{**vars(w), "tcp_offset": 0.161})
    assert renamed.fingerprint() == w.fingerprint() != deeper.fingerprint()


def test_a_file_is_read_like_a_built_in(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(VALID)
    tool = load_end_effector(path)
    assert (tool.name, tool.kind, tool.pre_opening, tool.source) == ("mine", "parallel", 0.005, str(path))
    np.testing.assert_allclose(tool.finger[0].size, [0.02, 0.01, 0.09])
    assert load_end_effector(str(path)).fingerprint() == tool.fingerprint()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("tcp_offset", "tcp_ofset", "tcp_ofset"),
        ("tcp_offset = 0.16", "tcp_offset = -1", "'tcp_offset'"),
        ("tcp_offset = 0.16", "", "'tcp_offset' is missing"),
        ("0.16", "nan", "'tcp_offset'"),
        ('"parallel"', '"magnet"', "'parallel' or 'suction'"),
        ('"parallel"', '"suction"', "needs the key 'cup_radius'"),
        ("max_opening = 0.1", "", "needs the key 'max_opening'"),
        ("max_opening = 0.1", "max_opening = 0.1\ncup_radius = 0.01", "no key 'cup_radius'"),
        ("z = [0.0, 0.08]", "z = [0.08, 0.0]", "low < high"),
        ("z = [0.0, 0.08]", "w = [0.0, 0.08]", "body.0.box"),
        ("z = [0.0, 0.08]", "z = [0.0, nan]", "'body.0.box.z.1'"),
        ("z = [0.0, 0.08]", "z = [0.0]", "'body.0.box.z.1'"),
        ("z = [0.0, 0.08] }", "z = [0.0, 0.08], q = 1 }", "unknown key 'body.0.box.q'; allowed: x, y, z"),
        ("y = [0.0, 0.01]", "y = [-0.1, 0.01]", "wrong.toml' reaches below y = 0"),
        ("kind =", "kind", "not valid TOML"),
        ("[[body]]", "[pad]\nx = [-0.02, 0.01]\nz = [0.1, 0.17]\n[[body]]", "keep its x in [-0.01, 0.01]"),
        ("[[body]]", "[pad]\nx = [-0.01, 0.01]\nz = [0.1, 0.18]\n[[body]]", "keep its z in [0.08, 0.17]"),
        ("[[body]]", "[pad]\nx = [0.001, 0.01]\nz = [0.1, 0.17]\n[[body]]", "beside the TCP"),
        ("[[body]]", "[pad]\nx = [-0.01, 0.01]\n[[body]]", "key 'pad.z' is missing; needed here: x, z"),
        ("x = [-0.01, 0.01]", "x = [0.001, 0.01]", "beside the TCP"),
    ],
)
def test_wrong_files_name_the_file_and_the_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    path = tmp_path / "wrong.toml"
    assert old in VALID
    path.write_text(VALID.replace(old, new, 1))
    with pytest.raises(WorkcellError) as caught:
        load_end_effector(path)
    message = str(caught.value)
    assert expected in message and "wrong" in message and "\n" not in message


def test_turned_finger_boxes_are_refused() -> None:
    w = load_end_effector("w")
    turned = w.finger[0].pose.copy()
    turned[:2, :2] = [[0, -1], [1, 0]]
    with pytest.raises(WorkcellError, match="turned"):
        EndEffector(**{**vars(w), "finger": (Box("finger", w.finger[0].size, turned),)})


def test_unknown_and_missing_names() -> None:
    with pytest.raises(UnknownNameError) as caught:
        load_end_effector("r-140")
    assert caught.value.alternatives[0] == "r140" and set(caught.value.alternatives) == set(END_EFFECTOR_NAMES)
    with pytest.raises(WorkcellError, match=r"missing\.toml cannot be read"):
        load_end_effector("missing.toml")
