from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from trimesh.transformations import translation_matrix

from regrasp_opt.errors import MeshError, OptionError, UnknownNameError
from regrasp_opt.objects import OBJECT_NAMES, load_object

Maker = Callable[[], trimesh.Trimesh]


def box(side: float = 0.05, shift: float = 0.0) -> trimesh.Trimesh:
    return trimesh.creation.box(extents=(side, 1.2 * side, 1.4 * side), transform=translation_matrix([shift] * 3))


def raw(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def without_a_triangle() -> trimesh.Trimesh:
    return raw(box().vertices, box().faces[1:])


def one_face_flipped() -> trimesh.Trimesh:
    faces = box().faces.copy()
    faces[3] = faces[3][::-1]
    return raw(box().vertices, faces)


def inside_out() -> trimesh.Trimesh:
    return raw(box().vertices, box().faces[:, ::-1])


def flat() -> trimesh.Trimesh:
    return raw(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2], [0, 2, 1]]))


def two_apart() -> trimesh.Trimesh:
    return trimesh.util.concatenate([box(), box(shift=0.2)])


def two_overlapping() -> trimesh.Trimesh:
    return trimesh.util.concatenate([box(), box(shift=0.02)])


def one_of_two_inside_out() -> trimesh.Trimesh:
    inverted = box(shift=0.2)
    inverted.invert()
    return trimesh.util.concatenate([box(), inverted])


def with_nan() -> trimesh.Trimesh:
    vertices = box().vertices.copy()
    vertices[0, 0] = np.nan
    return raw(vertices, box().faces)


def half_open() -> trimesh.Trimesh:
    tube = trimesh.creation.cylinder(radius=0.03, height=0.02, sections=40)
    tube.update_faces(np.abs(tube.face_normals[:, 2]) < 0.5)
    return tube


def without_a_cap() -> trimesh.Trimesh:
    tube = trimesh.creation.cylinder(radius=0.02, height=0.1, sections=40)
    tube.update_faces(tube.face_normals[:, 2] < 0.5)
    return tube


def without_a_side() -> trimesh.Trimesh:
    return raw(box().vertices, box().faces[box().face_normals[:, 2] < 0.5])


def with_a_fin() -> trimesh.Trimesh:
    return raw(
        np.vstack([box().vertices, [[0.025, 0, 0], [0.025, 0, 0.02], [0.09, 0, 0]]]),
        np.vstack([box().faces, [[8, 9, 10]]]),
    )


def box_in_a_thousand_folds() -> trimesh.Trimesh:
    corners = np.random.default_rng(0).uniform(-0.05, 0.05, (1500, 3))
    return raw(corners, np.arange(1500).reshape(-1, 3))


def doubled_faces() -> trimesh.Trimesh:
    return raw(box().vertices, np.vstack([box().faces, box().faces[:2]]))


def cracked() -> trimesh.Trimesh:
    noise = np.random.default_rng(0).uniform(-1e-8, 1e-8, (36, 3))
    return raw(box().triangles.reshape(-1, 3) + noise, np.arange(36).reshape(-1, 3))


