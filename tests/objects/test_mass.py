"""Mass properties: what is given as arguments and beside the mesh, what follows from it, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from regrasp_opt import RegraspProblem
from regrasp_opt.errors import OptionError
from regrasp_opt.objects import load_object

EDGE, LENGTH = 0.028, 0.30
THIRD = (0.0, 0.0, -0.05)
"""The centre of mass of a rod that is heavier at its lower end."""


@pytest.fixture
def rod(tmp_path: Path) -> Path:
    path = tmp_path / "rod.stl"
    trimesh.creation.box((EDGE, EDGE, LENGTH)).export(path)
    return path


def beside(rod: Path, text: str) -> None:
    rod.with_suffix(".toml").write_text(text, "utf-8")


def test_placements_and_margins_follow_the_centre_of_mass(rod: Path) -> None:
    uniform, heavy = load_object(rod), load_object(rod, mass=1.0, center_of_mass=THIRD)
    np.testing.assert_allclose([p.margin for p in uniform.placements], 4 * [1.0], rtol=1e-6)
    np.testing.assert_allclose([p.margin for p in heavy.placements], 4 * [1.0] + [EDGE / 2 / (LENGTH / 3)], rtol=1e-6)
    for placement in heavy.placements:
        center = placement.pose[:3, :3] @ heavy.center_of_mass + placement.pose[:3, 3]
        np.testing.assert_allclose(center[:2], 0.0, atol=1e-9)
    on_end = heavy.placements[4].pose
    assert not heavy.rolls(on_end) and on_end[2, 2] == pytest.approx(1.0)
    np.testing.assert_allclose(on_end[2, 3], LENGTH / 2, atol=1e-7)


def test_only_a_centre_of_mass_that_is_not_the_uniform_one_changes_the_fingerprint(rod: Path) -> None:
    plain = load_object(rod).fingerprint()
    same: list[dict[str, Any]] = [
        {"mass": 1.0}, {"density": 700.0}, {"center_of_mass": [1e-8, 0, 0]},
        {"mass": 1.0, "inertia": 1e-4 * np.diag([50, 50, 1])},
    ]  # fmt: skip
    assert {load_object(rod, **given).fingerprint() for given in same} == {plain}
    assert load_object(rod, center_of_mass=THIRD).fingerprint() != plain
    with_mass = RegraspProblem.load("bottle", mass=0.3)
    assert with_mass.model_folder == RegraspProblem.load("bottle").model_folder is not None


def test_mass_density_and_inertia(rod: Path) -> None:
    volume = EDGE**2 * LENGTH
    bare, known = load_object(rod), load_object(rod, mass=1.0)
    assert (bare.mass, bare.inertia) == (None, None)
    expected = np.diag([EDGE**2 + LENGTH**2, EDGE**2 + LENGTH**2, 2 * EDGE**2]) / 12
    assert known.inertia is not None
    np.testing.assert_allclose(known.inertia, expected, rtol=1e-6, atol=1e-12)
    assert load_object(rod, density=800.0).mass == pytest.approx(800 * volume, rel=1e-6)
    assert load_object("mug", scale=1.1, mass=0.3).mass == 0.3
    given = np.diag([5e-3, 5.05e-3, 1e-4])
    np.testing.assert_array_equal(np.array(load_object(rod, mass=1.0, inertia=given).inertia), given)


def test_a_file_beside_the_mesh_is_read(rod: Path) -> None:
    beside(rod, "schema = 1\nmass = 1\ncenter_of_mass = [0.0, 0.0, -0.05]\n")
    model = load_object(rod)
    assert model.mass == 1.0 and len(model.placements) == 5
    np.testing.assert_array_equal(model.center_of_mass, THIRD)
    assert load_object(rod, mass=1.0, inertia=1e-4 * np.diag([50, 50, 1])).given.given().keys() == {
        "mass", "center_of_mass", "inertia"
    }  # fmt: skip


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"mass": 0.0}, r"'rod': key 'mass': should be greater than 0, not 0"),
    ({"density": -1.0}, r"'density': should be greater than 0"),
    ({"mass": float("nan")}, r"'mass': should be a finite number"),
    ({"center_of_mass": [0, 0]}, r"'center_of_mass.2' is missing"),
    ({"mass": 1.0, "density": 3.0}, r"mass 1 kg and density 3 kg/m3 of 'rod' disagree.*give one of them"),
    ({"center_of_mass": [0, 0, 0.16]}, r"\(0, 0, 0.16\) m, is not inside its convex hull; give it in metres"),
    ({"center_of_mass": [0, 0, -0.15]}, r"not inside its convex hull"),
    ({"inertia": np.eye(3)}, r"inertia of 'rod' is given without a mass"),
    ({"mass": 1.0, "inertia": np.triu(np.ones((3, 3)))}, r"not symmetric"),
    ({"mass": 1.0, "inertia": np.diag([1e-3, 1e-3, 3e-3])}, r"no rigid body: its principal moments are 0.001, 0.001"),
    ({"mass": 1.0, "inertia": np.diag([0.0, 1e-3, 1e-3])}, r"must be positive"),
    ({"mass": 1.0, "inertia": np.diag([30.0, 30.0, 0.6])}, r"too large for 1 kg.*give it in kg m2"),
    ({"mass": 1.0, "inertia": np.diag([7.5e-3, 7.5e-3, 1e-3])}, r"too large for 1 kg"),
]


@pytest.mark.parametrize(("given", "why"), WRONG, ids=[why[:25] for _, why in WRONG])
def test_what_no_rigid_body_has_is_refused_in_one_sentence(rod: Path, given: dict[str, Any], why: str) -> None:
    with pytest.raises(OptionError, match=why) as info:
        load_object(rod, **given)
    assert "\n" not in str(info.value)


FILES = [
    ("schema = 1\nmas = 1", r"in '.*rod\.toml': unknown key 'mas'; allowed: mass"),
    ("mass = 1", r"key 'schema' is missing"),
    ("schema = 2\nmass = 1", r"key 'schema'"),
    ("schema = 1\nmass = 0 kg", r"rod\.toml' is not valid TOML"),
    (
        "schema = 1\nmass = 2",
        r"mass of 'rod' is given as 1\.0 but is 2\.0 in '.*rod\.toml'; omit it or change the file",
    ),
    ("schema = 1\ndensity = 9", r"mass 1 kg and density 9 kg/m3 of 'rod' disagree"),
]


@pytest.mark.parametrize(("text", "why"), FILES, ids=[text for text, _ in FILES])
def test_a_wrong_file_or_one_that_disagrees_is_named(rod: Path, text: str, why: str) -> None:
    beside(rod, text)
    with pytest.raises(OptionError, match=why):
        load_object(rod, mass=1.0)


def test_a_file_that_is_not_text_is_refused(rod: Path) -> None:
    rod.with_suffix(".toml").write_bytes(b"\xff\xfe")
    with pytest.raises(OptionError, match="cannot be read"):
        load_object(rod)


def test_an_object_that_is_loaded_already_takes_no_more(rod: Path) -> None:
    for option in ({"mass": 1.0}, {"scale": 2.0}, {"repair": True}, {"center_of_mass": np.zeros(3)}):
        with pytest.raises(OptionError, match=rf"'rod' is loaded already; give {next(iter(option))} to load_object"):
            RegraspProblem.load(load_object(rod), **option)
