"""What a verdict may say surely, where a fit by hand of the same log is known."""

from __future__ import annotations

from collections.abc import Container, Mapping

SURE = 0.9
FACTORS = ("gain", "delay", "lag")
"""Effects that are written as they are, not as what they add to the twin."""


def check_causes(verdict: dict, never: Container[str], room: Mapping[str, tuple[str, float, float]]) -> None:
    """Nothing that the fit by hand excludes is said with more than 90 %.

    Args:
        verdict: verdict.json.
        never: causes that it excludes.
        room: cause → parameter, lowest, highest that it leaves room for.
    """
    for cause in verdict["causes"]:
        effect = cause["effect"]
        if cause["confidence"] <= SURE:
            continue
        assert effect not in never, cause
        if effect in room:
            name, low, high = room[effect]
            entry = cause["parameters"][name]
            size = entry["value"] - (0.0 if effect.endswith(FACTORS) else entry["nominal"])
            assert low <= size <= high, cause
