"""Where the files of the repository are."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Import packages of the distribution. All else is imported from `thermojoint`.
TOP = ("calibrate", "estimator", "fesim", "meshes", "thermojoint")


def modules(package):
    return sorted((ROOT / package.replace(".", "/")).rglob("*.py"))
