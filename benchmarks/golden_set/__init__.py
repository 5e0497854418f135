"""Inputs, runs and items of benchmarks/golden.py."""
