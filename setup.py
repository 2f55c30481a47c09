"""Build the extension; where that fails, say what to install. All else stands in pyproject.toml."""

from __future__ import annotations

from setuptools import setup
from setuptools.command.build_ext import build_ext
from setuptools.errors import BaseError, CCompilerError

NEEDED = """
dbo-cli: the compiled part cannot be built: {problem}
Install a C compiler and the headers of Python, and try again:
  Debian, Ubuntu   apt install build-essential python3-dev
  Fedora, RHEL     dnf install gcc python3-devel
  macOS            xcode-select --install
  Windows          Visual Studio Build Tools, "Desktop development with C++"
"""


class BuildKernel(build_ext):
    """Build the extension, or end with a list of what to install."""

    def run(self) -> None:
        """Build; SystemExit with the list where the compiler is missing or fails."""
        try:
            super().run()
        except (BaseError, CCompilerError, OSError) as problem:
            raise SystemExit(NEEDED.format(problem=problem)) from None


setup(cmdclass={"build_ext": BuildKernel})
