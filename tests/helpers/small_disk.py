"""A small file system of its own, which can really be full."""

import contextlib
import subprocess

import pytest


@contextlib.contextmanager
def mounted(folder, megabytes):
    """A file system in memory on a folder; the test is skipped where nobody may mount one."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(folder)]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("mounting a file system needs root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder):
    """Take the last byte; the file that has taken it."""
    filler = folder / "filler"
    for size in (1 << 20, 4096, 1):
        with contextlib.suppress(OSError), filler.open("ab", buffering=0) as out:
            while out.write(bytes(size)) == size:
                pass
    return filler
