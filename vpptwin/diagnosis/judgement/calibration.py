"""How sure a verdict is: the map that sessions with a known truth taught, see `benchmarks/calibration.py`."""

from __future__ import annotations

import json
from importlib.resources import files

from vpptwin.inference.calibrate import Calibration

FILE = "calibration.json"


def load_calibration() -> Calibration:
    """The map that ships, with its seeds and commit beside it in the file."""
    told = json.loads(files("vpptwin.diagnosis.judgement").joinpath(FILE).read_text())
    return Calibration(told["intercept"], told["slope"], told["highest"])


CALIBRATION = load_calibration()
