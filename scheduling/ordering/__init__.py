"""Task order: precedence of conflicting tasks, better plans, and the synchronous baseline.

Imports graph, conflicts, shortcuts and build_tpg.
"""
