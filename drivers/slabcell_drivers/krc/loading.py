"""How do the files of a project become its modules?"""

from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path

from slabcell_drivers.krc.parser import parse
from slabcell_drivers.krc.scope import Project
from slabcell_drivers.krc.syntax import Module

__all__ = ["ENDINGS", "load_predefined", "load_sources", "read_project", "stem_of"]

ENDINGS = frozenset({".src", ".dat", ".sub"})


def read_project(folder: Path) -> dict[str, bytes]:
    """Return the .src, .dat and .sub files below a folder by their path in it."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in ENDINGS and path.is_file()
    }


def stem_of(name: str) -> str:
    """Return the name of a module: that of its file, without folder and ending, in capitals."""
    last = name.replace("\\", "/").rsplit("/", maxsplit=1)[-1]
    head, dot, ending = last.rpartition(".")
    return (head if dot and f".{ending.lower()}" in ENDINGS else last).upper()


@cache
def _predefined() -> Module:
    source = files("slabcell_drivers.krc").joinpath("predefined.dat").read_bytes()
    return parse(source, "predefined.dat")


def load_predefined(project: Project) -> None:
    """Load the types and data that a controller brings along."""
    project.load([("$PREDEFINED", _predefined())])


def load_sources(project: Project, sources: Mapping[str, bytes]) -> list[Module]:
    """Load the files of a project; return their modules in the order of the files."""
    modules = [(stem_of(name), parse(source, name)) for name, source in sources.items()]
    # system data first: programs may use its constants as sizes of their arrays
    project.load(sorted(modules, key=lambda item: not item[0].startswith("$")))
    return [module for _, module in modules]
