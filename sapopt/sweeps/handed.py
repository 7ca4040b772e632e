"""Classes that somebody names on the command line."""

from __future__ import annotations

import importlib
import os
import sys


def handed_over(text: str) -> type:
    """The class that ``MODULE:CLASS`` names, from an installed module or one in the current folder.

    Only for what a person wrote: names in files of problems are never imported.

    Raises
    ------
    ValueError
        If it is no such name, or there is no such module or class.
    """
    module, _, name = text.partition(":")
    if not module or not name:
        raise ValueError(f"--dynamics must be MODULE:CLASS, such as mine:Tiring, got {text!r}")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.insert(0, here)  # the program's own path does not hold the folder that it runs in
    try:
        found: object = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except ImportError as error:
        raise ValueError(f"--dynamics {text}: {error}") from None
    except AttributeError:
        raise ValueError(f"--dynamics {text}: there is no {name} in {module}") from None
    if not isinstance(found, type):
        raise ValueError(f"--dynamics {text}: {name} is no class")
    return found
