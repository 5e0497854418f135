"""What the hovers of a Crazyflie with faults made by hand say, as examples/crazypad/README.md has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from examples.crazypad.by_hand import compare

README = Path(__file__).parents[1] / "examples/crazypad/README.md"


def test_the_balance_of_hovers(shared_data: Path) -> None:
    """The README's numbers; rotor 3 stands out where something is on it, the cut propeller shifts yaw."""
    found = compare(shared_data / "crazypad")
    text = README.read_text(encoding="utf-8").replace("−", "-")
    for name, changes in found.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| {name} |")]
        told = np.array([float(cell.strip(" *").split(" ")[0]) for cell in row.split("|")[2:6]])
        np.testing.assert_allclose(told, 100.0 * changes.mean(axis=0), atol=0.051)
    on_rotor = [found[name].mean(axis=0) for name in found if name.endswith("_M3") and "cut" not in name]
    assert all(np.argmax(change) == 2 for change in on_rotor)
    for change in on_rotor[1:]:  # one pattern, in proportion
        assert np.corrcoef(on_rotor[0], change)[0, 1] > 0.99
    yaw = {name: float(change.mean(axis=0) @ [1, -1, 1, -1]) for name, change in found.items()}
    assert yaw["cut_propeller_M3_2mm"] > 0.25
