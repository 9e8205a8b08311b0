"""What pyproject.toml cannot say: an installation imports neuroflight.py whenever Python starts."""

import os
import sysconfig

from setuptools import Distribution, setup


class Project(Distribution):
    """An editable installation installs data files if `has_data` says so, which setuptools 84 lacks."""

    has_data = Distribution.has_data_files


PACKAGES = os.path.relpath(sysconfig.get_path("purelib"), sysconfig.get_path("data"))
setup(distclass=Project, data_files=[(PACKAGES, ["neuroflight.pth"])])