def save(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


@pytest.mark.parametrize("name", OBJECT_NAMES)
def test_built_in_objects_are_graspable_solids(name: str) -> None:
    model = load_object(name)
    assert model.source == "built-in" and model.name == name
    assert model.mesh.is_volume and model.mesh.body_count == 1 and len(model.faces) <= 3000
    assert sorted(model.mesh.extents)[0] < 0.094 and model.mesh.extents.max() <= 0.2
    assert model.vertices.min(axis=0)[2] == pytest.approx(0.0, abs=1e-12)
    again = load_object(name)
    assert np.array_equal(model.vertices, again.vertices) and np.array_equal(model.faces, again.faces)
    for a, b in zip(model.placements, again.placements, strict=True):
        assert np.array_equal(a.pose, b.pose)


def test_fingerprints_follow_the_geometry(tmp_path: Path) -> None:
    models = [load_object(name) for name in OBJECT_NAMES]
    assert len({model.fingerprint() for model in models}) == len(models)
    copied = load_object(save(box(), tmp_path / "a.ply"))
    assert copied.fingerprint() == load_object(save(box(), tmp_path / "b.ply")).fingerprint()
    assert copied.fingerprint() != load_object(save(box(0.051), tmp_path / "a.ply")).fingerprint()
    with pytest.raises(ValueError, match="read-only"):
        copied.vertices[0] = 0.0


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "STL"])
def test_every_format_gives_the_same_solid(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"part.{suffix}"
    path.write_bytes(exported(suffix.lower()))
    model = load_object(path)
    assert (model.name, model.source, len(model.placements)) == ("part", str(path), 6)
    assert model.mesh.volume == pytest.approx(0.05**3 * 1.2 * 1.4, rel=1e-6)
    np.testing.assert_allclose(model.center_of_mass, 0.0, atol=1e-8)


def test_scale_turns_millimetres_into_metres(tmp_path: Path) -> None:
    path = save(box(50.0), tmp_path / "part.stl")
    assert load_object(path, scale=0.001).mesh.volume == pytest.approx(box().volume, rel=1e-6)
    assert load_object("pentagon", scale=2.0).mesh.extents.max() == pytest.approx(
        2 * load_object("pentagon").mesh.extents.max()
    )
    for scale in (0.0, -1.0, float("nan")):
        with pytest.raises(OptionError, match="scale"):
            load_object(path, scale=scale)
        with pytest.raises(OptionError, match="scale"):
            load_object("mug", scale=scale)
    with pytest.raises(MeshError, match="inf m long"):
        load_object(path, scale=1e308)
    for scale in (1e-320, 0.01, 100.0, 1e308):
        with pytest.raises(OptionError, match="give one that makes it"):
            load_object("mug", scale=scale)


@pytest.mark.parametrize(
    ("longest", "refusal"),
    [(0.0045, "--scale 1000"), (0.0055, None), (1.95, None), (2.05, r"--scale 0\.001")],
)
def test_objects_of_5_mm_to_2_m_are_taken_as_they_are(tmp_path: Path, longest: float, refusal: str | None) -> None:
    path = save(box(longest / 1.4), tmp_path / "part.stl")
    if refusal is None:
        assert load_object(path).mesh.extents.max() == pytest.approx(longest, rel=1e-6)
        return
    with pytest.raises(MeshError, match=refusal):
        load_object(path)


@pytest.mark.parametrize(
    ("make", "suffix", "expected"),
    [
        (without_a_triangle, "stl", "not watertight; close its surface or try --repair$"),
        (half_open, "stl", "not watertight.*--repair"),
        (doubled_faces, "ply", "not watertight.*--repair"),
        (cracked, "stl", "not watertight.*--repair"),
        (one_face_flipped, "ply", "inconsistent winding.*--repair"),
        (inside_out, "stl", "inside out.*--repair"),
        (one_of_two_inside_out, "stl", "inside out.*--repair"),
        (flat, "ply", "no volume.*--thickness"),
        (with_nan, "stl", "NaN"),
        (with_nan, "ply", "NaN"),
        (lambda: box(50.0), "stl", r"millimetres; pass --scale 0\.001"),
        (lambda: box(5e-5), "ply", "--scale 1000"),
    ],
)
def test_bad_meshes_are_refused_in_one_sentence(tmp_path: Path, make: Maker, suffix: str, expected: str) -> None:
    path = save(make(), tmp_path / f"part.{suffix}")
    with pytest.raises(MeshError, match=expected) as caught:
        load_object(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "suffix", "volume"),
    [
        (without_a_triangle, "stl", box().volume),
        (one_face_flipped, "ply", box().volume),
        (inside_out, "stl", box().volume),
        (doubled_faces, "ply", box().volume),
        (cracked, "stl", box().volume),
        (one_of_two_inside_out, "stl", 2 * box().volume),
        (two_overlapping, "stl", 2 * box().volume - 0.03 * 0.04 * 0.05),
        (box, "stl", box().volume),
    ],
)
def test_repair_gives_the_solid_that_was_meant(tmp_path: Path, make: Maker, suffix: str, volume: float) -> None:
    model = load_object(save(make(), tmp_path / f"part.{suffix}"), repair=True)
    assert model.mesh.is_volume
    assert model.mesh.volume == pytest.approx(volume, rel=1e-5)


@pytest.mark.parametrize(
    ("make", "suffix", "expected"),
    [
        (half_open, "stl", "too large to close.*--thickness"),
        (without_a_cap, "stl", "too large to close.*--thickness"),
        (without_a_side, "stl", "too large to close.*--thickness"),
        (flat, "ply", "too few faces"),
        (with_a_fin, "ply", "encloses nothing"),
        (box_in_a_thousand_folds, "ply", "too much surface"),
    ],
)
def test_repair_refuses_what_it_would_have_to_invent(tmp_path: Path, make: Maker, suffix: str, expected: str) -> None:
    with pytest.raises(MeshError, match=expected):
        load_object(save(make(), tmp_path / f"part.{suffix}"), repair=True)


def exported(suffix: str) -> bytes:
    content = box().export(file_type=suffix)
    return content if isinstance(content, bytes) else content.encode()


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
@pytest.mark.parametrize("damage", ["empty", "garbage", "truncated"])
def test_broken_files_are_refused(tmp_path: Path, suffix: str, damage: str) -> None:
    path = tmp_path / f"part.{suffix}"
    whole = exported(suffix)
    path.write_bytes(
        {"empty": b"", "garbage": b"\x00\x01garb\xffage" * 30, "truncated": whole[: len(whole) // 2]}[damage]
    )
    with pytest.raises(MeshError) as caught:
        load_object(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_names_and_paths_that_lead_nowhere(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError) as caught:
        load_object("botle")
    assert caught.value.alternatives[0] == "bottle" and set(caught.value.alternatives) == set(OBJECT_NAMES)
    with pytest.raises(MeshError, match="does not exist"):
        load_object("missing.stl")
    with pytest.raises(MeshError, match=r"\.stl, \.obj, \.ply, \.glb"):
        load_object(tmp_path / "part.step")
    with pytest.raises(MeshError):
        load_object(tmp_path)
