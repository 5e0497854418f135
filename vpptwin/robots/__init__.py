"""Robots that ship with the package."""
