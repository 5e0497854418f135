"""What the paper's linear thrust map misses on measured rotors, and what bent maps gain.

    python benchmarks/rotor_maps.py DATA/rotor
    python benchmarks/rotor_maps.py DATA/rotor --json maps.json --picture docs/pictures

The rotors of Knight and Hefner (NACA TN-626, 1937): thrust coefficient against collective pitch, two to five blades.
Each map is fitted to all pitches but one and asked for that one, in turn.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from vpptwin.robots.planar_drone.thrust_stand.thrust_map import CANDIDATES, ThrustMap, fit_map  # noqa: E402
from vpptwin.viz.plots.figure import name_axes, open_figure, write_svg  # noqa: E402
from vpptwin.viz.plots.palette import BLUE, GREEN, ORANGE, VERMILION  # noqa: E402

FORMS = [candidate for candidate in CANDIDATES if candidate.power == 1]
"""At one speed the power of ω makes no difference."""
LOOKS = {"linear": (VERMILION, "--"), "second order": (ORANGE, "-."), "third order": (GREEN, ":")}


def read_rotor(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Pitch [rad] and thrust coefficient of a rotor, (n,) each."""
    with file.open(encoding="utf-8-sig") as stream:
        rows = [row for row in csv.DictReader(stream) if row["Theta_not (deg)"]]
    pitch = np.array([math.radians(float(row["Theta_not (deg)"])) for row in rows])
    return pitch, np.array([float(row["C_t_paper"]) for row in rows])


def compare_maps(pitch: np.ndarray, thrust: np.ndarray) -> list[ThrustMap]:
    """Maps of a rotor at one speed, fitted without an offset: pitch (L,) rad, thrust (L,) in any unit."""
    one = np.ones((len(pitch), 1))
    return [fit_map(c, one, pitch[:, None], thrust, np.arange(len(pitch)), shifted=False) for c in FORMS]


def measure(file: Path) -> dict[str, dict[str, float]]:
    """Errors of every form on a rotor, as shares of its largest thrust: mean and largest, fitted and held out."""
    pitch, thrust = read_rotor(file)
    result = {}
    for fitted in compare_maps(pitch, thrust):
        wrong = np.abs(predict(fitted, pitch) - thrust) / thrust.max()
        relative = np.abs(predict(fitted, pitch) / thrust - 1.0)
        result[short(fitted)] = {
            "largest": float(wrong.max()), "rms": fitted.residual / float(thrust.max()),
            "held_out": fitted.held_out / float(thrust.max()), "relative": float(relative.mean()),
        }  # fmt: skip
    return result


def predict(fitted: ThrustMap, pitch: np.ndarray) -> np.ndarray:
    """Thrust of a map at one speed, (n,)."""
    thrust: np.ndarray = fitted.predict(np.ones((len(pitch), 1)), pitch[:, None])[:, 0]
    return thrust


def short(fitted: ThrustMap) -> str:
    """Name of a form without its power of ω."""
    return fitted.candidate.name.split(",")[0]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; 2 for bad input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of 2blade.csv to 5blade.csv")
    parser.add_argument("--json", type=Path, help="write the results here")
    parser.add_argument("--picture", type=Path, help="folder for rotor_maps.svg")
    options = parser.parse_args(argv)
    files = sorted(options.folder.glob("*blade.csv"))
    if not files:
        print(f"{options.folder} holds no *blade.csv; expected the rotors of NACA TN-626", file=sys.stderr)
        return 2
    results = {file.stem: measure(file) for file in files}
    print("| rotor | map | mean error of thrust | RMS, of largest thrust | largest | held out |")
    print("|---|---|---|---|---|---|")
    for rotor, forms in results.items():
        for form, e in forms.items():
            cells = [f"{e['relative']:.1%}", f"{e['rms']:.2%}", f"{e['largest']:.2%}", f"{e['held_out']:.2%}"]
            print(f"| {rotor} | {form} | {' | '.join(cells)} |")
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")
    if options.picture:
        draw(files, options.picture / "rotor_maps.svg")
    return 0


def draw(files: Sequence[Path], path: Path) -> None:
    """Measured coefficients with the fitted maps, a panel a rotor."""
    with open_figure(9.0, 5.6) as figure:
        panels = figure.subplots(2, 2, sharex=True).ravel()
        for axes, file in zip(panels, files):
            pitch, thrust = read_rotor(file)
            fine = np.linspace(0.0, pitch.max(), 100)
            for fitted in compare_maps(pitch, thrust):
                colour, dash = LOOKS.get(short(fitted), (BLUE, "-"))
                axes.plot(np.degrees(fine), predict(fitted, fine), dash, color=colour, label=short(fitted))
            axes.plot(np.degrees(pitch), thrust, "o", color="#7F858C", label="measured")
            name_axes(axes, "collective pitch [°]", "$C_T$", file.stem.replace("blade", " blades"))
        panels[0].legend()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(write_svg(figure, "Thrust maps of measured rotors") + "\n")


if __name__ == "__main__":
    sys.exit(main())
