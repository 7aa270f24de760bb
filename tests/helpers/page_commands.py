"""The files and commands of a page, followed as a reader would type them."""

import re
import shlex
import shutil
import subprocess
from typing import NamedTuple

from thermojoint.cli.app import app


class Block(NamedTuple):
    """A block of a page. What follows its language: "once" for what sets the environment up, "cad"
    for what needs Gmsh, or the name of a file.
    """

    language: str
    rest: str
    content: str


def blocks_of(page):
    found = re.findall(r"^```(\w+)([^\n]*)\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)
    return [Block(language, rest.strip(), content) for language, rest, content in found]


def files_of(blocks):
    return {one.rest: one.content for one in blocks if "." in one.rest}


def copied(example, names, root):
    """Copy files of an example to where they are in a clone; gives their folder."""
    folder = root / "examples" / example.name
    folder.mkdir(parents=True)
    for name in names:
        shutil.copy(example / name, folder)
    return folder


def follow(blocks, patch, left_out=()):
    """Run the commands of a page in its order."""
    for one in blocks:
        if one.language == "sh" and one.rest not in ("once", *left_out):
            for command in one.content.strip().splitlines():
                run(command, patch)


def run(command, patch):
    words = shlex.split(command)
    if words[0] == "cd":
        patch.chdir(words[1])
    elif words[0] == "thermojoint":
        app(words[1:], standalone_mode=False)
    else:
        subprocess.run(command, shell=True, check=True)
