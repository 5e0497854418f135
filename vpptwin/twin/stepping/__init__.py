"""The inner step: constants by simulation, friction, the written pipeline, and what numba compiles of it."""
