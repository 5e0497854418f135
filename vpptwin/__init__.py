"""vpptwin: the simulation twin that tells you what it gets wrong."""

__version__ = "0.1.0"
