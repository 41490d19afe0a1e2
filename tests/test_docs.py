"""The pages: all are in the contents, links lead somewhere, programs are programs."""

import ast
import os
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
    contents = re.findall(r"```\{toctree\}(.*?)```", (DOCS / "index.md").read_text("utf-8"), re.S)
    lines = "\n".join(contents).split("\n")
    listed = {line for line in lines if line and not line.startswith(":")}
    assert listed == {page.stem for page in PAGES} - {"index"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text("utf-8")):
        assert (DOCS / target).exists(), target


@pytest.mark.parametrize("page", ["export", "check", "compensation", "experiment"])
def test_pages_of_what_leaves_the_package_have_a_picture(page):
    text = (DOCS / f"{page}.md").read_text("utf-8")
    (target,) = re.findall(r"!\[[^]]+\]\((images/[^)]+\.png)\)", text)
    assert (DOCS / target).stat().st_size > 10_000


@pytest.mark.parametrize("text", PROGRAMS)
def test_programs_parse(text):
    ast.parse(text)


@pytest.mark.parametrize(
    "page", ["README.md", pytest.param("docs/workbench.md", marks=pytest.mark.long)]
)
def test_programs_of_the_page_run(page, tmp_path):
    """In a process of its own: figures, and files beside it."""
    text = (DOCS.parent / page).read_text("utf-8")
    program = "\n".join(re.findall(r"```python\n(.*?)```", text, re.S))
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path, env=environment)


def test_readme_is_short_and_its_links_lead_somewhere():
    text = (DOCS.parent / "README.md").read_text("utf-8")
    assert len(text.splitlines()) <= 150
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", text):
        assert (DOCS.parent / target).exists(), target


def test_the_effect_of_the_page_is_an_effect():
    """In a process of its own: it would stay in this one's catalogue."""
    page = (DOCS / "your_own.md").read_text("utf-8")
    program = re.search(r"```python\n(from numba.*?)```", page, re.S)[1]
    check = (
        "from dmptm_ctrl.effects import CATALOGUE\n"
        "assert list(CATALOGUE)[-1] == 'latch'\n"
        "value = LATCH.kernel(0.5, 0.0, 0.0, LATCH.values(2.0))\n"
        "assert abs(value + 2.0 * 0.5 / (1 + 9 * 0.25)) < 1e-12\n"
    )
    subprocess.run([sys.executable, "-c", program + check], check=True)
