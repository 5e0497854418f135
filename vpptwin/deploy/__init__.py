"""Carrying a policy out of Python: C99 source and ONNX, and flying what was exported."""
