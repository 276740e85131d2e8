"""DAE files: units, places, kinds of faces, and what is refused."""

import random
from contextlib import suppress
from functools import partial

import numpy as np
import pytest
import trimesh
from dae_files import collada, polygons, polylist, triangles

from regrasp_opt.errors import MeshError
from regrasp_opt.geometry.mesh_files import read_triangles

BOX = trimesh.creation.box((0.1, 0.2, 0.3))
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.1, 0.2, 0.3]
WHOLE = partial(triangles, BOX.faces.tolist())


def read(tmp_path, text):
    path = tmp_path / "part.dae"
    path.write_text(text, encoding="utf-8")
    vertices, faces = read_triangles(path)
    return trimesh.Trimesh(vertices, faces)


@pytest.mark.parametrize(
    ("unit", "meter"),
    [
        ("", 1),
        ('<unit name="mm" meter="0.001"/>', 0.001),
        ('<unit name="inch" meter="0.0254"/>', 0.0254),
        ("<unit/>", 1),
    ],
)
@pytest.mark.parametrize("up_axis", ["Z_UP", "Y_UP", "X_UP"])
def test_lengths_are_in_the_unit_of_the_file_and_axes_those_of_the_file(tmp_path, unit, meter, up_axis):
    place = "<translate>0.4 0 0</translate>"
    mesh = read(
        tmp_path, collada([(BOX.vertices / meter, WHOLE, place.replace("0.4", repr(0.4 / meter)))], unit, up_axis)
    )
    np.testing.assert_allclose(mesh.bounds, BOX.bounds + np.array([0.4, 0, 0]), atol=1e-12)
    assert mesh.volume == pytest.approx(BOX.volume)


@pytest.mark.parametrize("kind", [polylist, polygons, partial(polygons, kind="trifans")])
def test_polygons_and_fans_are_cut_into_triangles(tmp_path, kind):
    mesh = read(tmp_path, collada([(CORNERS, partial(kind, QUADS), "")]))
    assert mesh.is_watertight and abs(mesh.volume) == pytest.approx(0.006) and len(mesh.faces) == 12


def test_strips_turn_every_second_triangle(tmp_path):
    strip = [[0, 1, 2, 3, 6, 7, 4, 5, 0, 1]]
    mesh = read(tmp_path, collada([(CORNERS, partial(polygons, strip, kind="tristrips"), "")]))
    assert mesh.is_winding_consistent and mesh.area == pytest.approx(2 * (0.1 * 0.3 + 0.2 * 0.3))


def test_parts_lie_where_their_nodes_put_them(tmp_path):
    places = [
        "<rotate>0 0 1 90</rotate><translate>1 0 0</translate>",
        "<matrix>1 0 0 0 0 1 0 0 0 0 1 2 0 0 0 1</matrix>",
    ]
    places.append("<scale>2 1 1</scale><translate>5 0 0</translate>")
    mesh = read(tmp_path, collada([(BOX.vertices, WHOLE, place) for place in places]))
    centers = [part.centroid for part in mesh.split()]
    expected = [[0, 1, 0], [0, 0, 2], [10, 0, 0]]
    np.testing.assert_allclose(sorted(map(tuple, np.round(centers, 9))), sorted(map(tuple, expected)), atol=1e-9)
    assert mesh.is_watertight and mesh.volume == pytest.approx(4 * BOX.volume)


GOOD = collada([(BOX.vertices, WHOLE, "")])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("</COLLADA>", "", "corrupt"),
        ("#g0", "#g7", "corrupt"),
        ('meter="1"', 'meter="many"', "corrupt"),
        ('meter="1"', 'meter="nan"', "NaN or infinite"),
        ("<p>0 1", "<p>0 99", "whose vertices do not exist"),
        ("<p>0 1", "<p>0", "corrupt"),
        ('<instance_geometry url="#g0"/>', "", "no triangles"),
        ('<instance_geometry url="#g0"/>', '<instance_node url="#n0"/>', "corrupt"),
        ('<instance_geometry url="#g0"/>', '<instance_controller url="#g0"/>', "<instance_controller>"),
        ("triangles", "splinegroup", "<splinegroup>"),
    ],
)
def test_what_is_not_read_is_refused(tmp_path, old, new, said):
    assert old in GOOD
    with pytest.raises(MeshError, match=said):
        read(tmp_path, GOOD.replace(old, new))


def test_damaged_files_are_read_or_refused(tmp_path):
    rng = random.Random(0)
    for _ in range(150):
        data = list(GOOD)
        for _ in range(rng.randint(1, 6)):
            where = rng.randrange(len(data))
            data[where : where + rng.randint(0, 3)] = rng.choice(["", "9", "-", " ", "<", "e99"])
        with suppress(MeshError):
            read(tmp_path, "".join(data))
