"""SimGap: proper scores for tools that name what a simulation gets wrong."""
