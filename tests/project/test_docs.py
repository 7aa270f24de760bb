"""The pages of the repository lead somewhere: links, anchors, images and the modules they name."""

import re

import pytest
from repository import ROOT

PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "CHANGELOG", "CONTRIBUTING")),
    *sorted((ROOT / "docs").glob("*.md")),
]
LINK = re.compile(r"\]\((?!\w+:)([^)\s]+)\)")
MODULE = re.compile(r"`((?:[a-z_]+/)+[a-z_0-9]+\.py)`")


def prose(page):
    """The text of a page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)


def anchors(page):
    """Anchors of the headings, as the repository's pages and the site make them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_of_a_page_leads_somewhere(page):
    for link in LINK.findall(prose(page)):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_module_that_a_page_names_is_there(page):
    for name in MODULE.findall(prose(page)):
        assert (ROOT / name).is_file(), name


def test_the_site_shows_every_page():
    shown = set(re.findall(r": ([\w-]+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.M))
    made = {"index.md", "changelog.md", "contributing.md", "reference.md"}
    assert shown == made | {page.name for page in (ROOT / "docs").glob("*.md")}
