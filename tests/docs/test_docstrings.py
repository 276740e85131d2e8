"""Every name of the reference has a docstring that names its parameters and fields, what comes back, and its errors."""

import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import pytest

import regrasp_opt

ROOT = Path(__file__).parents[2]
PAGES = ("reference.md", "motion.md")
DIRECTIVE = re.compile(r"^\.\. auto(class|function|module):: (\S+)$(?:\n +:members:(.*))?", re.M)


def resolved(path):
    """Return the object that a dotted path names."""
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            found = getattr(found, name)
        return found
    raise AssertionError(f"{path} is not there")


def members(owner, wanted):
    """Return the public functions and properties of a class that its reference shows, by name."""
    shown = [name.strip() for name in wanted.split(",") if name.strip()] or [n for n in vars(owner) if n[0] != "_"]
    found = {name: inspect.getattr_static(owner, name) for name in shown}
    found = {name: getattr(member, "__func__", member) for name, member in found.items()}
    return {
        n: m for n, m in found.items() if inspect.isfunction(m) or isinstance(m, property) or hasattr(m, "attrname")
    }


def public():
    """Return every documented function, class and property by its dotted name."""
    found = {f"regrasp_opt.{name}": getattr(regrasp_opt, name) for name in regrasp_opt.__all__}
    for page in PAGES:
        for kind, path, wanted in DIRECTIVE.findall((ROOT / "docs" / page).read_text(encoding="utf-8")):
            owner = resolved(path)
            if kind == "module":
                own = {n: m for n, m in vars(owner).items() if getattr(m, "__module__", None) == path and n[0] != "_"}
                found |= {f"{path}.{name}": member for name, member in own.items() if callable(member)}
            else:
                found[path] = owner
                if (
                    kind == "class"
                    and ":members:" in (ROOT / "docs" / page).read_text(encoding="utf-8").split(path, 1)[1][:40]
                ):
                    found |= {f"{path}.{name}": member for name, member in members(owner, wanted).items()}
    return found


PUBLIC = public()


def section(doc, title):
    """Return the lines of a section of a docstring, or nothing."""
    match = re.search(rf"^{title}\n-+\n(.*?)(?=^\w[\w ]*\n-+$|\Z)", doc, re.M | re.S)
    return match[1] if match else ""


def named(doc, title):
    """Return the names that stand at the margin of a section, and those in backticks anywhere."""
    heads = re.findall(r"^\*{0,2}(\w[\w, ]*?)(?: :.*)?$", section(doc, title), re.M)
    return {name.strip() for head in heads for name in head.split(",")} | set(re.findall(r"`(\w+)`", doc))


def signature_of(member):
    return inspect.signature(getattr(member, "func", getattr(member, "fget", None) or member))


@pytest.mark.parametrize("name", PUBLIC)
def test_the_docstring_names_what_goes_in_and_what_comes_out(name):
    member = PUBLIC[name]
    doc = inspect.getdoc(member) or ""
    assert len(doc) > 10, "no docstring"
    if inspect.isclass(member):
        if dataclasses.is_dataclass(member) or hasattr(member, "_fields"):
            fields = getattr(member, "_fields", None) or [
                f.name for f in dataclasses.fields(member) if f.name[0] != "_"
            ]
            missing = set(fields) - named(doc, "Attributes") - named(doc, "Parameters")
            assert not missing, f"the fields {sorted(missing)} are not described"
        return
    if isinstance(member, property) or hasattr(member, "attrname"):
        return
    signature = signature_of(member)
    missing = {p for p in signature.parameters if p not in ("self", "cls")} - named(doc, "Parameters")
    assert not missing, f"the parameters {sorted(missing)} are not described"
    if signature.return_annotation not in (None, "None"):
        assert section(doc, "Returns") or re.match(r"(Return|Yield)\b", doc), "what it returns is not described"


@pytest.mark.parametrize("name", [n for n, m in PUBLIC.items() if inspect.isfunction(m)])
def test_errors_that_a_function_raises_itself_are_documented(name):
    raised = set(re.findall(r"^ +raise (\w+Error)\(", inspect.getsource(PUBLIC[name]), re.M))
    doc = inspect.getdoc(PUBLIC[name])
    known = set(re.findall(r"\w+Error", section(doc, "Raises")))
    assert raised <= known or "RegraspError" in known, sorted(raised - known)
