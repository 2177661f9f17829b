"""A look at a scenario before anything is planned: what cannot be, what is doubtful, and a picture.

Imported by the commands; imports the kinds of assemblies and the geometry of planning.
"""
