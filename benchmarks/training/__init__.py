"""Training campaigns: many runs of `vpptwin train`, evaluated the same way, as one table and one figure."""
