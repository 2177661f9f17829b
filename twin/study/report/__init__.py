"""What a study found, as figures, tables and an HTML page.

Imports study; commands import it.
"""
