"""Creation of new scenarios from templates: ``twin init``.

Imports scenario; explorations import it.
"""
