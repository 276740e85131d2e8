"""Every code block of the README and the documentation is executed, page by page, in an empty folder."""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import pytest

from regrasp_opt import Status
from regrasp_opt.cli.app import run

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(
    r"^(?P<mark><!-- not run: [^\n]+ -->\n)?```(?P<language>python|bash|console)\n(?P<code>.*?)^```$", re.M | re.S
)


EXIT_CODES = {"error": 2} | {status.name.lower(): int(status is not Status.SOLVED) for status in Status}


class Block(NamedTuple):
    """A fenced code block: its language, its text, the line of the text, and whether the page says not to run it."""

    language: str
    code: str
    line: int
    skipped: bool


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [
        Block(m["language"], m["code"], text[: m.start("code")].count("\n"), bool(m["mark"]))
        for m in FENCE.finditer(text)
    ]


def arguments(line: str) -> list[str]:
    program, *rest = shlex.split(line)
    assert program == "regrasp-opt", f"only regrasp-opt can be run here, not {program}; mark the block as not run"
    return rest


def run_commands(block: Block) -> None:
    for line in block.code.splitlines():
        assert run(arguments(line)) == 0, line


def run_transcript(block: Block, capsys: pytest.CaptureFixture[str]) -> None:
    command, *said = block.code.splitlines()
    assert command.startswith("$ ") and said
    capsys.readouterr()
    code = run(arguments(command[2:]))
    out, err = capsys.readouterr()
    assert (out + err).splitlines() == said
    assert code == EXIT_CODES.get(said[0].split(":")[0], 0)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda p: p.stem)
def test_every_block_of_the_page_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty-folder").mkdir()
    names = {"__name__": "__main__"}
    for block in blocks(page):
        if block.skipped:
            continue
        if block.language == "python":
            padded = "\n" * block.line + block.code  # so that tracebacks name the line of the page
            exec(compile(padded, str(page), "exec"), names)
        elif block.language == "bash":
            run_commands(block)
        else:
            run_transcript(block, capsys)


def test_every_fence_is_understood():
    known = {"python", "bash", "console", "text", "{toctree}", "{eval-rst}"}
    for page in PAGES:
        openings = re.findall(r"^```(\S+)", page.read_text(encoding="utf-8"), re.M)
        assert set(openings) <= known, page.name
        assert len(blocks(page)) == sum(o in {"python", "bash", "console"} for o in openings), page.name


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_links_to_files_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target
