"""Plans and motions in memory, handed to the verifiers as what a file would hold, in cells changed by tests."""

import numpy as np
from oracles.files import Board, Cell, Nest, Shape, Tool, read_urdf
from oracles.motions import MotionVerifier
from oracles.plans import TOLERANCE, PlanVerifier

from regrasp_opt.motion.trajectory.motion_plan import motion_content
from regrasp_opt.planning.plan_file import plan_content


def shape_of(shape):
    """Return a box, cylinder or mesh of the package as one of the verifiers."""
    if hasattr(shape, "vertices"):
        return Shape(shape.name, "mesh", shape.pose, None, np.array(shape.vertices), np.array(shape.faces))
    if hasattr(shape, "radius"):
        return Shape(shape.name, "cylinder", shape.pose, (shape.radius, shape.length))
    return Shape(shape.name, "box", shape.pose, shape.size)


def pad_of(effector):
    """Return the (low, high) corners in x and z of the pad, or None of a suction cup."""
    pad = getattr(effector, "pad", None)
    return None if pad is None else np.array([pad.x, pad.z], dtype=float).T


def support_of(support):
    """Return a board or fixture of the package as one of the verifiers."""
    if hasattr(support, "poses"):
        held = [(support.T_world_support @ pose.T_support_object, pose.object) for pose in support.poses]
        return Nest(support.name, [shape_of(shape) for shape in support.shapes], held)
    T, space = np.array(support.T_world_support), {"x": support.workspace.x, "y": support.workspace.y}
    T[:3, 3] += T[:3, :2] @ support.center
    return Board(support.name, T, support.center, support.size, support.thickness, space)


def cell_of(workcell):
    """Return a workcell of the package, perhaps changed in memory, as the verifiers would read it from its files."""
    robot, effector = workcell.robot, workcell.end_effector
    fingers = [np.array([box.pose[:3, 3] - box.size / 2, box.pose[:3, 3] + box.size / 2]) for box in effector.finger]
    lengths = effector.tcp_offset, effector.pre_opening, effector.cup_radius, effector.max_opening
    near = workcell.clearance
    return Cell(
        path=None,
        T_world_base=workcell.T_world_base,
        robot=read_urdf(robot.urdf_path, robot.tip_frame, content=robot.urdf),
        tool=Tool(effector.kind, *lengths, [shape_of(shape) for shape in effector.body], fingers, pad_of(effector)),
        supports=[support_of(support) for support in workcell.supports],
        obstacles=[shape_of(shape) for shape in workcell.obstacles],
        clearance={name: getattr(near, name) for name in ("arm", "gripper", "self_collision")},
        ignored=set(robot.ignored),
    )


def plan_verifier(problem, tolerance=TOLERANCE):
    """Return a verifier of plans for `problem`."""
    return body_verifier(problem.object, problem.workcell, tolerance)


def body_verifier(body, workcell, tolerance=TOLERANCE):
    """Return a verifier of what is done with an object of the package in one of its workcells."""
    mesh = np.array(body.vertices), np.array(body.faces)
    return PlanVerifier(None, cell_of(workcell), mesh, tolerance, body.name)


class PlainCheck:
    """Feasibility of one (pose, grasp) pair as a plain loop over the branches of the inverse kinematics.

    Inverse kinematics is the package's; where bodies are, and what they meet, is the verifier's. Like the check, it
    believes the sampler of grasps that the hand is clear of the object.
    """

    def __init__(self, body, workcell, grasps):
        self.workcell, self.grasps = workcell, grasps
        self.verifier = body_verifier(body, workcell, tolerance=0.0)
        parts = [body.part for body in self.verifier.world.bodies]
        by_design = {"palm", "object"}, {"open", "object"}
        self.verifier.test(pair for pair in self.verifier.pairs if {parts[pair[0]], parts[pair[1]]} not in by_design)

    def collisions(self, q, T, grasp_id):
        """Return what is too near at configuration `q` (dof,)."""
        return self.verifier.collisions(q, T, float(self.grasps.width[grasp_id]))

    def free(self, q, T, grasp_id):
        return not self.verifier.collisions(q, T, float(self.grasps.width[grasp_id]), all_of_them=False)

    def clearance(self, q, T, grasp_id):
        """Return the least distance of arm and gripper to what is around them [m], and between which parts."""
        return self.verifier.clearance(q, T, float(self.grasps.width[grasp_id]))

    def feasible(self, T, grasp_id):
        cell = self.workcell
        T_world_flange = T @ self.grasps.T_object_tcp[grasp_id] @ cell.end_effector.T_tcp_flange
        branches = cell.robot.solve_ik(np.linalg.inv(cell.T_world_base) @ T_world_flange).q
        return any(self.free(q, T, grasp_id) for q in branches)


def plan_problems(plan, rows=None, verifier=None):
    """Return what the verifier finds wrong with `plan`."""
    return (verifier or plan_verifier(plan.problem)).problems(plan_content(plan), rows)


def motion_findings(motion, verifier=None, **steps):
    """Return what the verifier finds out about `motion`."""
    content = motion_content(motion)
    return MotionVerifier(content, verifier or plan_verifier(motion.plan.problem)).verify(content, **steps)
