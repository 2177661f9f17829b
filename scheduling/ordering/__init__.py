"""Task order: precedence of conflicting tasks, and better plans.

Imports graph, conflicts, shortcuts and build_tpg.
"""
