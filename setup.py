"""What pyproject.toml cannot say: how the folders of a checkout become the one package `neuroflight`.

An installation also has Python import neuroflight whenever it starts (neuroflight.pth).
"""

import os
import sysconfig

from setuptools import Distribution, find_namespace_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.editable_wheel import editable_wheel

ROOMS = ("cli", "flash", "sim", "toolchain", "training")


class Project(Distribution):
    """An editable installation installs data files if `has_data` says so, which setuptools 84 lacks."""

    has_data = Distribution.has_data_files


class Package(build_py):
    """Places neuroflight.py, a package by its `__path__`, where an installation looks for a package."""

    def get_module_outfile(self, build_dir: str, package: list[str], module: str) -> str:
        """Return the file that a module is built to."""
        if module == "neuroflight":
            package, module = [module], "__init__"
        return super().get_module_outfile(build_dir, package, module)


class Editable(editable_wheel):
    """Refers to neuroflight.py alone, whose `__path__` leads to the folders beside it."""

    def run(self) -> None:
        """Build the wheel that points to this checkout."""
        self.distribution.packages = []
        super().run()


PACKAGES = os.path.relpath(sysconfig.get_path("purelib"), sysconfig.get_path("data"))
setup(
    distclass=Project,
    cmdclass={"build_py": Package, "editable_wheel": Editable},
    py_modules=["neuroflight"],
    packages=[
        f"neuroflight.{name}" for room in ROOMS for name in find_namespace_packages(include=[f"{room}*"])
    ],
    package_dir={f"neuroflight.{room}": room for room in ROOMS},
    data_files=[(PACKAGES, ["neuroflight.pth"])],
)
