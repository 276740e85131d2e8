"""The command line under fuzzing: lists of words, run in a folder of their own among good files that they may name."""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from regrasp_opt.errors import OptionError
from regrasp_opt.motion import plan_motion
from regrasp_opt.objects.builtin import build
from regrasp_opt.planning import RegraspProblem, solve_sequence

from .trials import write_obstacles

_APP = "regrasp_opt.cli.app"
"""The command line; it stands above this layer and is looked up by name."""
_FILES = "files"
_PLAN, _MOTION, _MESH, _CELL = "plan.json", "motion.json", "part.stl", "cell.toml"
_GRASPS, _OBSTACLES = "grasps.csv", "obstacles.toml"
_LINES = (
    "plan --start 0:-0.2,0.4,30 --goal 2:0.25,0.3,180 --max-regrasps 2 --out new.json",
    "plan --object mug --workcell nova2-w --start 0:-0.2,0.4,30 --goal 1:0.25,0.3,180 --refiner lattice --json",
    f"plan --object bottle --workcell {_CELL} --end-effector w --seed 3 --html new.html",
    "plan --object pentagon --seed 4 --max-regrasps 1 --json",
    f"plan --object {_MESH} --scale 1.0 --repair --model models --seed 1",
    f"plan --object {_MESH} --mass 0.4 --center-of-mass 0,0,0.01 --inertia 2e-4,0,0,2e-4,0,2e-4 --tolerance 0.01,5",
    "plan --placements 0,1 --supports table --from-above 60 --num-regrasps 1 --alternatives 1 --symmetry",
    f"plan --grasps {_GRASPS} --grasp-near 0.01,10 --seed 2 --out new.json",
    f"plan --obstacles {_OBSTACLES} --explain --seed 5",
    f"inspect --workcell {_CELL} --object {_MESH} --density 900 --pose 0:0.1,0.3,20 --html new.html --json",
    f"check {_PLAN} --json",
    f"motion {_PLAN} --csv new.csv --step 0.02 --velocity 0.8 --acceleration 4.0 --no-home --seed 1 --scene scene",
    f"motion {_PLAN} --ros new.yaml --moveit scenes.yaml --mjcf model --jerk 100 --squeeze 0.002 --force 20 --json",
    f"show {_PLAN} --motion {_MOTION} --json",
    f"show {_PLAN} --candidates ipopt --port 8081",
    "export bottle-nova2-w --to casadi --json",
    f"prepare {_CELL} --object {_MESH} --grasps 50 --seed 2 --jobs 1 --scale 1.0 --repair --out model --json",
    "bench one-step --quick --jobs 1 --seed 1 --out results --json",
    "--version",
)
_CRATE = '[[obstacles]]\nname = "crate"\ntype = "box"\nsize = [0.1, 0.1, 0.2]\nposition = [0.3, 0.5, 0.1]\n'
_HARMLESS = {
    "plan": ("--time-limit", "1"),
    "show": ("--html", "new.html"),
    "export": ("--out", "energy.casadi"),
    "prepare": ("--samples", "0"),
    "bench": ("--objects", "none"),
}
"""What is put at the end of a line with this command: no long search, served page, training or experiment begins."""


def command_lines(folder: Path) -> list[tuple[str, bytes]]:
    """Return good command lines, each as a JSON list of words; the files that they name are put into `folder`."""
    place = folder / _FILES
    place.mkdir(exist_ok=True)
    problem = RegraspProblem.load("bottle", "nova2-w")
    plan = solve_sequence(problem, problem.pose(0, 0.2, 0.35), problem.pose(2, -0.2, 0.35, 0.3))
    plan.save(place / _PLAN)
    plan_motion(plan).save(place / _MOTION)
    build("pentagon").export(place / _MESH)
    write_obstacles(place / _CELL)
    problem.grasps.save(place / _GRASPS)
    (place / _OBSTACLES).write_text(_CRATE, encoding="utf-8")
    return [(".json", json.dumps(line.split()).encode()) for line in _LINES]


def run_command_line(path: Path) -> None:
    """Run the words in the file `path` as arguments of `regrasp-opt`, in a copy of the folder of files beside it.

    Raises
    ------
    OptionError
        If the command line refuses them as it should: exit code 2, its last line on stderr a sentence, nothing changed.
    RuntimeError
        For any other failure, and if a file changed that is not named.
    """
    words = [str(word) for word in json.loads(path.read_bytes())]
    words += [word for command, end in _HARMLESS.items() if command in words for word in end]
    errors = io.StringIO()
    with tempfile.TemporaryDirectory(dir=path.parent.parent) as place:
        folder = Path(place)
        shutil.copytree(path.parent.parent / _FILES, folder, dirs_exist_ok=True)
        before = _contents(folder)
        with _inside(folder), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            code = importlib.import_module(_APP).run(words)
        after = _contents(folder)
    said = (errors.getvalue().strip().splitlines() or [""])[-1]
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    named = {Path(word).parts[:1] for word in words}  # "." names the folder, and so what is new in it
    unnamed = {name for name in changed if (name,) not in named and (() not in named or name in before)}
    if code not in (0, 1, 2) or "internal error" in said or "Traceback" in errors.getvalue():
        raise RuntimeError(f"exit {code}: {said}")
    if unnamed or (code == 2 and changed & before.keys()):
        raise RuntimeError(f"exit {code}, but it changed {sorted(changed)}")
    if code == 2:
        if not said.startswith("error: "):
            raise RuntimeError(f"exit 2, but the last line is not an error: {said}")
        raise OptionError(said)


def _contents(folder: Path) -> dict[str, object]:
    """Return what lies in `folder`: content by name, for folders the names in them."""
    return {
        path.name: path.read_bytes() if path.is_file() else sorted(map(str, path.rglob("*")))
        for path in folder.iterdir()
    }


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Work in `folder`, with the folder ``home`` beside it for the data folder."""
    before, home = Path.cwd(), os.environ.get("REGRASP_OPT_HOME")
    os.environ["REGRASP_OPT_HOME"] = str(folder.parent / "home")
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
        if home is None:
            del os.environ["REGRASP_OPT_HOME"]
        else:
            os.environ["REGRASP_OPT_HOME"] = home
