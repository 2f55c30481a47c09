"""The recursions of the model in C: the extension ``_kernel``, which every installation has."""

from typing import Any

from dbo_cli.errors import DboError

INTERFACE = 8
"""Of the extension's functions, as ``_kernel.c`` has it: raised with every change of their arguments."""
REMEDY = "type `pip install -e .` in the checkout (it needs a C compiler)"


try:
    from dbo_cli.model import _kernel  # type: ignore[attr-defined,unused-ignore]
except ImportError:
    _kernel = None
if getattr(_kernel, "INTERFACE", None) != INTERFACE:
    raise DboError(f"the compiled part of dbo is missing or older: {REMEDY}")

extension: Any = _kernel
"""The compiled module ``dbo_cli.model._kernel``."""
