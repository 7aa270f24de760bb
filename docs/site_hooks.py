"""What the site does with the pages, which are written for the repository: run by MkDocs.

- README and changelog become pages; so do files of the repository that a page links to.
- Links out of ``docs`` lead to those pages; a link that shows a file name shows the page's title.
- Formulas become MathML, which browsers draw by themselves: nothing is loaded from the network.
- A page of reference is made from the public names of the program.
"""

from __future__ import annotations

import html
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files, InclusionLevel
from mkdocs.structure.pages import Page

import thermojoint

ROOT = Path(__file__).parents[1]
#: Pages that stand outside the folder of the documentation.
OUTSIDE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
#: Linked files that are shown as pages; any other kind is copied as it is.
SHOWN = (".csv", ".py", ".toml")
LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)")
#: A link that shows no more than the name of the page.
NAMED = re.compile(r"\[`?([\w./-]+)\.md`?\]\(([^)\s#]+)")
FENCE = re.compile(r"^```(\w+) (\S+)$", re.MULTILINE)
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in ``docs``."""
    texts = [(name, _text(name)) for name in OUTSIDE]
    texts += [(f"docs/{file.src_uri}", file.content_string) for file in files.documentation_pages()]
    for name, page in OUTSIDE.items():
        files.append(File.generated(config, page, content=_for_site(_text(name), name)))
    for path in sorted({path for name, text in texts for path in _files_linked(text, name)}):
        files.append(_linked(path, config))
    files.append(File.generated(config, "reference.md", content=_reference()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Lead links to pages of the site, and give code the name of its file as a title."""
    if page.file.generated_by is None:
        markdown = _for_site(markdown, f"docs/{page.file.src_uri}")
    return FENCE.sub(_titled, markdown)


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn formulas into MathML."""

    def drawn(found: re.Match[str]) -> str:
        tex = html.unescape(found[2]).strip()
        display = "block" if found[1] == "div" else "inline"
        drawing = convert(tex, display=display)
        if "\\" in drawing:
            raise PluginError(f"{page.file.src_uri}: formula with an unknown command: {tex}")
        return f'<{found[1]} class="arithmatex">{drawing}</{found[1]}>'

    return FORMULA.sub(drawn, content)


def _for_site(markdown: str, name: str) -> str:
    """Return the text of a file of the repository with the links of the site."""

    def led(found: re.Match[str]) -> str:
        target = _target(found[1], name)
        if target.startswith("docs/"):
            return target.removeprefix("docs/")
        if target in OUTSIDE:
            return OUTSIDE[target]
        if not (ROOT / target).is_file():
            return found[1]
        return f"{target}.md" if target.endswith(SHOWN) else target

    def titled(found: re.Match[str]) -> str:
        target = ROOT / _target(found[2], name)
        title = target.is_file() and re.match(r"# (.+)", target.read_text("utf-8"))
        return f"[{title[1]}]({found[2]}" if title else found[0]

    return LINK.sub(led, NAMED.sub(titled, markdown))


def _files_linked(markdown: str, name: str) -> Iterator[str]:
    """Paths of files outside ``docs`` that a text links to."""
    for link in LINK.findall(markdown):
        target = _target(link, name)
        if not target.startswith("docs/") and target not in OUTSIDE and (ROOT / target).is_file():
            yield target


def _linked(path: str, config: MkDocsConfig) -> File:
    """Return a file of the repository as a page of the site, or as it is."""
    if not path.endswith(SHOWN):
        return File.generated(config, path, abs_src_path=str(ROOT / path))
    language = path.rpartition(".")[2]
    content = f"# {path}\n\n```{language}\n{_text(path)}\n```\n"
    return File.generated(
        config, f"{path}.md", content=content, inclusion=InclusionLevel.NOT_IN_NAV
    )


def _target(link: str, name: str) -> str:
    """Path in the repository that a link in the file `name` leads to."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(name), link))


def _titled(found: re.Match[str]) -> str:
    """A second word after the language is the name of a file, or a word for the tests."""
    language, word = found.groups()
    return f'```{language} title="{word}"' if "." in word else f"```{language}"


def _reference() -> str:
    """Markdown of the page that documents every public name."""
    packages = sorted(path.parent.name for path in ROOT.glob("*/py.typed"))
    # Public names stand in other packages: without these they could not be followed there.
    options = f"    options:\n      preload_modules: {packages}\n"
    head = "# Public names\n\nAttributes of `thermojoint`; [From Python](api.md) uses them.\n"
    return "\n".join(
        [head, *(f"::: thermojoint.{name}\n{options}" for name in thermojoint.__all__)]
    )


def _text(name: str) -> str:
    return (ROOT / name).read_text("utf-8")
