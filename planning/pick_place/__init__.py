"""Assemblies of boxes, beams and rods that robots pick up and put in place."""
