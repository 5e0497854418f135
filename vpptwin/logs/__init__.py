"""Flight logs: recordings of any format, read into streams of columns over time, and written as MCAP.

readers (formats) → Recording of channels → samples → streams of a Flight. What cannot be right is refused on the way
by an `InputError`: what was found, what was expected, what to do. A new format is named in `formats/readers.py`.
"""

from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.logs.write import FlightWriter, write_flight

__all__ = ["Flight", "FlightWriter", "Stream", "read_flight", "write_flight"]
