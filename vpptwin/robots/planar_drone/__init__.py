"""The planar drone: its vehicle file, filters, pilots and topics."""
