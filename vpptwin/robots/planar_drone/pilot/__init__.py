"""Pilots that fly by rule: position, attitude and flips from a script, with no learning."""

from vpptwin.robots.planar_drone.pilot.scripted import Script, pilot_commands

__all__ = ["Script", "pilot_commands"]
