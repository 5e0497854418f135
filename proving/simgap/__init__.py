"""SimGap: proper scores for tools that name what a simulation gets wrong (issue 60, begun)."""
