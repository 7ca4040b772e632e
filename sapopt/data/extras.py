"""Packages that not everybody has: imported when they are needed, with a word on how to get them."""

from __future__ import annotations

import importlib
from typing import Any


def needed(module: str, extra: str, what: str) -> Any:
    """Import a module of an optional package.

    Parameters
    ----------
    module : str
        Its dotted name.
    extra : str
        The extra of sapopt that installs it.
    what : str
        What needs it, the subject of the message.

    Raises
    ------
    ImportError
        If the package is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise ImportError(f"{what} needs {package}: pip install 'sapopt[{extra}]'") from None
