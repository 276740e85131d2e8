"""The verifiers share nothing with the package but the meshes of its built-in objects, and the repair of meshes."""

import ast
from pathlib import Path

ALLOWED = {"regrasp_opt.objects"}


def test_the_verifiers_import_none_of_what_they_verify():
    modules = [
        path
        for path in Path(__file__).parent.glob("*.py")
        if not path.name.startswith(("test_", "campaign", "accelerations", "stations"))
    ]
    assert len(modules) >= 6
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] not in ("coal", "pinocchio", "eaik", "verifying"), path
                assert not name.startswith("regrasp_opt") or name in ALLOWED, path


def test_objects_import_none_of_it_either():
    """What the verifiers take from `regrasp_opt.objects` comes without robots, cells or checks."""
    folder = Path(__file__).parents[2] / "regrasp_opt" / "objects"
    allowed = {"conventions", "errors", "files", "mesh_files", "objects", "schemas", "shapes", "geometry"}
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("regrasp_opt."):
                assert node.module.split(".")[1] in allowed, path
