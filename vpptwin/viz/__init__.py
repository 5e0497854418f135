"""Seeing flights: meshcat playback of a log beside its twin, and the plots of reports."""
