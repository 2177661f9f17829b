"""Report of a study: figures, tables and an HTML page.

Imports study; commands import it.
"""
