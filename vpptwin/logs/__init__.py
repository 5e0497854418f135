"""Flight logs: MCAP with ROS 2 messages, read into arrays and written from them."""

from vpptwin.logs.flight import Flight, Stream
from vpptwin.logs.read import read_flight
from vpptwin.logs.write import FlightWriter, write_flight

__all__ = ["Flight", "FlightWriter", "Stream", "read_flight", "write_flight"]
