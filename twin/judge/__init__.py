"""External plans: read from a neutral file, replayed under delays, and audited."""
