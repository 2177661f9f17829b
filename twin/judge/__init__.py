"""Plans of others: read from a neutral file, replayed under delays, and judged by the audit."""
