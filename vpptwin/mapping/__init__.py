"""What the columns of an unknown log mean: `vpptwin inspect`, and the twin file that it writes."""
