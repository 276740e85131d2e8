"""Every error message that the page of error messages quotes is one of the code, word for word."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
QUOTED = re.findall(r"^\| `([^`]*[ …][^`]*)` \|", (ROOT / "docs" / "faq.md").read_text(encoding="utf-8"), re.M)


def template(node):
    """Return the text of a string in the code, with … where a value is put in; None if it is not a string."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
        return text.replace("……", "…")
    return None


@pytest.fixture(scope="module")
def messages():
    """Return the texts of everything that is raised."""
    found = set()
    for folder in ("regrasp_opt", "solvers"):
        for path in (ROOT / folder).rglob("*.py"):
            raised = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Raise)]
            found |= {template(node) for statement in raised for node in ast.walk(statement)}
    return found


def test_there_are_messages_to_look_for():
    assert len(QUOTED) > 20


@pytest.mark.parametrize("message", QUOTED)
def test_the_message_is_in_the_code(message, messages):
    assert message in messages
