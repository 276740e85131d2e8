"""Whether an object stands: heights to the tenth of a millimetre, edges of the table, and tipping over."""

import numpy as np
import pytest

from regrasp_opt.feasibility.standing import resting_problem, standing_problem
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, mesh_geometry, shape_geometry
from regrasp_opt.scene import Support

HEIGHT = 0.2
CORNERS = np.array(np.meshgrid([-0.03, 0.03], [-0.02, 0.02], [0.0, 0.1])).reshape(3, -1).T
MIDDLE = np.array([0.0, 0.0, 0.05])


@pytest.fixture(scope="module")
def table():
    return Support.table(HEIGHT, np.array([0.1, 0.4]), np.array([0.6, 0.4]), 0.05)


def at(x=0.1, y=0.4, gap=0.0):
    return np.array([x, y, HEIGHT + gap])


@pytest.mark.parametrize(
    ("gap", "standing", "resting"),
    [
        (0.0, None, None),
        (0.0009, None, None),
        (-0.0009, None, None),
        (-0.0011, "sinks 1.1 mm into the table", "sinks 1.1 mm into the table"),
        (-0.05, "sinks 50.0 mm into the table", "sinks 50.0 mm into the table"),
        (0.0011, None, "floats 1.1 mm above the table"),
        (0.3, None, "floats 300.0 mm above the table"),
    ],
)
def test_heights(table, gap, standing, resting):
    offset = at(gap=gap)
    assert standing_problem(CORNERS + offset, table) == standing
    assert resting_problem(CORNERS + offset, MIDDLE + offset, table) == resting


@pytest.mark.parametrize(
    ("x", "y", "over"),
    [(-0.169, 0.4, 0), (-0.171, 0.4, 1), (0.369, 0.4, 0), (0.371, 0.4, 1), (0.1, 0.221, 0), (0.1, 0.219, 1),
     (0.1, 0.579, 0), (0.1, 0.581, 1), (5.0, 5.0, 1)],
)  # fmt: skip
def test_the_edges_of_the_table(table, x, y, over):
    said = "stands over the edge of the table" if over else None
    assert standing_problem(CORNERS + at(x, y), table) == said
    assert resting_problem(CORNERS + at(x, y), MIDDLE + at(x, y), table) == said
    assert standing_problem(CORNERS + at(x, y, gap=0.05), table) is None  # what hovers stands on no edge


@pytest.mark.parametrize(
    ("x", "y", "tips"), [(0.0, 0.0, 0), (0.029, 0.019, 0), (0.031, 0.0, 1), (-0.031, 0.0, 1), (0.0, 0.021, 1)]
)
def test_a_centre_of_mass_outside_the_support_tips_over(table, x, y, tips):
    center = np.array([x, y, 0.05]) + at()
    assert resting_problem(CORNERS + at(), center, table) == ("would tip over" if tips else None)


@pytest.mark.parametrize("lowest", [[[0, 0]], [[-0.03, 0], [0.03, 0]], [[-0.03, 0], [0, 0], [0.03, 0]]])
def test_nothing_rests_on_a_point_or_an_edge(table, lowest):
    touching = np.column_stack([lowest, np.zeros(len(lowest))])
    vertices = np.vstack([touching, CORNERS + np.array([0.0, 0.0, 0.05])])
    assert resting_problem(vertices + at(), MIDDLE + at(), table) == "would tip over"


def test_shapes_have_their_size_as_collision_bodies():
    pose = np.eye(4)
    np.testing.assert_allclose(shape_geometry(Box("a", np.array([0.1, 0.2, 0.3]), pose)).halfSide, [0.05, 0.1, 0.15])
    cylinder = shape_geometry(Cylinder("a", 0.03, 0.4, pose))
    assert (cylinder.radius, cylinder.halfLength) == (0.03, 0.2)
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    for mesh in (mesh_geometry(CORNERS, faces), shape_geometry(Mesh("a", CORNERS, faces, pose))):
        assert (mesh.num_vertices, mesh.num_tris) == (8, 2)
        np.testing.assert_allclose(mesh.vertices(), CORNERS)
