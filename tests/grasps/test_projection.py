"""Tool poses a little off settle in the grasp that they were meant to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt.end_effectors import load_end_effector
from regrasp_opt.grasps import Failure, GraspSet, sample_grasps
from regrasp_opt.grasps.clearance import WIDENINGS
from regrasp_opt.grasps.projection import SHIFT, GraspProjector, _central_pair
from regrasp_opt.grasps.suction import NO_SEAL
from regrasp_opt.objects import ObjectModel

THICKNESS = 0.05
PLATE = ObjectModel("plate", trimesh.creation.box(extents=(0.3, THICKNESS, 0.3)), ())


@pytest.fixture(scope="module")
def jaw() -> tuple[GraspProjector, np.ndarray]:
    """Return a projector, and grasps (K, 4, 4) straight across the plate's sides."""
    tool = load_end_effector("w")
    T = sample_grasps(PLATE, tool, 60, seed=0).T_object_tcp
    straight = T[np.abs(T[:, 1, 1]) > 1 - 1e-9]
    assert len(straight) > 10
    return GraspProjector(PLATE, tool), straight


def turned(T: np.ndarray, angle: float, axis: int) -> np.ndarray:
    """Return poses turned about one of their own axes."""
    moved = T.copy()
    moved[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    return moved


@pytest.mark.parametrize("shift", [0.0, 0.008, -0.025])
def test_a_tool_beside_the_middle_is_centred(jaw: tuple[GraspProjector, np.ndarray], shift: float) -> None:
    projector, T = jaw
    beside = T.copy()
    beside[:, :3, 3] += shift * T[:, :3, 1]
    settled, source = projector.settle(beside)
    np.testing.assert_array_equal(source, np.arange(len(T)))
    np.testing.assert_allclose(settled.T_object_tcp, T, atol=1e-9)
    np.testing.assert_allclose(settled.width, THICKNESS, atol=1e-9)
    assert settled.kind == "parallel"


def test_a_tool_too_far_away_does_not_settle(jaw: tuple[GraspProjector, np.ndarray]) -> None:
    projector, T = jaw
    for shift, found in ((SHIFT - 1e-3, len(T)), (SHIFT + 1e-3, 0)):
        beside = T.copy()
        beside[:, :3, 3] -= shift * T[:, :3, 1]
        assert len(projector.settle(beside)[1]) == found
    assert len(projector.settle(np.zeros((0, 4, 4)))[0]) == 0


def test_within_the_friction_cone_a_tilt_is_kept(jaw: tuple[GraspProjector, np.ndarray]) -> None:
    projector, T = jaw
    tilted = turned(T, 0.08, 2)
    settled, source = projector.settle(tilted)
    assert len(source) > len(T) / 2
    np.testing.assert_allclose(settled.T_object_tcp, tilted[source], atol=1e-9)
    wider = settled.width - THICKNESS / np.cos(0.08)  # flat pads meet the sides beside the contacts
    assert (np.abs(wider[:, None] - WIDENINGS).min(axis=1) < 1e-9).all() and wider.max() > 1e-3


@pytest.mark.parametrize("angle", [0.6, -1.0])
def test_beyond_the_cone_the_tool_turns_to_close_along_the_normals(
    jaw: tuple[GraspProjector, np.ndarray], angle: float
) -> None:
    projector, T = jaw
    settled, source = projector.settle(turned(T, angle, 2))
    assert len(source) > len(T) / 3 and (np.diff(source) > 0).all()
    np.testing.assert_allclose(settled.T_object_tcp, T[source], atol=1e-9)
    np.testing.assert_allclose(settled.width, THICKNESS, atol=1e-9)
    assert (
        len(projector.settle(turned(T, 1.4, 2))[1]) == 0
    )  # almost along the sides: the tool would have to turn too far


def test_a_tool_in_the_object_does_not_settle(jaw: tuple[GraspProjector, np.ndarray]) -> None:
    projector, T = jaw
    inside = T.copy()
    inside[:, :3, 3] += 0.1 * T[:, :3, 2]
    assert len(projector.settle(inside)[1]) == 0


def test_a_hollow_side_is_held_by_a_jaw_that_closes_a_little_less() -> None:
    """The contact line meets the floor of a shallow groove, the flat pads meet the ridges beside it."""
    depth, tool = 0.001, load_end_effector("w")
    groove = trimesh.creation.box(extents=(0.006, 2 * depth, 0.4))
    groove.apply_translation([0.0, THICKNESS / 2, 0.0])
    mesh = trimesh.boolean.difference(
        [trimesh.creation.box(extents=(0.05, THICKNESS, 0.12)), groove], engine="manifold"
    )
    model = ObjectModel("rail", mesh, ())
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("x", 180, degrees=True).as_matrix()  # from above, along -z
    T[:3, 3] = 0.0, 0.0, 0.05
    settled, _ = GraspProjector(model, tool).settle(T[None])
    assert len(settled) == 1
    assert settled.width[0] - (THICKNESS - depth) == pytest.approx(0.0015, abs=1e-9)


def test_a_cup_is_pressed_on_the_surface_along_its_normal() -> None:
    tool = load_end_effector("s1")
    projector = GraspProjector(PLATE, tool)
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()  # approach along -y
    T[:, :3, 3] = [[0.02, 0.04, 0.03], [0.05, 0.01, -0.02], [0.0, 0.07, 0.0], [0.149, 0.03, 0.0]]
    tilted = turned(T, 0.2, 0)
    settled, source = projector.settle(tilted)
    assert source.tolist() == [0, 1]  # the third is too far away, the fourth over an edge
    assert settled.kind == "suction" and (settled.width == 0).all()
    np.testing.assert_allclose(settled.T_object_tcp[:, :3, 2], [[0, -1, 0]] * 2, atol=1e-9)
    np.testing.assert_allclose(settled.T_object_tcp[:, :3, :3], T[:2, :3, :3], atol=1e-9)  # the least turn
    center = settled.T_object_tcp[:, :3, 3]
    np.testing.assert_allclose(center[:, 1], THICKNESS / 2, atol=1e-9)
    along = center - tilted[:2, :3, 3]
    assert np.abs(np.cross(along, tilted[:2, :3, 2])).max() < 1e-9  # it moved along its approach
    assert projector.worst_grade(settled) == 0


def test_grades_decide_which_curvature_a_cup_may_settle_on() -> None:
    ball = ObjectModel("ball", trimesh.creation.icosphere(subdivisions=3, radius=0.04), ())
    projector = GraspProjector(ball, replace(load_end_effector("s1"), cup_radius=0.01))
    T, width = projector.anywhere(6, np.random.default_rng(0))
    assert T.shape == (6, 4, 4) and (width == 0).all()
    np.testing.assert_allclose(np.linalg.norm(T[:, :3, 3], axis=1), 0.04, rtol=0.02)
    assert (np.einsum("bi,bi->b", T[:, :3, 3], T[:, :3, 2]) < -0.038).all()
    assert [len(projector.settle(T, grade)[1]) for grade in (0, 1, 2)] == [0, 6, 6]
    held = projector.settle(T, 1)[0]
    assert projector.worst_grade(held) == 1
    sharp = ObjectModel("ball", trimesh.creation.icosphere(subdivisions=3, radius=0.012), ())
    assert GraspProjector(sharp, replace(load_end_effector("s1"), cup_radius=0.01)).worst_grade(held) == NO_SEAL - 1


def test_tool_poses_anywhere_hold_the_object_between_the_jaws(jaw: tuple[GraspProjector, np.ndarray]) -> None:
    projector, T = jaw
    poses, width = projector.anywhere(15, np.random.default_rng(1))
    assert poses.shape == (15, 4, 4) and width.shape == (15,)
    for side in (-0.5, 0.5):
        ends = poses[:, :3, 3] + side * width[:, None] * poses[:, :3, 1]
        assert np.abs(trimesh.proximity.signed_distance(PLATE.mesh, ends)).max() < 1e-9
    assert projector.worst_grade(GraspSet(T, np.full(len(T), THICKNESS), "parallel")) == 0


def test_the_pair_of_crossings_nearest_to_the_middle_is_taken():
    distance, facing = np.array([-0.020, 0.0, 0.012, 0.019]), np.array([-1.0, -1.0, 1.0, 1.0])
    assert _central_pair(distance, facing, 0.9, 0.1) == (0, 3)  # 0.5 mm off the middle; the narrowest is 6 mm off
    assert _central_pair(distance, facing, 0.9, 0.035) == (0, 2)
    assert _central_pair(distance, facing * 0.8, 0.9, 0.1) is None


def _across(x: float, z: float) -> np.ndarray:
    """Return a tool pose that approaches along -z and closes along y, its TCP at (x, 0, z) [m]."""
    T = np.diag([-1.0, 1.0, -1.0, 1.0])
    T[:3, 3] = x, 0.0, z
    return T


@pytest.mark.parametrize(
    ("mesh", "T", "failure"),
    [
        (PLATE.mesh, _across(0.0, 0.30), Failure.NOTHING_HELD),
        (PLATE.mesh, _across(0.4, 0.14), Failure.NOTHING_HELD),
        (trimesh.creation.box(extents=(0.3, 0.2, 0.3)), _across(0.0, 0.14), Failure.TOO_WIDE),
        (
            trimesh.convex.convex_hull([[x, y, z] for x in (-0.1, 0.1) for y, z in ((-0.1, 0), (0.1, 0), (0, 0.045))]),
            _across(0.0, 0.04),
            Failure.SLIPS,
        ),
        (PLATE.mesh, _across(0.0, 0.05), Failure.OVERLAP),
    ],
    ids=["above", "beside", "wide", "roof", "deep"],
)
def test_why_a_jaw_does_not_settle(mesh: trimesh.Trimesh, T: np.ndarray, failure: Failure) -> None:
    projector = GraspProjector(ObjectModel("part", mesh, ()), load_end_effector("w"))
    assert len(projector.settle(T)[0]) == 0
    assert projector.failures(T) == [failure]


def test_why_a_cup_does_not_settle() -> None:
    trough = trimesh.boolean.difference(
        [trimesh.creation.box(extents=(0.3, 0.3, 0.3)), trimesh.creation.box(bounds=[[-0.018, -1, 0], [0.018, 1, 1]])],
        engine="manifold",
    )
    projector = GraspProjector(ObjectModel("trough", trough, ()), load_end_effector("s1"))
    poses = np.array([_across(0.08, 0.25), _across(0.15 - 1e-3, 0.15), _across(0.0, 0.0)])
    assert projector.failures(poses, NO_SEAL - 1) == [Failure.NO_CONTACT, Failure.LEAKS, Failure.OVERLAP]
    assert len(projector.settle(poses, NO_SEAL - 1)[0]) == 0
