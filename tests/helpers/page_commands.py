"""The commands of a page, run as a reader would type them."""

import shlex
import subprocess

from thermojoint.cli.app import app


def run(command, patch):
    words = shlex.split(command)
    if words[0] == "cd":
        patch.chdir(words[1])
    elif words[0] == "thermojoint":
        app(words[1:], standalone_mode=False)
    else:
        subprocess.run(command, shell=True, check=True)
