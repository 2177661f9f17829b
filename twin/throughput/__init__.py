"""Performance of production lines: takt, throughput, lateness and work in progress of products."""
