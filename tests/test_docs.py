"""The pages: all are in the contents, links lead somewhere, programs are programs."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
PAGES = sorted(DOCS.glob("*.md"))
PROGRAMS = [
    pytest.param(text, id=f"{page.stem}-{k}")
    for page in PAGES
    for k, text in enumerate(re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.S))
]


def test_every_page_is_in_the_contents():
    contents = re.search(r"```\{toctree\}(.*?)```", (DOCS / "index.md").read_text("utf-8"), re.S)[1]
    listed = {line for line in contents.split("\n") if line and not line.startswith(":")}
    assert listed == {page.stem for page in PAGES} - {"index"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text("utf-8")):
        assert (DOCS / target).exists(), target


@pytest.mark.parametrize("text", PROGRAMS)
def test_programs_parse(text):
    ast.parse(text)


def test_the_effect_of_the_page_is_an_effect():
    """In a process of its own: it would stay in this one's catalogue."""
    page = (DOCS / "your_own.md").read_text("utf-8")
    program = re.search(r"```python\n(from typing.*?)```", page, re.S)[1]
    check = (
        "from dmptm_ctrl.effects import CATALOGUE\n"
        "assert list(CATALOGUE)[-1] == 'latch'\n"
        "value = LATCH.kernel(0.5, 0.0, 0.0, Latch(2.0))\n"
        "assert abs(value + 2.0 * 0.5 / (1 + 9 * 0.25)) < 1e-12\n"
    )
    subprocess.run([sys.executable, "-c", program + check], check=True)
