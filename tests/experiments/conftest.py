"""The experiments are run from the root of the checkout (`python -m experiments.NAME`), so they are found there."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
