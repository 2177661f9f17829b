"""Report of a study: figures, tables and an HTML page.

Imports studies; commands import it.
"""
