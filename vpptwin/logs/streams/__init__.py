"""Samples of topics made into streams: clocks, order, columns, units."""
