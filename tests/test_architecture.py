"""The house rules that code can check: layers, packages, size of modules, laziness."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import networkx
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "regrasp_opt"
LAYERS = [
    {"conventions", "errors", "files", "notebook", "schemas", "threads", "workers"},
    {"geometry"},
    {"objects", "end_effectors", "robots"},
    {"scene"},
    {"grasps"},
    {"feasibility"},
    {"energy"},
    {"connectivity"},
    {"solvers"},
    {"planning"},
    {"motion"},
    {"benchmarks", "viz", "io"},
    {"cli"},
]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}
MODULES = sorted(PACKAGE.rglob("*.py")) + sorted((PACKAGE / "solvers").glob("*.py"))
ROBOT_FREE = {"solvers": {"objects", "end_effectors", "robots", "scene", "feasibility", "planning"}}


def _layer_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _module(path: Path) -> str:
    parts = ("regrasp_opt", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imported_modules(path: Path, known: set[str]) -> set[str]:
    """Return the modules of the package that a module imports anywhere, in functions and for types as well."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("regrasp_opt"):
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (inner & known) or {node.module}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & known


def _imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("regrasp_opt"):
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("regrasp_opt.")}
    return found & set(RANK)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_import_from_lower_layers_only(path):
    layer = _layer_of(path)
    if layer == "__init__":
        return
    above = {other for other in _imports(path) if other != layer and RANK[other] >= RANK[layer]}
    assert not above - LAYERS[0], f"{path} imports {above}"
    assert not _imports(path) & ROBOT_FREE.get(layer, set())


def test_no_import_cycles():
    modules = {_module(path): path for path in MODULES}
    graph = networkx.DiGraph()
    for name, path in modules.items():
        if name != "regrasp_opt":  # it names its parts, lazily
            graph.add_edges_from((name, other) for other in _imported_modules(path, set(modules)) - {"regrasp_opt"})
    assert not [sorted(ring) for ring in networkx.strongly_connected_components(graph) if len(ring) > 1]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_are_short(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_functions_fit_a_screen(path):
    functions = [n for n in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(n, ast.FunctionDef)]
    assert not [n.name for n in functions if (n.end_lineno or n.lineno) - n.lineno + 1 > 80]


def test_public_classes_have_names_of_their_own():
    trees = [ast.parse(path.read_text("utf-8")) for path in {path.resolve() for path in MODULES}]
    names = [n.name for tree in trees for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and n.name[0] != "_"]
    assert sorted({name for name in names if names.count(name) > 1}) == []


def test_package_list_is_the_folders_on_disk():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    on_disk = {
        "regrasp_opt." + ".".join(path.parent.relative_to(PACKAGE).parts)
        for path in [*PACKAGE.rglob("__init__.py"), *PACKAGE.glob("solvers/__init__.py")]
        if path.parent != PACKAGE
    }
    assert set(settings["packages"]) == on_disk | {"regrasp_opt"}
    assert settings["package-dir"] == {"regrasp_opt.solvers": "solvers"}


def test_solvers_is_a_relative_link_to_the_top_folder():
    assert os.readlink(PACKAGE / "solvers") == "../solvers"
    assert (PACKAGE / "solvers").resolve() == ROOT / "solvers"


def test_public_names_are_few_and_real():
    import regrasp_opt

    assert len(regrasp_opt.__all__) <= 16
    for name in regrasp_opt.__all__:
        assert getattr(regrasp_opt, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = regrasp_opt.nothing


def test_importing_the_package_loads_nothing_heavy():
    heavy = "{'torch', 'casadi', 'pinocchio', 'coal', 'trimesh', 'scipy', 'numpy', 'plotly'}"
    script = f"import sys, regrasp_opt; sys.exit(str({heavy} & set(sys.modules) or '') or 0)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_no_pickles_no_eval_no_shell_and_no_download():
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        forbidden = (
            "allow_pickle=True",
            "import pickle",
            "torch.load",
            "shell=True",
            "os.system",
            "os.popen",
            "urllib",
        )
        assert not [word for word in forbidden if word in text], path
        calls = [
            n.func.id for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)
        ]
        assert not {"eval", "exec"} & set(calls), path
